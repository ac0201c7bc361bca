"""A diagnosis of raw sensor tables: arcs, linear model, explanations, attribution, amplitudes, closure, answer.

The linear model is made twice: about M0, and, where there is a gap, about the amplitudes found, which are taken off the
measurements before the arcs are fitted again. An error of 0.2° leaves 0.0007° of second order, a hundredth of which would be
seen in thousands of measurements; after the second round 1e-6° is left.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from scipy.special import chdtrc

from diagnosis.answer import Closure, Finding, Verdict
from diagnosis.assemble import alternatives, causes_of
from diagnosis.detail_tables import explanation_table
from diagnosis.inference.amplitudes import Fitted, fit
from diagnosis.inference.attribution import Attribution, attribute, weigh_unlisted
from diagnosis.inference.closure import compute_closure
from diagnosis.inference.null import p_value
from diagnosis.inference.search import Search
from diagnosis.model.linear import LinearModel
from diagnosis.model.sensors.arcs import FittedArc, MisfitError, arcs_of, fit_arc, fitted_arcs
from diagnosis.model.sensors.columns import GYRO, Held, held_error
from diagnosis.model.sensors.orthogonal import identifiable, orthogonal_labels
from diagnosis.model.sensors.reading import find_misreading
from diagnosis.model.sensors.refine import refine_parameters
from diagnosis.model.sensors.residuals import findings, residual_table
from diagnosis.model.sensors.tables import Noise, Tables, build_tables, in_noise, linear_model, noise_of
from diagnosis.posterior import of_attitude
from diagnosis.sensor_result import Rejected, SensorDiagnosis
from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.errors import InputError, UnobservableError
from gyrocal.recording import Recording
from simulator.effects.sensor import SensorEffect

TINY = 1e-300
ANY = "sensors"  # signal of what is no matter of one sensor alone
COMMON = (
    "A rotation of all sensors together is an attitude error and cannot be seen; DSS-1 and the Earth sensor's model are the "
    "reference, so a misalignment of DSS-1 shows as one of DSS-2 and as biases of the Earth sensor"
)


@dataclass(frozen=True)
class ExplainedTables:
    """What the raw tables say.

    Attributes
    ----------
    fits : the arcs under M0
    about_m0 : columns and residuals about M0
    linear : the linear model about what was found, in units of the noise as stated
    search : over the explanations of that model, in units of the noise found
    noise : of the sensors, beside what is stated
    p_value : that M0 departs so far, in what any candidate does or in its noise
    attribution : None without a gap
    fitted : amplitudes of the effects that are named
    closed : how far the gap closes on days left out
    rejected : what an alignment calibration would say, beside what is named
    notes : what was left out
    misfits : of each arc that does not fit the nominal sensors at all, while others do
    """

    fits: tuple[FittedArc, ...]
    about_m0: Tables
    linear: LinearModel
    search: Search
    noise: Noise
    p_value: float
    attribution: Attribution | None
    fitted: tuple[Fitted, ...]
    closed: Closure | None
    rejected: tuple[Rejected, ...]
    notes: tuple[str, ...]
    misfits: tuple[str, ...] = ()


def diagnose_sensors(
    recording: Recording, effects: Sequence[SensorEffect], settings: DiagnosisSettings = DEFAULT, seed: int = 0
) -> SensorDiagnosis:
    """Say whether the raw sensor tables depart from the nominal sensors, and by which effects.

    Parameters
    ----------
    recording : with raw sensor tables and an ephemeris
    effects : that may be named
    settings : thresholds and priors
    seed : of the null distribution

    Raises
    ------
    InputError
        The tables cannot be used.
    """
    wrong = find_misreading(recording)
    if wrong is not None:
        return _nothing_fits(wrong, settings)
    try:
        explained = explain_tables(recording, effects, settings, seed)
    except MisfitError as error:
        return _nothing_fits(str(error), settings)
    return _assembled(explained, settings)


def explain_tables(
    recording: Recording, effects: Sequence[SensorEffect], settings: DiagnosisSettings = DEFAULT, seed: int = 0
) -> ExplainedTables:
    """What the raw tables of a recording say; parameters and errors of `diagnose_sensors`.

    Raises
    ------
    MisfitError
        The measurements of no arc fit the nominal sensors.
    """
    arcs, skipped = arcs_of(recording)
    fits, unfitted, misfits = fitted_arcs(arcs)
    if not effects:
        raise InputError("no sensor effect may be named")
    about_m0 = build_tables(fits, effects)
    linear = linear_model(about_m0, effects, settings)
    noise, search = _search(linear, settings)
    p = p_value(search, seed, settings.null_draws)
    attribution: Attribution | None = None
    fitted: tuple[Fitted, ...] = ()
    closed: Closure | None = None
    rejected: tuple[Rejected, ...] = ()
    if p < settings.false_alarm_rate:
        attribution = attribute(search.model, search.explanations(), settings)
        found = relinearised(fits, effects, listed_part(search.model, attribution), settings)
        if found is not None:
            linear = found
            noise, search = _search(linear, settings)
            attribution = attribute(search.model, search.explanations(), settings)
        if attribution.slots:  # nothing checks what is left in the tables
            attribution = weigh_unlisted(search.model, attribution, 1.0, settings)
        members = tuple(slot.member for slot in attribution.slots)
        if members:
            fitted = tuple(fit(search.model, members))
            closed = compute_closure(linear, members)
            rejected = _rejected(linear, search, attribution, fitted, effects)
    p = min(p, noise.p_value)
    return ExplainedTables(
        tuple(fits), about_m0, linear, search, noise, p, attribution, fitted, closed, rejected, (*skipped, *unfitted),
        tuple(misfits),
    )  # fmt: skip


def _search(linear: LinearModel, settings: DiagnosisSettings) -> tuple[Noise, Search]:
    """The noise, and a search in units of it."""
    noise = noise_of(linear, settings)
    return noise, Search(in_noise(linear, noise.factor), settings)


def listed_part(model: LinearModel, attribution: Attribution) -> dict[str, Held]:
    """Amplitudes of the listed effects of the likeliest explanation, by label.

    They are found for an unknown too: the second order of what is listed must not look like another effect.
    """
    members = [member for member in attribution.best.members if model.candidate(member).listed]
    return {one.label: Held(one.amplitudes, one.parameters) for one in fit(model, members)} if members else {}


def relinearised(
    fits: Sequence[FittedArc], effects: Sequence[SensorEffect], found: Mapping[str, Held], settings: DiagnosisSettings
) -> LinearModel | None:
    """The linear model about amplitudes that were found; None where there are none, or the arcs do not fit with them."""
    if not found:
        return None
    held = refine_parameters(fits, found)
    try:
        again = [fit_arc(one.arc, *held_error(one.arc.sightings, held)) for one in fits]
    except (UnobservableError, InputError):
        return None
    return linear_model(build_tables(again, effects, held), effects, settings)


def _rejected(
    linear: LinearModel, search: Search, attribution: Attribution, fitted: Sequence[Fitted], effects: Sequence[SensorEffect]
) -> tuple[Rejected, ...]:
    """The explanation of an alignment calibration, tested beside what is named."""
    labels = orthogonal_labels([one.label for one in fitted], effects)
    other = search.of(labels)
    held_out = compute_closure(linear, other.members) if other is not None else None
    if other is None or held_out is None:
        return ()
    factor = attribution.best.log_evidence - other.log_evidence
    p = max(float(chdtrc(linear.dof, held_out.after * linear.dof)), TINY)
    return (Rejected(labels, factor, held_out.before, held_out.after, p),)


# ---- the answer ----------------------------------------------------------------------------------------------------------


def verdict_of(explained: ExplainedTables, settings: DiagnosisSettings = DEFAULT) -> tuple[Verdict, bool, Attribution | None]:
    """Verdict, whether there is a gap, and the attribution that stands behind it."""
    attribution = explained.attribution
    if explained.misfits:
        return "unknown", True, attribution
    if attribution is None:
        return ("unknown", True, None) if explained.noise.factor > 1 else ("none", False, None)
    of_gyro = sum(one.probability for one in attribution.ranked if set(one.labels) <= {GYRO})
    if of_gyro > settings.unknown and explained.noise.factor == 1:  # no matter of the sensors
        return "none", False, None
    return attribution.verdict, True, attribution


def _assembled(explained: ExplainedTables, settings: DiagnosisSettings) -> SensorDiagnosis:
    verdict, present, attribution = verdict_of(explained, settings)
    y = explained.about_m0.y
    dof = explained.linear.dof
    held = {one.label: Held(one.amplitudes, one.parameters) for one in explained.fitted}
    misfits = [Finding(ANY, None, None, None, "fit", 0.0, TINY, text) for text in explained.misfits]
    where = (*misfits, *_noise_finding(explained.noise), *findings(explained.about_m0, settings.false_alarm_rate))
    return SensorDiagnosis(
        verdict=verdict,
        present=present,
        p_value=TINY if misfits else explained.p_value,
        false_alarm_rate=settings.false_alarm_rate,
        mean_square=float(y @ y) / dof,
        dof=dof,
        where=where if present else (),
        causes=causes_of(attribution, explained.fitted),
        alternatives=alternatives(attribution),
        unknown_probability=min(1.0, float(attribution.unknown)) if attribution and not misfits else float(present),
        closure=_in_order(explained),
        rejected=explained.rejected,
        notes=(
            *identifiable(explained.linear, list(held)),
            COMMON,
            *_gyro_note(explained),
            *explained.notes,
            *_noise_note(explained),
        ),
        posterior=((("unknown",), 1.0),) if misfits or (present and not attribution) else of_attitude(attribution),
        residuals=residual_table(explained.fits, held),
        explanations=explanation_table(explained.attribution),
    )


def _in_order(explained: ExplainedTables) -> Closure | None:
    """The closure with its arcs in the order of the mission rather than of the folds."""
    if explained.closed is None:
        return None
    table = explained.closed.by_interval.set_index("interval").loc[list(explained.about_m0.names)]
    return replace(explained.closed, by_interval=table.reset_index())


def _gyro_note(explained: ExplainedTables) -> tuple[str, ...]:
    if explained.attribution is None or GYRO not in explained.attribution.ranked[0].labels:
        return ()
    return ("The sensors' residuals look like a rate error at orbit rate, an error of the gyro and not of the sensors",)


def _noise_note(explained: ExplainedTables) -> tuple[str, ...]:
    factor = explained.noise.factor
    if factor == 1:
        return ()
    return (f"The noise of the sensors is {factor:.3f} times what is stated; evidence and sigmas are for that",)


def _noise_finding(noise: Noise) -> tuple[Finding, ...]:
    if noise.factor == 1:
        return ()
    text = (
        "the sensor tables do not fit the nominal sensors: the noise left after all listed errors is "
        f"{noise.factor:.3g} times the stated one"
    )
    return (Finding(ANY, None, None, None, "noise", noise.factor, noise.p_value, text),)


def _nothing_fits(why: str, settings: DiagnosisSettings) -> SensorDiagnosis:
    """The answer where the measurements do not fit the nominal sensors at all, and why."""
    text = f"the sensor tables do not fit the nominal sensors: {why}"
    return SensorDiagnosis(
        verdict="unknown",
        present=True,
        p_value=TINY,
        false_alarm_rate=settings.false_alarm_rate,
        mean_square=None,
        dof=0,
        where=(Finding(ANY, None, None, None, "fit", 0.0, TINY, text),),
        causes=(),
        alternatives=(),
        unknown_probability=1.0,
        closure=None,
        rejected=(),
        notes=(COMMON,),
        posterior=((("unknown",), 1.0),),
        residuals=residual_table((), {}),
        explanations=explanation_table(None),
    )
