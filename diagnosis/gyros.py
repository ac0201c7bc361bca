"""A whole diagnosis of more gyros than three: the samples of each, then parity and attitude together.

1. *Dead.* A gyro whose samples no longer change is found in them; the rest is done without it.
2. *Samples.* Every test of the samples is made of each gyro, three at a time.
3. *Linearisation.* K and c by parity and attitude, without which a percent of scale factor would look like an effect.
4. *Which.* One linear model of parity and attitude (`diagnosis.model.gyros`), searched and judged as any other.

Where no more than three gyros are left there is no parity, and the body rates are diagnosed as those of three gyros. Without
reference attitudes only parity and samples are tested. An error that all gyros have alike is then not seen, and the answer
says so.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import scipy.special
from numpy.typing import NDArray

from diagnosis.answer import Finding
from diagnosis.assemble import AnswerInputs, build_answer, collect_p_values
from diagnosis.detail_tables import build_details, tabulate_explanations, test_table
from diagnosis.detectors.sample_report import Findings, SampleTest, Symptom
from diagnosis.detectors.samples import examine
from diagnosis.explain import AttitudeInference, explain, infer_causes
from diagnosis.inference.criticism import Check, check_explanation
from diagnosis.model import localization
from diagnosis.model.array_model import ArrayModel
from diagnosis.model.calibration import calibrate_with_effects
from diagnosis.model.folds import SETTINGS as FOLDS
from diagnosis.model.gyros import build_array_model
from diagnosis.model.layout import tabulate_observations
from diagnosis.model.linear import LinearModel, SelectedCandidate
from diagnosis.model.parity import ParityModel, build_parity_model
from diagnosis.model.prepare import PreparedRecording, prepare
from diagnosis.model.symptoms import assign_symptoms, drop_estimated_levels, list_reference_symptoms
from diagnosis.result import Details, Diagnosis
from diagnosis.settings import DiagnosisSettings
from gyrocal.calibration.gyros import GyroArray, calibrate_gyros, fit_to_parity
from gyrocal.calibration.observability import PLAUSIBLE_BIAS, PLAUSIBLE_G
from gyrocal.errors import InputError
from gyrocal.recording import Recording, triad
from gyrocal.recording.gyros import compute_gyro_gain, compute_nominal_gyros, select_interval_samples
from gyrocal.recording.parts import GyroStream, build_empty_attitudes
from simulator.effects.base import Effect, SampleView

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

NOTHING_TO_SEE = AttitudeInference((), 1.0, None, (), (), None, np.zeros(12), np.zeros((12, 12)))


def diagnose_gyros(
    recording: Recording, effects: Sequence[Effect], settings: DiagnosisSettings, seed: int, tell: Progress
) -> Diagnosis:
    """Diagnose a recording of other gyros than x, y and z; parameters as for `diagnosis.diagnose.diagnose`.

    Raises
    ------
    InputError
        The recording states no gyro noise, or has neither parity nor reference attitudes.
    """
    began = time.perf_counter()
    if not recording.gyro.arw > 0:
        raise InputError("the recording states no gyro noise, by which gyros are compared; give arw_deg_per_sqrt_s")
    most = max(recording.switched_on(k).size for k in range(len(recording.intervals)))
    if most <= 3 and not recording.attitudes.t_s.size:
        raise InputError("neither more than three gyros at a time nor reference attitudes are there: nothing to compare with")
    tell("gyro samples", 0.0)
    of_arrays = [effect for effect in effects if effect.of_arrays and effect.implements("detect")]
    of_one = [effect for effect in effects if not effect.of_arrays]
    dead = assign_symptoms([], [], of_arrays, _build_sample_view(recording), settings)
    failed = [str(one.symptom.axis) for one in dead]
    recording = leave_out(recording, failed) if failed else recording
    shown, noise, notes = test_samples(recording, settings)
    if failed:
        notes = (f"Gyro {', '.join(failed)} is left out of all that follows, also before it failed", *notes)
    start = GyroArray(recording.gyro.names, *compute_nominal_gyros(recording.gyro))
    gyros, body = linearise_gyros(recording, start, noise, settings)
    symptoms = [
        *drop_estimated_levels(shown.symptoms, recording),
        *([] if body is None else list_reference_symptoms(body)),
    ]
    samples = (*dead, *assign_symptoms(symptoms, shown.tests, of_one, _build_sample_view(recording), settings))
    parity = build_parity_model(recording, gyros, recording.gyro.arw * noise)
    explained, where = NOTHING_TO_SEE, tuple[Finding, ...]()
    if parity is not None:
        model = ArrayModel(recording, parity, None if body is None else body.model)
        explained, where = explain_array(model, effects, settings, seed, tell)
    elif body is not None:
        explained = explain(body, of_one, settings, seed, tell)
        notes = (*notes, "Without parity, axes are those of the body")
    else:
        notes = (*notes, "No more than three gyros are left, and no reference attitudes: only the samples could be tested")
    if body is None:
        seen = _build_parity_inputs(recording.title, start, explained, shown, where)
    else:
        seen = _build_attitude_inputs(body, explained, gyros, shown, where, noise)
    seen = replace(seen, notes=(*notes, *seen.notes))
    return build_answer(seen, samples, explained, settings, time.perf_counter() - began)


def explain_array(
    model: ArrayModel, effects: Sequence[Effect], settings: DiagnosisSettings, seed: int, tell: Progress
) -> tuple[AttitudeInference, tuple[Finding, ...]]:
    """Explain parity and attitude, and find gyros and intervals that depart; parameters as of `diagnose_gyros`."""
    tell("candidates", 0.1)
    linear = build_array_model(model, effects, settings)
    explained = infer_causes(linear, partial(check_array, model, seed), settings, seed, tell)
    if explained.p_value >= settings.false_alarm_rate:
        return explained, ()
    return explained, (*find_faulty_gyros(explained, model.stream.gyros, settings), *find_parity(model, settings))


# ---- samples -------------------------------------------------------------------------------------------------------------


def _build_sample_view(recording: Recording) -> SampleView:
    """View the samples of the intervals in which all gyros were on."""
    gyro = recording.gyro
    n = len(gyro.names)
    parts = [
        select_interval_samples(recording, k)[0] for k in range(len(recording.intervals)) if recording.switched_on(k).size == n
    ]
    used = np.zeros(gyro.t_s.size, dtype=bool)
    for part in parts:
        used[part] = True
    sigma = np.full(n, gyro.arw / np.sqrt(gyro.sample_s))
    return SampleView(
        gyro.t_s + 0.5 * gyro.sample_s, gyro.sample_s, gyro.rates, sigma, used, tuple(parts), gyro.rates, gyro.names
    )


def leave_out(recording: Recording, names: Sequence[str]) -> Recording:
    """Leave some gyros out of a recording.

    Raises
    ------
    InputError
        The gyros left do not see all three axes.
    """
    gyro = recording.gyro
    kept = [k for k, name in enumerate(gyro.names) if name not in names]
    K, c = compute_nominal_gyros(gyro)
    G = np.asarray(np.linalg.pinv(K[kept]))
    left = tuple(gyro.names[k] for k in kept)
    stream = replace(gyro, rates=gyro.rates[:, kept], apriori_G=G, apriori_bias=-G @ c[kept], names=left)
    intervals = tuple(
        replace(one, gyros=None if one.gyros is None else tuple(name for name in one.gyros if name not in names))
        for one in recording.intervals
    )
    return replace(recording, gyro=stream, intervals=intervals)


def test_samples(recording: Recording, settings: DiagnosisSettings) -> tuple[Findings, Array, tuple[str, ...]]:
    """Test the samples of three gyros at a time, in the intervals in which these were on.

    Returns
    -------
    Findings with the gyros' names as axes; (gyros,) white noise of each, as a factor of the stated one; notes on gyros that
    could not be tested.
    """
    gyro, names, n = recording.gyro, recording.gyro.names, len(recording.gyro.names)
    tests: list[SampleTest] = []
    symptoms: list[Symptom] = []
    noise, notes = np.ones(n), []
    for low in range(0, n, 3):
        three = list(range(min(low, n - 3), min(low, n - 3) + 3))
        own = tuple(names[k] for k in three)
        on = [one for k, one in enumerate(recording.intervals) if set(three) <= set(recording.switched_on(k).tolist())]
        if not on:
            notes.append(f"The samples of gyros {', '.join(own)} were not tested: never on together")
            continue
        stream = GyroStream(gyro.t_s, np.nan_to_num(gyro.rates[:, three]), gyro.sample_s, gyro.arw, names=own)
        part = replace(recording, gyro=stream, attitudes=build_empty_attitudes(), sensors=None)
        report = examine(replace(part, intervals=tuple(replace(one, gyros=None) for one in on)), settings=settings)
        new = {axis: k for axis, k in zip("xyz", three, strict=True) if k >= low}
        known = {one.kind for one in symptoms}
        found = [one for one in report.symptoms if one.axis in new or (one.axis is None and one.kind not in known)]
        tests += [replace(one, axis=names[new[one.axis]]) for one in report.tests if one.axis in new]
        symptoms += [one if one.axis is None else replace(one, axis=names[new[one.axis]]) for one in found]
        if any(one.kind == "white_noise_level" for one in found):
            for axis, k in new.items():
                noise[k] = report.noise_factor["xyz".index(axis)]
    return Findings(tuple(tests), tuple(symptoms)), noise, tuple(notes)


def linearise_gyros(
    recording: Recording, start: GyroArray, noise: Array, settings: DiagnosisSettings
) -> tuple[GyroArray, PreparedRecording | None]:
    """Find K and c to linearise about, and prepare the body rates made of them; None without reference attitudes."""
    broad = FOLDS.broad * PLAUSIBLE_G, FOLDS.broad * PLAUSIBLE_BIAS
    if not recording.attitudes.t_s.size:
        return fit_to_parity(recording, start, broad), None
    gyros = calibrate_gyros(recording, prior_sigma=broad, iterations=3).gyros
    return gyros, prepare(triad(recording, gyros.K, gyros.c, noise), settings)


# ---- checks and findings -------------------------------------------------------------------------------------------------


def check_array(model: ArrayModel, seed: int, linear: LinearModel, members: tuple[SelectedCandidate, ...]) -> tuple[Check, ...]:
    """Check what an explanation leaves of the attitude and of the parity."""
    rows = model.attitude_rows
    checks: tuple[Check, ...] = ()
    if model.body is not None:
        own = replace(
            linear, y=linear.y[:rows], X=linear.X[:rows], W=linear.W[:rows], projected=model.body.project_out_nuisance,
            dof=model.body.degrees_of_freedom,
        )  # fmt: skip
        checks = check_explanation(own, members, tabulate_observations(model.body), seed)
    places, scales, shifts = linear.build_design(members)
    C = scales * linear.X[rows:, places]
    left = linear.y[rows:] - linear.X[rows:, shifts].sum(axis=1)
    return (*checks, *check_parity(model.parity, np.linalg.solve(np.linalg.cholesky(np.eye(left.size) + C @ C.T), left)))


def check_parity(parity: ParityModel, e: Array) -> tuple[Check, Check]:
    """Check size, and correlation of successive blocks, of what is left of the parity; both have a known distribution."""
    dof, size, block = parity.degrees_of_freedom, float(e @ e), parity.block
    tails = scipy.special.chdtr(dof, size), scipy.special.chdtrc(dof, size)
    after = np.arange(e.size) + np.bincount(block)[block]  # the same component in the next block
    first = np.flatnonzero(after < e.size)
    first = first[parity.interval[block[first]] == parity.interval[block[after[first]]]]
    z = float(np.sum(e[first] * e[after[first]])) / (size / e.size) / np.sqrt(max(first.size, 1))
    return (
        Check("size of the parity", size, float(dof), float(min(1.0, 2 * min(tails)))),
        Check("correlation of the parity in time", z, 0.0, float(2 * scipy.special.ndtr(-abs(z)))),
    )


def find_parity(model: ArrayModel, settings: DiagnosisSettings) -> tuple[Finding, ...]:
    """Find intervals whose parity is larger than its noise."""
    parity, intervals = model.parity, model.recording.intervals
    owner = parity.interval[parity.block]
    shares = 1 - np.sum(parity.nuisance**2, axis=1)  # degrees of freedom that each observation keeps
    out = []
    for number in np.unique(owner):
        own = owner == number
        value, dof = float(np.sum(parity.y[own] ** 2)), float(shares[own].sum())
        p = float(min(1.0, scipy.special.chdtrc(dof, value) * np.unique(owner).size))
        if p < settings.false_alarm_rate:
            name = intervals[number].name
            text = f"the parity of the gyros in {name} is {np.sqrt(value / dof):.2f} times its noise"
            out.append(Finding("parity", name, None, None, "chi2", value, p, text))
    return tuple(sorted(out, key=lambda one: one.p_value))


def find_faulty_gyros(explained: AttitudeInference, names: Sequence[str], settings: DiagnosisSettings) -> tuple[Finding, ...]:
    """Find gyros that are as sure to be at fault as a cause that is named, by whatever it is: also where that is on no list.

    Explanations by an unlisted error of a gyro are of that gyro as well, so that the gyro can be known where its fault is not.
    """
    ranked = explained.attribution.ranked if explained.attribution is not None else ()
    out = []
    for name in names:
        share = sum(one.probability for one in ranked if name in {label.rpartition(":")[2] for label in one.labels})
        if share >= settings.named:
            text = f"gyro {name} is at fault, by whatever it is, with a probability of {share:.3f}"
            out.append(Finding("gyro", None, name, None, "probability", share, explained.p_value, text))
    return tuple(out)


# ---- answers -------------------------------------------------------------------------------------------------------------


def _build_attitude_inputs(
    body: PreparedRecording,
    explained: AttitudeInference,
    gyros: GyroArray,
    shown: Findings,
    where: tuple[Finding, ...],
    noise: Array,
) -> AnswerInputs:
    """See G and b of all gyros: ω = T G ω_raw + b − T G c, with T of the body rates' calibration."""
    model = body.model
    fitted = tuple(replace(one, columns=one.columns[: model.size], shift=one.shift[: model.size]) for one in explained.fitted)
    explained = replace(explained, fitted=fitted)
    change, C = calibrate_with_effects(model, fitted)
    body = replace(body, samples=replace(body.samples, tests=shown.tests, symptoms=shown.symptoms))
    table = localization.compute_statistics(model)
    G = compute_gyro_gain(gyros.K, np.arange(len(gyros.names)), noise)
    T, shift = model.G + change[:9].reshape(3, 3), model.bias + change[9:]
    return AnswerInputs(
        recording=model.recording.title,
        where=(*where, *(localization.list_findings(table) if explained.attribution is not None else ())),
        p_values=collect_p_values(body, explained),
        G=T @ G,
        bias=shift - T @ G @ gyros.c,
        sigma_G=np.sqrt([np.sum((G.T @ C[k : k + 3, k : k + 3]) * G.T, axis=1) for k in (0, 3, 6)]),
        sigma_bias=np.sqrt(np.diag(C)[9:12]),
        baseline_G=model.G @ G,
        baseline_bias=model.bias - model.G @ G @ gyros.c,
        motions=(),
        notes=body.notes,
        details=build_details(body, explained, table),
        gyros=gyros.names,
    )


def _build_parity_inputs(
    title: str, gyros: GyroArray, explained: AttitudeInference, shown: Findings, where: tuple[Finding, ...]
) -> AnswerInputs:
    """See G and b as they were known before."""
    tests = {one.statistic if one.axis is None else f"{one.statistic}:{one.axis}": float(one.p_value) for one in shown.tests}
    checks = {f"check: {check.name}": check.p_value for check in explained.checks}
    columns = ["interval", "t_s", *(f"{what}_{axis}" for what in ("before", "band", "after") for axis in "xyz")]
    return AnswerInputs(
        recording=title,
        where=where,
        p_values={"parity": explained.p_value, **tests, **checks},
        G=gyros.G,
        bias=gyros.bias,
        sigma_G=np.full((3, len(gyros.names)), PLAUSIBLE_G),
        sigma_bias=np.full(3, PLAUSIBLE_BIAS),
        baseline_G=gyros.G,
        baseline_bias=gyros.bias,
        motions=(),
        notes=(
            "No reference attitudes: errors that the gyros share, or that act like a turn of the body, cannot be seen",
            "G and b are the a-priori ones, with their plausible range for sigmas: parity alone does not calibrate",
        ),
        details=Details(
            residuals=pd.DataFrame(columns=columns),
            statistics=pd.DataFrame(columns=["interval", "axis", "phase", "statistic", "value", "dof", "p_value"]),
            regressors=pd.DataFrame(columns=["cause", "interval", "axis", "t_s", "regressor_deg", "residual_deg"]),
            explanations=tabulate_explanations(explained.attribution),
            stream=test_table(shown.tests),
        ),
        gyros=gyros.names,
    )
