"""Diagnose raw sensor tables: arcs, linear model, causes (`diagnosis.explain`), answer.

The linear model is built twice: about M0, and, where there is a misfit, about the fitted amplitudes, whose errors are
subtracted from the measurements before the arcs are fitted again. An error of 0.2° has a second-order error of 0.0007°, a
hundredth of which is visible in thousands of measurements; after the second fit 1e-6° remains.

An alignment calibration solves for orthogonal matrices and biases only. It mistakes errors of the heads for a misalignment of
DSS-2, and a rotation by DSS-1's head for biases of the Earth sensor. This explanation is tested beside the named one, with the
other named causes in the model. `simulator.effects.sensor.SensorEffect.alignment` says which effects such a calibration solves
for, and which it mistakes for them.
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

ANY = "sensors"  # signal of a finding on all sensors together
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
    """Fits, linear model and inferred causes of the raw tables."""

    fits: tuple[FittedArc, ...]  # the arcs under M0
    about_m0: Tables  # columns and residuals about M0
    linear: LinearModel  # the linear model about the fitted amplitudes, in units of the stated noise
    noise: Noise  # estimated noise of the sensors
    # causes in units of the estimated noise; the p-value is that of M0, against all candidates and the level of the noise
    inference: AttitudeInference
    notes: tuple[str, ...]  # measurements that were left out
    misfits: tuple[str, ...] = ()  # of each arc that does not fit the nominal sensors at all, while others do

    @property
    def scaled_model(self) -> LinearModel:
        """Linear model in units of the estimated noise."""
        return rescale_noise(self.linear, self.noise.factor)


def diagnose_sensors(
    recording: Recording, effects: Sequence[SensorEffect], settings: DiagnosisSettings = DEFAULT, seed: int = 0
) -> SensorDiagnosis:
    """Diagnose whether the raw sensor tables depart from the nominal sensors, and by which of the effects.

    Raises an `InputError` if the tables, or their ephemeris, cannot be used. The seed is that of the null distribution.
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

    Raises a `MisfitError` if the measurements of no arc fit the nominal sensors.
    """
    arcs, skipped = build_arcs(recording)
    fits, unfitted, misfits = fit_arcs(arcs)
    if not effects:
        raise InputError("no sensor effect may be named")
    about_m0 = build_tables(fits, effects)
    linear = build_sensor_model(about_m0, effects, settings)
    noise = estimate_sensor_noise(linear, settings)
    # No data are held out yet: where there is a misfit, the model is built again.
    unfolded = replace(rescale_noise(linear, noise.factor), folds=lambda W: ())
    inference, inferred_set = infer_causes(unfolded, settings, seed, _ignore_progress)
    p = inference.p_value
    if inferred_set is not None:
        # Also for an unknown cause: second-order errors of listed effects must not look like another effect.
        model, members = inferred_set.linear, inferred_set.best.members
        listed = [member for member in members if model.candidate(member).listed]
        relinearised = relinearise_tables(fits, effects, _collect_amplitudes(fit(model, listed)), settings) if listed else None
        if relinearised is not None:
            linear, noise = relinearised, estimate_sensor_noise(relinearised, settings)
        inference, inferred_set = infer_causes(rescale_noise(linear, noise.factor), settings, seed, _ignore_progress, p)
    if inferred_set is not None and inference.fitted:
        inference = replace(inference, closed=compute_closure(inferred_set.linear, inferred_set.best.members))
    inference = replace(inference, p_value=min(p, noise.p_value))
    return ExplainedTables(tuple(fits), about_m0, linear, noise, inference, (*skipped, *unfitted), tuple(misfits))


def _ignore_progress(text: str, share: float) -> None:
    """Report no progress: the tables take a second or two."""


def _collect_amplitudes(fitted: Sequence[FittedEffect]) -> dict[str, HeldAmplitudes]:
    return {effect.label: HeldAmplitudes(effect.amplitudes, effect.parameters) for effect in fitted}


def relinearise_tables(
    fits: Sequence[FittedArc],
    effects: Sequence[SensorEffect],
    fitted: Mapping[str, HeldAmplitudes],
    settings: DiagnosisSettings,
) -> LinearModel | None:
    """Build the linear model about fitted amplitudes; None where the arcs do not fit with them."""
    amplitudes = refine_parameters(fits, fitted)
    try:
        refitted = [fit_arc(fit.arc, *compute_held_error(fit.arc.sightings, amplitudes)) for fit in fits]
    except (UnobservableError, InputError):
        return None
    return build_sensor_model(build_tables(refitted, effects, amplitudes), effects, settings)


def decide_sensor_verdict(
    explained: ExplainedTables, settings: DiagnosisSettings = DEFAULT
) -> tuple[Verdict, Attribution | None]:
    """Decide the verdict; also return the attribution that it is based on."""
    attribution = explained.inference.attribution
    if explained.misfits:
        return "unknown", attribution
    if attribution is None:
        return "unknown" if explained.noise.factor > 1 else "none", None
    of_gyro = [explanation for explanation in attribution.ranked if set(explanation.labels) <= {GYRO_RIVAL}]
    gyro_probability = sum(explanation.probability for explanation in of_gyro)
    if gyro_probability > settings.unknown and explained.noise.factor == 1:  # an error of the gyro, not of the sensors
        return "none", None
    return attribution.verdict, attribution


def _build_answer(explained: ExplainedTables, effects: Sequence[SensorEffect], settings: DiagnosisSettings) -> SensorDiagnosis:
    (verdict, attribution), inference = decide_sensor_verdict(explained, settings), explained.inference
    present, misfits = verdict != "none", explained.misfits
    y, dof = explained.about_m0.y, explained.linear.dof
    amplitudes = _collect_amplitudes(inference.fitted)
    where = (
        *map(_find_misfit, misfits),
        *_find_noise(explained.noise),
        *list_sensor_findings(explained.about_m0, settings.false_alarm_rate),
    )
    return SensorDiagnosis(
        verdict=verdict,
        present=present,
        p_value=LEAST_POSITIVE if misfits else inference.p_value,
        false_alarm_rate=settings.false_alarm_rate,
        where=where if present else (),
        mean_square=float(y @ y) / dof,
        dof=dof,
        causes=list_attitude_causes(attribution, inference.fitted),
        alternatives=list_next_explanations(attribution),
        unknown_probability=min(1.0, float(attribution.unknown)) if attribution and not misfits else float(present),
        closure=_order_arcs(inference.closed, explained.about_m0.names),
        rejected=_reject(explained, effects),
        notes=(UNOBSERVABLE_ROTATION_NOTE, *_list_notes(explained)),
        posterior=((("unknown",), 1.0),)
        if misfits or (present and not attribution)
        else list_attitude_explanations(attribution),
        residuals=tabulate_sensor_residuals(explained.fits, amplitudes),
    )


def _reject(explained: ExplainedTables, effects: Sequence[SensorEffect]) -> tuple[RejectedExplanation, ...]:
    """Test the explanation of an alignment calibration beside the named causes; empty where there is none."""
    inference, linear = explained.inference, explained.scaled_model
    labels = list_orthogonal([effect.label for effect in inference.fitted], effects)
    alternative = Search(linear).find_explanation(labels) if labels else None
    held_out = compute_closure(linear, alternative.members) if alternative is not None else None
    if alternative is None or held_out is None or inference.attribution is None:
        return ()
    factor = inference.attribution.best.log_evidence - alternative.log_evidence
    p = max(float(chdtrc(linear.dof, held_out.after * linear.dof)), LEAST_POSITIVE)
    return (RejectedExplanation(labels, factor, held_out.before, held_out.after, p),)


def _order_arcs(closed: Closure | None, names: Sequence[str]) -> Closure | None:
    """Sort the arcs of a closure in the order of the mission rather than of the folds."""
    if closed is None:
        return None
    return replace(closed, by_interval=closed.by_interval.set_index("interval").loc[list(names)].reset_index())


def _list_notes(explained: ExplainedTables) -> tuple[str, ...]:
    notes, attribution, factor = list(explained.notes), explained.inference.attribution, explained.noise.factor
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
    """List the labels of the effects that an alignment calibration solves for; none where one of them is not in the library."""
    solved = [effect for effect in SENSOR_EFFECTS.values() if effect.alignment == "solved"]
    names = {effect.name for effect in effects}
    return tuple(effect.name for effect in solved) if all(effect.name in names for effect in solved) else ()


def list_orthogonal(named: Sequence[str], effects: Iterable[SensorEffect]) -> tuple[str, ...]:
    """List the labels of an alignment calibration's explanation: its effects in place of the named causes that it mistakes.

    There are none where it mistakes no named cause.
    """
    solved = list_solved_for(effects)
    not_mistaken = [label for label in named if find_sensor_effect(label)[0].alignment != "mistaken"]
    return tuple(dict.fromkeys([*not_mistaken, *solved])) if len(not_mistaken) < len(named) and solved else ()


def tabulate_sensor_residuals(fits: Sequence[FittedArc], amplitudes: Mapping[str, HeldAmplitudes]) -> pd.DataFrame:
    """Tabulate the residuals of all measurements under M0 and of a fit with the errors of fitted amplitudes subtracted."""
    tables = [pd.DataFrame(columns=SENSOR_RESIDUAL_COLUMNS)] if not fits else []
    for before in fits:
        arc = before.arc
        after = fit_arc(arc, *compute_held_error(arc.sightings, amplitudes)) if amplitudes else before
        for series, number, residuals_before, residuals_after in zip(
            arc.series, arc.numbers, before.residuals, after.residuals, strict=True
        ):
            sun_angles = arc.sightings.sun_angles[arc.sightings.sun_sensor == number] if number else None
            for k, angle in enumerate(SENSOR_ANGLE_NAMES[number]):
                values = (
                    SENSOR_NAMES[number],
                    angle,
                    arc.name,
                    series.t,
                    np.nan if sun_angles is None else np.rad2deg(sun_angles[:, 0]),
                    np.nan if sun_angles is None else np.rad2deg(sun_angles[:, 1]),
                    np.rad2deg(residuals_before[:, k]),
                    np.rad2deg(residuals_after[:, k]),
                )
                tables.append(pd.DataFrame(dict(zip(SENSOR_RESIDUAL_COLUMNS, values, strict=True))))
    return pd.concat(tables, ignore_index=True)


def list_sensor_findings(tables: Tables, rate: float) -> tuple[Finding, ...]:
    """Test each sensor by itself: χ² of the columns that an error of it may have; significant findings, strongest first."""
    findings = []
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
            findings.append(Finding(signal, None, None, None, "chi2", chi2, p, sentence))
    return tuple(sorted(findings, key=lambda finding: -finding.value))
