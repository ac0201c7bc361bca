"""A diagnosis of raw sensor tables: arcs, linear model, what it says (`diagnosis.explain`), answer.

The linear model is made twice: about M0, and, where there is a gap, about the amplitudes found, which are taken off the
measurements before the arcs are fitted again. An error of 0.2° leaves 0.0007° of second order, a hundredth of which would be
seen in thousands of measurements; after the second round 1e-6° is left.

An alignment calibration knows orthogonal matrices and biases only. In place of the heads it puts a misalignment of DSS-2, and
of what DSS-1's head turns, biases of the Earth sensor. That explanation is tested beside the one that is named, with what is
named otherwise left in. Which effects it solves for, and which it mistakes for them, the effects say themselves
(`simulator.effects.sensor.SensorEffect.alignment`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import scipy.linalg
from scipy.special import chdtrc

from diagnosis.answer import Closure, Finding, Verdict
from diagnosis.arrays import LEAST_POSITIVE
from diagnosis.assemble import list_attitude_causes, list_next_explanations
from diagnosis.explain import AttitudeInference, infer_causes
from diagnosis.inference.amplitudes import FittedEffect, fit
from diagnosis.inference.closure import compute_closure
from diagnosis.inference.search import Search
from diagnosis.model.linear import LinearModel
from diagnosis.model.sensors.arcs import FittedArc, MisfitError, build_arcs, fit_arc, fit_arcs
from diagnosis.model.sensors.columns import GYRO_RIVAL, HeldAmplitudes, compute_held_error, find_sensor_effect
from diagnosis.model.sensors.refine import refine_parameters
from diagnosis.model.sensors.tables import Noise, Tables, build_sensor_model, build_tables, estimate_sensor_noise, rescale_noise
from diagnosis.posterior import Attribution, list_attitude_explanations
from diagnosis.sensor_result import SENSOR_RESIDUAL_COLUMNS, RejectedExplanation, SensorDiagnosis
from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.errors import InputError, UnobservableError
from gyrocal.recording import Recording
from simulator.effects.sensor import SENSOR_EFFECTS, SensorEffect

ANY = "sensors"  # signal of what is no matter of one sensor alone
UNOBSERVABLE_ROTATION_NOTE = (
    "A rotation of all sensors together is an attitude error and cannot be seen; DSS-1 and the Earth sensor's model are the "
    "reference, so a misalignment of DSS-1 shows as one of DSS-2 and as biases of the Earth sensor"
)

SENSOR_ANGLE_NAMES = {
    0: ("penetration 1", "penetration 2", "penetration 3", "penetration 4"),
    1: ("alpha", "beta"),
    2: ("alpha", "beta"),
}
SENSOR_NAMES = {0: "ESA", 1: "DSS-1", 2: "DSS-2"}
RIVAL_FINDINGS = {  # signal and words for residuals that follow the columns of a rival
    "smooth error of DSS-1": ("DSS-1", "residuals of DSS-1 follow where the Sun is in its field of view"),
    "smooth error of DSS-2": ("DSS-2", "residuals of DSS-2 follow where the Sun is in its field of view"),
    "Earth sensor at orbit harmonics": ("ESA", "quadrants of the Earth sensor are off at the orbit's harmonics"),
    "Earth sensor near the Sun": ("ESA", "quadrants of the Earth sensor are off near the Sun"),
}

SEEN = 1e-5  # relative singular value of a sensor's columns, below which one adds nothing to the others


@dataclass(frozen=True)
class ExplainedTables:
    """What the raw tables say."""

    fits: tuple[FittedArc, ...]  # the arcs under M0
    about_m0: Tables  # columns and residuals about M0
    linear: LinearModel  # the linear model about what was found, in units of the noise as stated
    noise: Noise  # of the sensors, beside what is stated
    # what the linear model says, in units of the noise found; its p-value is that of M0, in any candidate or in its noise
    found: AttitudeInference
    notes: tuple[str, ...]  # what was left out
    misfits: tuple[str, ...] = ()  # of each arc that does not fit the nominal sensors at all, while others do

    @property
    def scaled_model(self) -> LinearModel:
        """The linear model in units of the noise found."""
        return rescale_noise(self.linear, self.noise.factor)


def diagnose_sensors(
    recording: Recording, effects: Sequence[SensorEffect], settings: DiagnosisSettings = DEFAULT, seed: int = 0
) -> SensorDiagnosis:
    """Say whether the raw sensor tables depart from the nominal sensors, and by which of the effects.

    An `InputError` if the tables, or their ephemeris, cannot be used. The seed is that of the null distribution.
    """
    try:
        return _build_answer(explain_tables(recording, effects, settings, seed), effects, settings)
    except MisfitError as error:
        where = (_find_misfit(f"the sensor tables do not fit the nominal sensors: {error}"),)
    return SensorDiagnosis(
        "unknown", True, LEAST_POSITIVE, settings.false_alarm_rate, where, notes=(UNOBSERVABLE_ROTATION_NOTE,)
    )


def explain_tables(
    recording: Recording, effects: Sequence[SensorEffect], settings: DiagnosisSettings = DEFAULT, seed: int = 0
) -> ExplainedTables:
    """Explain the raw tables of a recording; parameters and errors of `diagnose_sensors`.

    A `MisfitError` if the measurements of no arc fit the nominal sensors.
    """
    arcs, skipped = build_arcs(recording)
    fits, unfitted, misfits = fit_arcs(arcs)
    if not effects:
        raise InputError("no sensor effect may be named")
    about_m0 = build_tables(fits, effects)
    linear = build_sensor_model(about_m0, effects, settings)
    noise = estimate_sensor_noise(linear, settings)
    # Nothing is held out yet, as where there is a gap the model is made anew.
    first = replace(rescale_noise(linear, noise.factor), folds=lambda W: ())
    found, inferred = infer_causes(first, settings, seed, _tell_nobody)
    p = found.p_value
    if inferred is not None:
        # For an unknown too: the second order of what is listed must not look like another effect.
        model, members = inferred.linear, inferred.best.members
        listed = [member for member in members if model.candidate(member).listed]
        anew = relinearise_tables(fits, effects, _hold(fit(model, listed)) if listed else {}, settings)
        if anew is not None:
            linear, noise = anew, estimate_sensor_noise(anew, settings)
        found, inferred = infer_causes(rescale_noise(linear, noise.factor), settings, seed, _tell_nobody, p)
    if inferred is not None and found.fitted:
        found = replace(found, closed=compute_closure(inferred.linear, inferred.best.members))
    found = replace(found, p_value=min(p, noise.p_value))
    return ExplainedTables(tuple(fits), about_m0, linear, noise, found, (*skipped, *unfitted), tuple(misfits))


def _tell_nobody(text: str, share: float) -> None:
    """No progress: the tables take a second or two."""


def _hold(fitted: Sequence[FittedEffect]) -> dict[str, HeldAmplitudes]:
    return {one.label: HeldAmplitudes(one.amplitudes, one.parameters) for one in fitted}


def relinearise_tables(
    fits: Sequence[FittedArc], effects: Sequence[SensorEffect], found: Mapping[str, HeldAmplitudes], settings: DiagnosisSettings
) -> LinearModel | None:
    """The linear model about amplitudes that were found; None where there are none, or the arcs do not fit with them."""
    if not found:
        return None
    held = refine_parameters(fits, found)
    try:
        again = [fit_arc(one.arc, *compute_held_error(one.arc.sightings, held)) for one in fits]
    except (UnobservableError, InputError):
        return None
    return build_sensor_model(build_tables(again, effects, held), effects, settings)


def decide_sensor_verdict(
    explained: ExplainedTables, settings: DiagnosisSettings = DEFAULT
) -> tuple[Verdict, Attribution | None]:
    """Decide the verdict, and return the attribution that stands behind it."""
    attribution = explained.found.attribution
    if explained.misfits:
        return "unknown", attribution
    if attribution is None:
        return "unknown" if explained.noise.factor > 1 else "none", None
    of_gyro = sum(one.probability for one in attribution.ranked if set(one.labels) <= {GYRO_RIVAL})
    if of_gyro > settings.unknown and explained.noise.factor == 1:  # no matter of the sensors
        return "none", None
    return attribution.verdict, attribution


def _build_answer(explained: ExplainedTables, effects: Sequence[SensorEffect], settings: DiagnosisSettings) -> SensorDiagnosis:
    (verdict, attribution), found = decide_sensor_verdict(explained, settings), explained.found
    present, misfits = verdict != "none", explained.misfits
    y, dof = explained.about_m0.y, explained.linear.dof
    held = _hold(found.fitted)
    where = (
        *map(_find_misfit, misfits),
        *_find_noise(explained.noise),
        *list_sensor_findings(explained.about_m0, settings.false_alarm_rate),
    )
    return SensorDiagnosis(
        verdict=verdict,
        present=present,
        p_value=LEAST_POSITIVE if misfits else found.p_value,
        false_alarm_rate=settings.false_alarm_rate,
        where=where if present else (),
        mean_square=float(y @ y) / dof,
        dof=dof,
        causes=list_attitude_causes(attribution, found.fitted),
        alternatives=list_next_explanations(attribution),
        unknown_probability=min(1.0, float(attribution.unknown)) if attribution and not misfits else float(present),
        closure=_order(found.closed, explained.about_m0.names),
        rejected=_reject(explained, effects),
        notes=(UNOBSERVABLE_ROTATION_NOTE, *_list_notes(explained)),
        posterior=((("unknown",), 1.0),)
        if misfits or (present and not attribution)
        else list_attitude_explanations(attribution),
        residuals=tabulate_sensor_residuals(explained.fits, held),
    )


def _reject(explained: ExplainedTables, effects: Sequence[SensorEffect]) -> tuple[RejectedExplanation, ...]:
    """The explanation of an alignment calibration, tested beside what is named."""
    found, linear = explained.found, explained.scaled_model
    labels = list_orthogonal([one.label for one in found.fitted], effects)
    other = Search(linear).find_explanation(labels) if labels else None
    held_out = compute_closure(linear, other.members) if other is not None else None
    if other is None or held_out is None or found.attribution is None:
        return ()
    factor = found.attribution.best.log_evidence - other.log_evidence
    p = max(float(chdtrc(linear.dof, held_out.after * linear.dof)), LEAST_POSITIVE)
    return (RejectedExplanation(labels, factor, held_out.before, held_out.after, p),)


def _order(closed: Closure | None, names: Sequence[str]) -> Closure | None:
    """The closure with its arcs in the order of the mission rather than of the folds."""
    if closed is None:
        return None
    return replace(closed, by_interval=closed.by_interval.set_index("interval").loc[list(names)].reset_index())


def _list_notes(explained: ExplainedTables) -> tuple[str, ...]:
    notes, attribution, factor = list(explained.notes), explained.found.attribution, explained.noise.factor
    if attribution is not None and GYRO_RIVAL in attribution.ranked[0].labels:
        gyro = "The sensors' residuals look like a rate error at orbit rate, an error of the gyro and not of the sensors"
        notes.insert(0, gyro)
    if factor > 1:
        notes.append(f"The noise of the sensors is {factor:.3f} times what is stated; evidence and sigmas are for that")
    return tuple(notes)


def _find_misfit(text: str) -> Finding:
    return Finding(ANY, None, None, None, "fit", 0.0, LEAST_POSITIVE, text)


def _find_noise(noise: Noise) -> tuple[Finding, ...]:
    if noise.factor == 1:
        return ()
    text = (
        "the sensor tables do not fit the nominal sensors: the noise left after all listed errors is "
        f"{noise.factor:.3g} times the stated one"
    )
    return (Finding(ANY, None, None, None, "noise", noise.factor, noise.p_value, text),)


def list_solved_for(effects: Iterable[SensorEffect]) -> tuple[str, ...]:
    """List the labels of what an alignment calibration solves for; none where one of them is not among the effects."""
    whole = [effect for effect in SENSOR_EFFECTS.values() if effect.alignment == "solved"]
    given = {effect.name for effect in effects}
    return tuple(effect.name for effect in whole) if all(effect.name in given for effect in whole) else ()


def list_orthogonal(named: Sequence[str], effects: Iterable[SensorEffect]) -> tuple[str, ...]:
    """List the labels of the explanation of an alignment calibration beside the one that is named.

    There are none where no named cause is one that such a calibration mistakes.
    """
    others = list_solved_for(effects)
    kept = [label for label in named if find_sensor_effect(label)[0].alignment != "mistaken"]
    return tuple(dict.fromkeys([*kept, *others])) if len(kept) < len(named) and others else ()


def tabulate_sensor_residuals(fits: Sequence[FittedArc], held: Mapping[str, HeldAmplitudes]) -> pd.DataFrame:
    """Residuals of all measurements under M0, and of a fit with some effects taken off the measurements."""
    parts = [pd.DataFrame(columns=SENSOR_RESIDUAL_COLUMNS)] if not fits else []
    for before in fits:
        arc = before.arc
        after = fit_arc(arc, *compute_held_error(arc.sightings, held)) if held else before
        for series, number, old, new in zip(arc.series, arc.numbers, before.residuals, after.residuals, strict=True):
            looked = arc.sightings.sun_angles[arc.sightings.sun_sensor == number] if number else None
            for k, angle in enumerate(SENSOR_ANGLE_NAMES[number]):
                values = (
                    SENSOR_NAMES[number],
                    angle,
                    arc.name,
                    series.t,
                    np.nan if looked is None else np.rad2deg(looked[:, 0]),
                    np.nan if looked is None else np.rad2deg(looked[:, 1]),
                    np.rad2deg(old[:, k]),
                    np.rad2deg(new[:, k]),
                )
                parts.append(pd.DataFrame(dict(zip(SENSOR_RESIDUAL_COLUMNS, values, strict=True))))
    return pd.concat(parts, ignore_index=True)


def list_sensor_findings(tables: Tables, rate: float) -> tuple[Finding, ...]:
    """Tests of each sensor by itself: chi-square of the columns that an error of it may have, the strongest first."""
    found = []
    for group in tables.groups:
        finding = SENSOR_EFFECTS[group.effect].finding if group.listed else RIVAL_FINDINGS.get(group.effect)
        if finding is None:
            continue
        basis = scipy.linalg.orth(np.hstack(group.columns), rcond=SEEN)
        chi2, count = float(np.sum((basis.T @ tables.y) ** 2)), basis.shape[1]
        p = float(max(chdtrc(count, chi2), LEAST_POSITIVE)) if count else 1.0
        if p < rate:
            signal, text = finding
            sentence = f"{text} (χ² {chi2:.4g}, {count} expected)"
            found.append(Finding(signal, None, None, None, "chi2", chi2, p, sentence))
    return tuple(sorted(found, key=lambda one: -one.value))
