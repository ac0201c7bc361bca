"""Diagnosis of a table: test for a misfit, and search for its causes.

The linear model has the 18 motion numbers, whitened by their rounding errors (`studies.natanson.flight_diagnosis.table`). The
candidates are

- *slew timing* of an interval: its amplitudes are the timings in standard deviations of their broad priors;
- *yaw direction* and *-y rate sign*: a shift alone, the prediction with the slews reversed less that with those assumed;
- *noise level*: without columns, since the noise numbers share no noise with those of motion;
- unlisted rivals: a random residual of any size in all numbers, in one interval or in one number.

Timings act nonlinearly, so the model is linearised again about the likeliest ones until nothing changes. A kind of effect is a
cause if the explanations with it, also those with an unlisted rival, have a total probability of at least `NAMING_PROBABILITY`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from diagnosis.answer import Verdict
from diagnosis.inference.amplitudes import FittedEffect, fit
from diagnosis.model.linear import CandidateColumns, LinearModel, Parameters, SelectedCandidate
from diagnosis.posterior import Attribution, rank_without_naming
from diagnosis.settings import DEFAULT
from gyrocal.arrays import Array
from studies.natanson.flight_diagnosis.table import (
    RESIDUAL_PLACES,
    Baseline,
    MotionNumbers,
    ResidualTable,
    compute_misfit_p,
    compute_motion_numbers,
    estimate_noise_level,
)
from studies.natanson.flight_diagnosis.timings import SLEWING, TIMING_NAMES, compute_timings, replace_slew_timings
from studies.natanson.flight_gap import MINUS_Y
from studies.printed_table import UNKNOWN_NAME, build_model, make_candidate, make_rival, rank_explanations, whiten

YAW, RATE, TIMING, NOISE = "yaw direction", "-y rate sign", "slew timing", "noise level"
NAMING_PROBABILITY = 0.95
FALSE_ALARM = 0.01
PRIOR_OF_CHANCE = 0.2  # prior probability of chance alone, as large as that of one kind of effect
UNKNOWN_DEG = (0.001, 1.0)  # sizes of an unknown effect
FLAT = 12**-0.5  # standard deviation of a uniform distribution between zero and one
TIMING_STEP = 0.01  # of a timing between zero and one, for its derivative
MOST_FLIGHT_EFFECTS = 4  # three timings and one more
SEARCH_ROUNDS = 5  # of search and new linearisation
LINEARISATION_ITERATIONS = 10  # of the linearisation, between two searches
CONVERGED_TIMING = 0.01  # of a timing between zero and one


@dataclass(frozen=True)
class LinearisationPoint:
    """Point about which a table's model is linearised."""

    reversed_intervals: frozenset[int] = frozenset()  # intervals whose slews are the other way round
    # timings of each interval with slews, as numbers between zero and one
    timings: Mapping[int, Array] = field(default_factory=lambda: {k: np.full(len(TIMING_NAMES[k]), 0.5) for k in SLEWING})


@dataclass(frozen=True)
class TableDiagnosis:
    """Diagnosis of a table under a baseline."""

    gap: Mapping[str, float]  # tests of the motion's and the noise's numbers
    verdict: Verdict  # "none", "named", "group" or "unknown"
    noise: tuple[float, float]  # mean and sigma of the noise over the baseline's
    before: Array  # before, after: (18,) d without and with the listed effects of the likeliest explanation, deg
    after: Array
    causes: tuple[str, ...] = ()  # effects with a probability of `NAMING_PROBABILITY`, without "unknown"
    unknown: float = 0.0  # probability of an unknown effect
    fitted: tuple[FittedEffect, ...] = ()  # effects of the likeliest explanation, unlisted ones included

    @property
    def best(self) -> str:
        """The likeliest explanation in words."""
        return " + ".join(effect.label for effect in self.fitted) or "nothing"


def build_flight_model(table: ResidualTable, baseline: Baseline, point: LinearisationPoint) -> LinearModel:
    """Build the linear model of a table under a baseline about a point."""
    assumed = compute_motion_numbers(table, baseline)
    numbers = compute_motion_numbers(table, baseline, point.reversed_intervals)
    L = np.asarray(np.linalg.cholesky(numbers.covariance))
    candidates = [
        *(_make_direction_candidate(table, baseline, assumed, k, L) for k in SLEWING),
        *(_make_timing_candidate(numbers, k, point.timings[k], L) for k in SLEWING),
        _make_noise_candidate(table, baseline, numbers),
        *_list_random_rivals(L),
    ]
    owner = np.array([f"{k + 1} {name}" for k, name in RESIDUAL_PLACES])
    return build_model(assumed.d, numbers.covariance, candidates, owner, owner, "a number at a time", MOST_FLIGHT_EFFECTS)


def _make_shifted_candidate(
    effect: str, interval: int, columns: Array, read: Parameters, size: float, unit: str
) -> CandidateColumns:
    """Make a candidate whose prior is in its columns, the last of which is a shift."""
    return make_candidate(
        effect, f"{interval + 1}", columns, unit, read=lambda _: (size, read), shifted=True, scales=np.ones(1)
    )


def _make_direction_candidate(
    table: ResidualTable, baseline: Baseline, assumed: MotionNumbers, k: int, L: Array
) -> CandidateColumns:
    """Make the candidate of an interval's slews in the opposite direction."""
    shift = (compute_motion_numbers(table, baseline, (k,)).prediction - assumed.prediction).ravel()
    effect, size, unit = (RATE, 2.0, "RPO") if k == MINUS_Y else (YAW, 360.0, "deg")
    return _make_shifted_candidate(effect, k, whiten(L, shift[:, None]), {}, size, unit)


def _make_timing_candidate(numbers: MotionNumbers, k: int, u: Array, L: Array) -> CandidateColumns:
    """Build the candidate for an interval's slew timings, linearised about u by finite differences of the simulator."""
    steps = np.where(u > 0.5, -TIMING_STEP, TIMING_STEP)
    section = numbers.sections[k]
    sections = [replace_slew_timings(section, *compute_timings(section, point)) for point in (u, *(u + np.diag(steps)))]
    residuals = numbers.predict(sections)  # (m + 1, 3)
    J = ((residuals[1:] - residuals[0]) / steps[:, None]).T
    columns = np.zeros((6, 3, u.size + 1))
    columns[k, :, :-1] = J * FLAT
    # The shift: residuals extrapolated to the prior mean u = 1/2, less those with the assumed timings.
    columns[k, :, -1] = residuals[0] - J @ (u - 0.5) - numbers.prediction[k]
    parameters: Parameters = dict(zip(TIMING_NAMES[k], compute_timings(section, u), strict=True))
    return _make_shifted_candidate(TIMING, k, whiten(L, columns.reshape(18, -1)), parameters, 1.0, "")


def _make_noise_candidate(table: ResidualTable, baseline: Baseline, numbers: MotionNumbers) -> CandidateColumns:
    """Make the candidate of another noise level, with the evidence of the noise numbers and no column."""
    log_odds, mean, sigma = estimate_noise_level(table, numbers.Theta, baseline)
    return make_candidate(
        NOISE,
        None,
        np.empty((len(RESIDUAL_PLACES), 0)),
        "factor",
        log_odds=log_odds,
        read=lambda _: (mean, {}),
        size_sigma=lambda _: sigma,
        scales=np.ones(1),
    )


def _list_random_rivals(L: Array) -> Iterator[CandidateColumns]:
    """List random residuals, per deg: of all numbers, an interval's, or one number."""
    unit_columns = whiten(L, np.eye(len(RESIDUAL_PLACES)))
    yield make_rival("all numbers", None, unit_columns, "deg", UNKNOWN_DEG)
    for k in range(6):
        yield make_rival("an interval", f"{k + 1}", unit_columns[:, 3 * k : 3 * k + 3], "deg", UNKNOWN_DEG)
    for i, (k, name) in enumerate(RESIDUAL_PLACES):
        yield make_rival("a number", f"{k + 1} {name}", unit_columns[:, [i]], "deg", UNKNOWN_DEG)


def diagnose(table: ResidualTable, baseline: Baseline) -> TableDiagnosis:
    """Diagnose a table; without a gap nothing is searched."""
    gap = compute_misfit_p(table, baseline)
    numbers = compute_motion_numbers(table, baseline)
    noise = estimate_noise_level(table, numbers.Theta, baseline)[1:]
    if gap["p_value"] > FALSE_ALARM:
        return TableDiagnosis(gap, "none", noise, numbers.d, numbers.d)
    model, attribution, point = search_with_relinearisation(table, baseline)
    fitted = tuple(fit(model, [_find_member(model, label) for label in attribution.ranked[0].labels]))
    L = np.linalg.cholesky(compute_motion_numbers(table, baseline, point.reversed_intervals).covariance)
    listed = [L @ effect.contribution for effect in fitted if not effect.effect.startswith(UNKNOWN_NAME)]
    causes = tuple(name for name in (YAW, RATE, TIMING, NOISE) if _sum_probability(attribution, name) >= NAMING_PROBABILITY)
    verdict: Verdict = "named" if causes else "unknown" if attribution.unknown > DEFAULT.unknown else "group"
    after = numbers.d - sum(listed, np.zeros(numbers.d.size))
    return TableDiagnosis(gap, verdict, noise, numbers.d, after, causes, _sum_probability(attribution, UNKNOWN_NAME), fitted)


def _sum_probability(attribution: Attribution, effect: str) -> float:
    """Sum the probability of the explanations with an effect, on any axis."""
    ranked = attribution.ranked
    return sum(entry.probability for entry in ranked if any(label.startswith(effect) for label in entry.labels))


def search_with_relinearisation(
    table: ResidualTable, baseline: Baseline
) -> tuple[LinearModel, Attribution, LinearisationPoint]:
    """Find the explanations; returns the last model, their attribution, and the point that the model is linearised about."""
    point, causes = LinearisationPoint(), tuple[str, ...]()
    for _ in range(SEARCH_ROUNDS):
        point = relinearise_timings(table, baseline, point, causes)
        model = build_flight_model(table, baseline, point)
        attribution = rank_without_naming(model, rank_explanations(model, PRIOR_OF_CHANCE))
        best = tuple(label for label in attribution.ranked[0].labels if not label.startswith(UNKNOWN_NAME))
        if set(best) == set(causes):
            break
        causes = best
        directions = [label for label in best if label.startswith((YAW, RATE))]
        point = LinearisationPoint(frozenset(int(label.split(":")[1]) - 1 for label in directions), point.timings)
    return model, attribution, point


def relinearise_timings(
    table: ResidualTable, baseline: Baseline, point: LinearisationPoint, causes: tuple[str, ...]
) -> LinearisationPoint:
    """Move the point of each timing to its likeliest values, beside the present causes.

    A timing that is no present cause may replace those that are: it is fitted beside the directions alone.
    """
    for _ in range(LINEARISATION_ITERATIONS):
        model = build_flight_model(table, baseline, point)
        timings = {}
        for k in SLEWING:
            label = f"{TIMING}:{k + 1}"
            beside_causes = [cause for cause in causes if cause != label and (label in causes or not cause.startswith(TIMING))]
            amplitudes = fit(model, [_find_member(model, name) for name in (*beside_causes, label)])[-1].amplitudes
            timings[k] = np.clip(0.5 + FLAT * amplitudes, 0.0, 1.0)  # within the prior range, outside which no slew exists
        change = max(float(np.abs(timings[k] - u).max()) for k, u in point.timings.items())
        point = LinearisationPoint(point.reversed_intervals, timings)
        if change < CONVERGED_TIMING:
            break
    return point


def _find_member(model: LinearModel, label: str) -> SelectedCandidate:
    """Select the candidate of a label."""
    index = model.find(label)
    assert index is not None
    return SelectedCandidate(index, 0, 0)
