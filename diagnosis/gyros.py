"""A whole diagnosis of more gyros than three: the samples of each, then parity and attitude together.

1. *Dead.* A gyro whose samples no longer change is found in them; the rest is done without it.
2. *Samples.* Every test of the samples is made of each gyro, three at a time.
3. *About.* K and c by parity and attitude, without which a percent of scale factor would look like an effect.
4. *Which.* One linear model of parity and attitude (`diagnosis.model.gyros`), searched and judged as any other.

Where no more than three gyros are left there is no parity, and the body rates are diagnosed as those of three gyros. Without
reference attitudes only parity and samples speak; what all gyros do alike is then not seen, which the answer says.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import scipy.stats
from numpy.typing import NDArray

from diagnosis.answer import Finding
from diagnosis.assemble import Seen, answered, p_values
from diagnosis.detail_tables import details, explanation_table
from diagnosis.detectors.report import SampleReport, SampleTest, Symptom
from diagnosis.detectors.samples import examine
from diagnosis.explain import Explained, explain, judged
from diagnosis.inference.criticism import Check, check_explanation
from diagnosis.model import localization
from diagnosis.model.calibration import calibrated
from diagnosis.model.gyros import ArrayModel, build_array_model
from diagnosis.model.layout import tabulate_observations
from diagnosis.model.linear import LinearModel, Member
from diagnosis.model.parity import ParityModel, build_parity_model
from diagnosis.model.prepare import Prepared, prepare
from diagnosis.model.symptoms import SampleCause, claimed, drop_estimated_levels, reference_symptoms
from diagnosis.result import Details, Diagnosis
from diagnosis.settings import DiagnosisSettings
from gyrocal.calibration.gyros import GyroArray, calibrate_gyros, fitted_to_parity
from gyrocal.calibration.observability import PLAUSIBLE_BIAS, PLAUSIBLE_G
from gyrocal.errors import InputError
from gyrocal.recording import Recording, triad
from gyrocal.recording.format import GyroStream, without_attitudes
from gyrocal.recording.gyros import gain, inside, nominal
from simulator.effects.base import Effect, SampleView

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

BROAD = (10.0 * PLAUSIBLE_G, 10.0 * PLAUSIBLE_BIAS)  # prior sigma of K and c that the model is taken about
SIGNIFICANT = 0.01  # p-value of an interval's parity, corrected for their number
NOISE = "white_noise_level"
NOTHING_TO_SEE = Explained((), 1.0, None, (), (), None, np.zeros(12), np.zeros((12, 12)))


@dataclass(frozen=True)
class GyroTests:
    """What the samples of all gyros show.

    Attributes
    ----------
    tests, symptoms : with the gyros' names as axes
    noise : (gyros,) white noise of each, as a factor of the stated one
    notes : on gyros that were not looked at
    """

    tests: tuple[SampleTest, ...]
    symptoms: tuple[Symptom, ...]
    noise: Array
    notes: tuple[str, ...]


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
    dead = dead_gyros(recording, effects, settings)
    whole = recording
    recording, notes = without(recording, [str(one.symptom.axis) for one in dead])
    tested = gyro_tests(recording, settings)
    start = GyroArray(recording.gyro.names, *nominal(recording.gyro))
    gyros, body, more = about(recording, start, tested.noise, settings)
    parity = build_parity_model(recording, gyros, recording.gyro.arw * tested.noise)
    of_references = [] if body is None else reference_symptoms(body, settings)
    symptoms = [*drop_estimated_levels(tested.symptoms, recording), *of_references]
    view = _view(recording, recording.gyro.names)
    own = [effect for effect in effects if not effect.of_arrays]
    samples = (*dead, *claimed(symptoms, tested.tests, own, view, settings))
    notes = (*notes, *tested.notes, *more)
    if parity is None and body is None:
        left = "No more than three gyros are left, and no reference attitudes: nothing but the samples could be looked at"
        seen = _seen_by_parity(whole, start, NOTHING_TO_SEE, tested, (), (*notes, left))
        return answered(seen, samples, NOTHING_TO_SEE, settings, time.perf_counter() - began)
    if parity is None:
        assert body is not None
        explained = explain(body, [one for one in effects if not one.of_arrays], settings, seed, tell)
        seen = _seen_by_attitude(whole, body, explained, gyros, tested, (*notes, "Without parity, axes are those of the body"))
        return answered(seen, samples, explained, settings, time.perf_counter() - began)
    model = ArrayModel(recording, parity, None if body is None else body.model)
    tell("candidates", 0.1)
    linear = build_array_model(model, effects, settings)

    def check(found: LinearModel, members: tuple[Member, ...]) -> tuple[Check, ...]:
        return array_checks(model, found, members, seed)

    explained = judged(linear, check, settings, seed, tell)
    gap = explained.p_value < settings.false_alarm_rate
    where = (*gyros_at_fault(explained, gyros.names, settings), *parity_findings(model)) if gap else ()
    if body is None:
        seen = _seen_by_parity(whole, start, explained, tested, where, notes)
        return answered(seen, samples, explained, settings, time.perf_counter() - began)
    rows = model.attitude_rows
    of_attitude = tuple(replace(one, columns=one.columns[:rows], shift=one.shift[:rows]) for one in explained.fitted)
    change, covariance = calibrated(body.model, of_attitude)
    attitude = replace(explained, fitted=of_attitude, change=change, covariance=covariance)
    seen = _seen_by_attitude(whole, body, attitude, gyros, tested, notes, where, gap)
    return answered(seen, samples, explained, settings, time.perf_counter() - began)


# ---- samples -------------------------------------------------------------------------------------------------------------


def dead_gyros(recording: Recording, effects: Sequence[Effect], settings: DiagnosisSettings) -> tuple[SampleCause, ...]:
    """What the effects' own tests of all gyros side by side find."""
    own = [effect for effect in effects if effect.of_arrays and effect.implements("detect")]
    return claimed([], [], own, _view(recording, recording.gyro.names), settings)


def _view(recording: Recording, names: tuple[str, ...]) -> SampleView:
    """The samples of the intervals in which all gyros were on."""
    gyro = recording.gyro
    parts = [inside(recording, k)[0] for k in range(len(recording.intervals)) if recording.switched_on(k).size == len(names)]
    used = np.zeros(gyro.t_s.size, dtype=bool)
    for part in parts:
        used[part] = True
    sigma = np.full(len(names), gyro.arw / np.sqrt(gyro.sample_s))
    return SampleView(gyro.t_s + 0.5 * gyro.sample_s, gyro.sample_s, gyro.rates, sigma, used, tuple(parts), gyro.rates, names)


def without(recording: Recording, names: Sequence[str]) -> tuple[Recording, tuple[str, ...]]:
    """A recording without some of its gyros, and what is to be said of that.

    Raises
    ------
    InputError
        The gyros left do not see all three axes.
    """
    if not names:
        return recording, ()
    gyro = recording.gyro
    kept = [k for k, name in enumerate(gyro.names) if name not in names]
    K, c = nominal(gyro)
    G = np.asarray(np.linalg.pinv(K[kept]))
    left = tuple(gyro.names[k] for k in kept)
    stream = replace(gyro, rates=gyro.rates[:, kept], apriori_G=G, apriori_bias=-G @ c[kept], names=left)
    intervals = tuple(
        replace(one, gyros=None if one.gyros is None else tuple(name for name in one.gyros if name not in names))
        for one in recording.intervals
    )
    note = f"Gyro {', '.join(names)} is left out of all that follows, also before it failed"
    return replace(recording, gyro=stream, intervals=intervals), (note,)


def gyro_tests(recording: Recording, settings: DiagnosisSettings) -> GyroTests:
    """The tests of the samples, of three gyros at a time, where these were on."""
    names, n = recording.gyro.names, len(recording.gyro.names)
    tests: list[SampleTest] = []
    symptoms: list[Symptom] = []
    noise, notes = np.ones(n), []
    for low in range(0, n, 3):
        three = list(range(min(low, n - 3), min(low, n - 3) + 3))
        part = _of_three(recording, three)
        if part is None:
            notes.append(f"The samples of gyros {', '.join(names[k] for k in three)} were not looked at: never on together")
            continue
        report = examine(part, settings=settings)
        new = {axis: k for axis, k in zip("xyz", three, strict=True) if k >= low}
        tests += [replace(one, axis=names[new[one.axis]]) for one in report.tests if one.axis in new]
        found = [one for one in report.symptoms if one.axis is None or one.axis in new]
        symptoms += [one if one.axis is None else replace(one, axis=names[new[one.axis]]) for one in found]
        if any(one.kind == NOISE for one in found):
            for axis, k in new.items():
                noise[k] = report.noise_factor["xyz".index(axis)]
    return GyroTests(tuple(tests), tuple(_distinct(symptoms)), noise, tuple(notes))


def _of_three(recording: Recording, three: list[int]) -> Recording | None:
    """Three gyros alone, in the intervals in which they were on; None if there are none."""
    gyro = recording.gyro
    on = [k for k in range(len(recording.intervals)) if set(three) <= set(recording.switched_on(k).tolist())]
    if not on:
        return None
    names = tuple(gyro.names[k] for k in three)
    rates = np.nan_to_num(gyro.rates[:, three])
    stream = GyroStream(gyro.t_s, rates, gyro.sample_s, gyro.arw, names=names)
    intervals = tuple(replace(recording.intervals[k], gyros=None) for k in on)
    return replace(recording, gyro=stream, attitudes=without_attitudes(), intervals=intervals, sensors=None)


def _distinct(symptoms: Sequence[Symptom]) -> list[Symptom]:
    """Each symptom of all gyros once."""
    seen: set[str] = set()
    out = []
    for one in symptoms:
        if one.axis is None and one.kind in seen:
            continue
        seen.add(one.kind)
        out.append(one)
    return out


# ---- what the model is taken about ---------------------------------------------------------------------------------------


def about(
    recording: Recording, start: GyroArray, noise: Array, settings: DiagnosisSettings
) -> tuple[GyroArray, Prepared | None, tuple[str, ...]]:
    """K and c to linearise about, the body rates made of them ready for the attitude's tests, and what was not possible."""
    if not recording.attitudes.t_s.size:
        note = "No reference attitudes: errors that the gyros share, or that act like a turn of the body, cannot be seen"
        return fitted_to_parity(recording, start, BROAD), None, (note,)
    gyros = calibrate_gyros(recording, prior_sigma=BROAD, iterations=3).gyros
    return gyros, prepare(triad(recording, gyros.K, gyros.c, noise), settings), ()


# ---- checks and findings -------------------------------------------------------------------------------------------------


def array_checks(model: ArrayModel, linear: LinearModel, members: tuple[Member, ...], seed: int) -> tuple[Check, ...]:
    """Checks of what an explanation leaves of the attitude and of the parity."""
    rows = model.attitude_rows
    checks: tuple[Check, ...] = ()
    if model.body is not None:
        own = replace(
            linear, y=linear.y[:rows], X=linear.X[:rows], W=linear.W[:rows], projected=model.body.projected,
            dof=model.body.degrees_of_freedom,
        )  # fmt: skip
        checks = check_explanation(own, members, tabulate_observations(model.body), seed)
    places, scales, shifts = linear.design(members)
    C = scales * linear.X[rows:, places]
    left = linear.y[rows:] - linear.X[rows:, shifts].sum(axis=1)
    e = np.linalg.solve(np.linalg.cholesky(np.eye(left.size) + C @ C.T), left)
    return (*checks, *parity_checks(model.parity, e))


def parity_checks(parity: ParityModel, e: Array) -> tuple[Check, Check]:
    """Size, and correlation of successive blocks, of what is left of the parity; both have a known distribution."""
    dof, size = parity.degrees_of_freedom, float(e @ e)
    tails = scipy.stats.chi2.cdf(size, dof), scipy.stats.chi2.sf(size, dof)
    component = np.arange(e.size) - np.searchsorted(parity.block, parity.block)
    products, pairs = 0.0, 0
    for number in np.unique(component):
        own = np.flatnonzero(component == number)
        follows = (np.diff(parity.block[own]) == 1) & (np.diff(parity.interval[parity.block[own]]) == 0)
        products += float(np.sum((e[own][1:] * e[own][:-1])[follows]))
        pairs += int(follows.sum())
    z = products / (size / e.size) / np.sqrt(max(pairs, 1))
    return (
        Check("size of the parity", size, float(dof), float(min(1.0, 2 * min(tails)))),
        Check("correlation of the parity in time", z, 0.0, float(2 * scipy.stats.norm.sf(abs(z)))),
    )


def parity_findings(model: ArrayModel) -> tuple[Finding, ...]:
    """Intervals whose parity is larger than its noise."""
    parity, intervals = model.parity, model.recording.intervals
    owner = parity.interval[parity.block]
    shares = 1 - np.sum(parity.nuisance**2, axis=1)  # degrees of freedom that each observation keeps
    out = []
    for number in np.unique(owner):
        own = owner == number
        value, dof = float(np.sum(parity.y[own] ** 2)), float(shares[own].sum())
        p = float(min(1.0, scipy.stats.chi2.sf(value, dof) * np.unique(owner).size))
        if p < SIGNIFICANT:
            name = intervals[number].name
            text = f"the parity of the gyros in {name} is {np.sqrt(value / dof):.2f} times its noise"
            out.append(Finding("parity", name, None, None, "chi2", value, p, text))
    return tuple(sorted(out, key=lambda one: one.p_value))


def gyros_at_fault(explained: Explained, names: Sequence[str], settings: DiagnosisSettings) -> tuple[Finding, ...]:
    """Gyros that are as sure to be at fault as a cause that is named, by whatever it is: also where that is on no list.

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


def _p_values(tested: GyroTests, explained: Explained, first: str) -> dict[str, float]:
    out = {first: explained.p_value}
    for test in tested.tests:
        out[test.statistic if test.axis is None else f"{test.statistic}:{test.axis}"] = float(test.p_value)
    return out | {f"check: {check.name}": check.p_value for check in explained.checks}


def _stream_table(tested: GyroTests) -> pd.DataFrame:
    return pd.DataFrame.from_records(
        [(t.statistic, t.axis, t.value, t.expected, t.p_value, t.text) for t in tested.tests],
        columns=["statistic", "axis", "value", "expected", "p_value", "text"],
    )


def _seen_by_attitude(
    recording: Recording,
    body: Prepared,
    explained: Explained,
    gyros: GyroArray,
    tested: GyroTests,
    notes: tuple[str, ...],
    where: tuple[Finding, ...] = (),
    gap: bool = False,
) -> Seen:
    """G and b are those of all gyros that were looked at: ω = T G ω_raw + b − T G c, with T of the body rates' calibration."""
    model = body.model
    table = localization.compute_statistics(model)
    G = gain(gyros.K, np.arange(len(gyros.names)), tested.noise)
    T, shift = model.G + explained.change[:9].reshape(3, 3), model.bias + explained.change[9:]
    C = explained.covariance
    sigma = np.sqrt([np.sum((G.T @ C[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]) * G.T, axis=1) for i in range(3)])
    full = replace(body, samples=_as_report(body.samples, tested))
    return Seen(
        recording=recording.title,
        where=(*where, *(localization.findings(table) if gap or explained.attribution is not None else ())),
        p_values=p_values(full, explained),
        G=T @ G,
        bias=shift - T @ G @ gyros.c,
        sigma_G=sigma,
        sigma_bias=np.sqrt(np.diag(C)[9:12]),
        baseline_G=model.G @ G,
        baseline_bias=model.bias - model.G @ G @ gyros.c,
        motions=(),
        notes=(*notes, *body.notes),
        details=details(full, explained, table),
        gyros=gyros.names,
    )


def _as_report(report: SampleReport, tested: GyroTests) -> SampleReport:
    return replace(report, tests=tested.tests, symptoms=tested.symptoms)


def _seen_by_parity(
    recording: Recording,
    gyros: GyroArray,
    explained: Explained,
    tested: GyroTests,
    where: tuple[Finding, ...],
    notes: tuple[str, ...],
) -> Seen:
    columns = ["interval", "t_s", *(f"{what}_{axis}" for what in ("before", "band", "after") for axis in "xyz")]
    statistics = pd.DataFrame(columns=["interval", "axis", "phase", "statistic", "value", "dof", "p_value"])
    regressors = pd.DataFrame(columns=["cause", "interval", "axis", "t_s", "regressor_deg", "residual_deg"])
    n = len(gyros.names)
    note = "G and b are the a-priori ones, with their plausible range for sigmas: parity alone does not calibrate"
    return Seen(
        recording=recording.title,
        where=where,
        p_values=_p_values(tested, explained, "parity"),
        G=gyros.G,
        bias=gyros.bias,
        sigma_G=np.full((3, n), PLAUSIBLE_G),
        sigma_bias=np.full(3, PLAUSIBLE_BIAS),
        baseline_G=gyros.G,
        baseline_bias=gyros.bias,
        motions=(),
        notes=(*notes, note),
        details=Details(
            pd.DataFrame(columns=columns),
            statistics,
            regressors,
            explanation_table(explained.attribution),
            _stream_table(tested),
        ),
        gyros=gyros.names,
    )
