"""A table's diagnosis: is there a gap, and what explains it.

The linear model has the 18 motion numbers, whitened by what print leaves of them (`studies.natanson.flight_diagnosis.table`).
The candidates are

- *slew timing* of an interval, or common to all slews: linearised about a point of its own, which leaves a shift. Its
  amplitudes are the timings in standard deviations of their broad priors;
- *yaw direction* and *-y rate sign*: a shift alone, the prediction with the slews reversed less that with those assumed;
- *noise level*: without columns. The noise numbers share no noise with those of motion, so what they say of it comes from
  outside the linear model;
- unlisted rivals: a random residual of any size in all numbers, in one interval or in one number.

The common attribution and amplitudes do the inference. What is added here is the iteration: timings act nonlinearly,
so the model is linearised again about what was found until nothing changes, each timing about its likeliest values beside the
other effects of the best explanation.

A kind of effect is a cause if the explanations with it have a probability of `NAMING_PROBABILITY` or more together, also where
something unlisted remains beside it.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from diagnosis.answer import Verdict
from diagnosis.inference.amplitudes import FittedEffect, fit
from diagnosis.model.linear import CandidateColumns, LinearModel, Parameters, SelectedCandidate
from diagnosis.posterior import Attribution, rank_all
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
from studies.natanson.flight_diagnosis.timings import TIMINGS, Timings
from studies.natanson.flight_gap import MINUS_Y, YAW_INTERVALS
from studies.printed_table import UNKNOWN_NAME, build_model, make_candidate, make_rival, rank_explanations, whiten

YAW, RATE, TIMING, NOISE = "yaw direction", "-y rate sign", "slew timing", "noise level"
UNKNOWN_DEG = (0.001, 1.0)  # of what is unknown
FLAT = 12**-0.5  # standard deviation of what is flat between zero and one
TIMING_STEP = 0.01  # of a timing between zero and one, for its derivative
MOST_FLIGHT_EFFECTS = 5  # four timings and one more


@dataclass(frozen=True)
class LinearisationPoint:
    """What a table's model is linearised about."""

    flips: frozenset[int] = frozenset()  # intervals whose slews are the other way round
    # numbers between zero and one for each candidate's timings, by its axis
    timings: Mapping[str, Array] = field(default_factory=lambda: {one.axis: np.full(len(one.names), 0.5) for one in TIMINGS})


def build_flight_model(table: ResidualTable, baseline: Baseline, point: LinearisationPoint) -> LinearModel:
    """The linear model of a table under a baseline about a point."""
    assumed, case = compute_motion_numbers(table, baseline), compute_motion_numbers(table, baseline, point.flips)
    L = np.asarray(np.linalg.cholesky(case.covariance))
    groups = [
        *_list_direction_candidates(table, baseline, assumed, L),
        *(_make_timing_candidate(case, one, point.timings[one.axis], L) for one in TIMINGS),
        _make_noise_candidate(table, baseline, case),
        *_list_random_rivals(L),
    ]
    owner = np.array([f"{k + 1} {name}" for k, name in RESIDUAL_PLACES])
    return build_model(assumed.d, case.covariance, groups, owner, owner, "a number at a time", MOST_FLIGHT_EFFECTS)


def _make_shifted_candidate(
    effect: str, axis: str, columns: Array, read: Parameters, size: float, unit: str
) -> CandidateColumns:
    """A candidate whose prior is in its columns, the last of which is a shift."""
    return make_candidate(effect, axis, columns, unit, read=lambda _: (size, read), shifted=True, scales=np.ones(1))


def _list_direction_candidates(
    table: ResidualTable, baseline: Baseline, assumed: MotionNumbers, L: Array
) -> Iterator[CandidateColumns]:
    """Slews the other way round."""
    for k in (*YAW_INTERVALS, MINUS_Y):
        shift = (compute_motion_numbers(table, baseline, (k,)).prediction - assumed.prediction).ravel()
        effect, size, unit = (RATE, 2.0, "RPO") if k == MINUS_Y else (YAW, 360.0, "deg")
        yield _make_shifted_candidate(effect, f"{k + 1}", whiten(L, shift[:, None]), {}, size, unit)


def _make_timing_candidate(case: MotionNumbers, timings: Timings, u: Array, L: Array) -> CandidateColumns:
    """Build the candidate for slew timings, linearised about u by finite differences of the simulator."""
    steps = np.where(u > 0.5, -TIMING_STEP, TIMING_STEP)
    points = [u, *(u + np.diag(steps))]
    simulated = [timings.apply_timings(case.sections, point) for point in points]
    residuals = case.predicted([sections[k] for sections in simulated for k in timings.intervals])
    residuals = residuals.reshape(len(points), len(timings.intervals), 3)
    J = np.moveaxis((residuals[1:] - residuals[0]) / steps[:, None, None], 0, 2)  # (intervals, 3, m)
    columns = np.zeros((6, 3, u.size + 1))
    columns[timings.intervals, :, :-1] = J * FLAT
    # The shift: residuals extrapolated to the prior mean u = 1/2, less those with the assumed timings.
    columns[timings.intervals, :, -1] = residuals[0] - J @ (u - 0.5) - case.prediction[list(timings.intervals)]
    parameters = dict(zip(timings.names, timings.values(case.sections, u).tolist(), strict=True))
    return _make_shifted_candidate(TIMING, timings.axis, whiten(L, columns.reshape(18, -1)), parameters, 1.0, "")


def _make_noise_candidate(table: ResidualTable, baseline: Baseline, case: MotionNumbers) -> CandidateColumns:
    log_odds, mean, sigma = estimate_noise_level(table, case.Theta, baseline)
    evidence: dict[str, Any] = {
        "log_odds": log_odds,
        "read": lambda _: (mean, {}),
        "size_sigma": lambda _: sigma,
        "scales": np.ones(1),
    }
    return make_candidate(NOISE, None, np.empty((len(RESIDUAL_PLACES), 0)), "factor", **evidence)


def _list_random_rivals(L: Array) -> Iterator[CandidateColumns]:
    """Random residuals, per deg."""
    each = whiten(L, np.eye(len(RESIDUAL_PLACES)))
    yield make_rival("all numbers", None, each, "deg", UNKNOWN_DEG)
    for k in range(6):
        yield make_rival("an interval", f"{k + 1}", each[:, 3 * k : 3 * k + 3], "deg", UNKNOWN_DEG)
    for i, (k, name) in enumerate(RESIDUAL_PLACES):
        yield make_rival("a number", f"{k + 1} {name}", each[:, [i]], "deg", UNKNOWN_DEG)


Effects = frozenset[str]

NAMING_PROBABILITY = 0.95
FALSE_ALARM = 0.01
PRIOR_OF_CHANCE = 0.2  # prior share of chance alone, as likely beforehand as one kind of effect
SEARCH_ROUNDS = 5  # of search and new linearisation
LINEARISATION_ITERATIONS = 10  # of the linearisation, between two searches
CONVERGED_TIMING = 0.01  # of a timing between zero and one


@dataclass(frozen=True)
class TableDiagnosis:
    """What is found in a table under a baseline."""

    gap: Mapping[str, float]  # tests of the motion's and the noise's numbers
    verdict: Verdict  # "none", "named", "group" or "unknown"
    causes: tuple[str, ...]  # effects with a probability of `NAMING_PROBABILITY`, "unknown" left out
    sets: Mapping[Effects, float]  # probability of each set of effects, the likeliest first, whatever their axes
    fitted: tuple[FittedEffect, ...]  # effects of the likeliest explanation, unlisted ones included
    noise: tuple[float, float]  # mean and sigma of the noise over the baseline's
    before: Array  # before, after: (18,) d without and with the listed effects of the likeliest explanation, deg
    after: Array

    def includes(self, effect: str) -> float:
        """Probability that an effect is at work."""
        return sum(p for effects, p in self.sets.items() if effect in effects)

    @property
    def best(self) -> str:
        """The likeliest explanation in words."""
        return " + ".join(one.label for one in self.fitted) or "nothing"

    @property
    def group(self) -> list[Effects]:
        """List the likeliest sets of effects that together hold `NAMING_PROBABILITY`; none without a misfit."""
        kept, reached = [], 0.0
        for effects, p in self.sets.items() if self.verdict != "none" else ():
            if reached < NAMING_PROBABILITY:
                kept.append(effects)
            reached += p
        return kept


def diagnose(table: ResidualTable, baseline: Baseline) -> TableDiagnosis:
    """Diagnose a table; without a gap nothing is searched."""
    gap = compute_misfit_p(table, baseline)
    case = compute_motion_numbers(table, baseline)
    noise = estimate_noise_level(table, case.Theta, baseline)[1:]
    if gap["p_value"] > FALSE_ALARM:
        return TableDiagnosis(gap, "none", (), {frozenset(): 1.0}, (), noise, case.d, case.d)
    model, attribution, point = search_with_relinearisation(table, baseline)
    fitted = tuple(fit(model, [_find_member(model, label) for label in attribution.ranked[0].labels]))
    known = [one for one in fitted if not one.effect.startswith(UNKNOWN_NAME)]
    L = np.linalg.cholesky(compute_motion_numbers(table, baseline, point.flips).covariance)
    explains = sum((L @ one.contribution for one in known), np.zeros(case.d.size))
    sets: dict[Effects, float] = defaultdict(float)
    for one in attribution.ranked:
        sets[frozenset(UNKNOWN_NAME if label.startswith(UNKNOWN_NAME) else label.split(":")[0] for label in one.labels)] += (
            one.probability
        )
    causes = tuple(
        name for name in (YAW, RATE, TIMING, NOISE) if sum(p for own, p in sets.items() if name in own) >= NAMING_PROBABILITY
    )
    return TableDiagnosis(
        gap=gap,
        verdict="named" if causes else "unknown" if attribution.unknown > DEFAULT.unknown else "group",
        causes=causes,
        sets=dict(sorted(sets.items(), key=lambda item: -item[1])),
        fitted=fitted,
        noise=noise,
        before=case.d,
        after=case.d - explains,
    )


def search_with_relinearisation(
    table: ResidualTable, baseline: Baseline
) -> tuple[LinearModel, Attribution, LinearisationPoint]:
    """The last of the models, what its explanations amount to, and what it is linearised about."""
    point, found = LinearisationPoint(), tuple[str, ...]()
    for _ in range(SEARCH_ROUNDS):
        point = relinearise_timings(table, baseline, point, found)
        model = build_flight_model(table, baseline, point)
        attribution = rank_all(model, rank_explanations(model, PRIOR_OF_CHANCE))
        best = tuple(label for label in attribution.ranked[0].labels if not label.startswith(UNKNOWN_NAME))
        if set(best) == set(found):
            break
        found = best
        flips = frozenset(int(label.split(":")[1]) - 1 for label in best if label.split(":")[0] in (YAW, RATE))
        point = LinearisationPoint(flips, point.timings)
    return model, attribution, point


def relinearise_timings(
    table: ResidualTable, baseline: Baseline, point: LinearisationPoint, found: tuple[str, ...]
) -> LinearisationPoint:
    """Each timing's point moved to its likeliest values, beside the other effects that were found, or instead of theirs.

    A timing that was not found may stand for those that were: it is tried beside the directions that were found alone.
    """
    for _ in range(LINEARISATION_ITERATIONS):
        model = build_flight_model(table, baseline, point)
        timings = dict(point.timings)
        for one in TIMINGS:
            label = f"{TIMING}:{one.axis}"
            others = [_find_member(model, o) for o in found if o != label and (label in found or not o.startswith(TIMING))]
            amplitudes = fit(model, [*others, _find_member(model, label)])[-1].amplitudes
            timings[one.axis] = np.clip(0.5 + FLAT * amplitudes, 0.0, 1.0)  # as far as they can be flown
        change = max(float(np.abs(timings[axis] - u).max()) for axis, u in point.timings.items())
        point = LinearisationPoint(point.flips, timings)
        if change < CONVERGED_TIMING:
            break
    return point


def _find_member(model: LinearModel, label: str) -> SelectedCandidate:
    place = model.find(label)
    assert place is not None
    return SelectedCandidate(place, 0, 0)
