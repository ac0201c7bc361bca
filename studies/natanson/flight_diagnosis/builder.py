"""The linear model of a table: motion numbers, and a candidate for everything that could part them from the prediction.

Observations are the 18 motion numbers, whitened by what print leaves of them (`numbers`). The candidates are

- *slew timing* of an interval, or common to all slews: linearised about a point of its own, which leaves a shift. Its
  amplitudes are the timings in standard deviations of their broad priors;
- *yaw direction* and *-y rate sign*: a shift alone, the prediction with the slews reversed less that with those assumed;
- *noise level*: without columns. The noise numbers share no noise with those of motion, so what they say of it comes from
  outside the linear model;
- unlisted rivals: a random residual of any size in all numbers, in one interval or in one number.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.model.groups import CandidateColumns
from diagnosis.model.linear import LinearModel, Parameters
from simulator.arrays import Array
from studies.natanson.flight_diagnosis.misfit_numbers import (
    RESIDUAL_PLACES,
    MotionNumbers,
    compute_motion_numbers,
    estimate_noise_level,
)
from studies.natanson.flight_diagnosis.table import Baseline, ResidualTable
from studies.natanson.flight_diagnosis.timings import TIMINGS, Timings
from studies.natanson.flight_gap import MINUS_Y, YAW_INTERVALS
from studies.printed_table import build_model, make_candidate, make_rival, whiten

YAW, RATE, TIMING, NOISE = "yaw direction", "-y rate sign", "slew timing", "noise level"
UNKNOWN_DEG = (0.001, 1.0)  # of what is unknown
FLAT = 12**-0.5  # standard deviation of what is flat between zero and one
TIMING_STEP = 0.01  # of a timing between zero and one, for its derivative
MOST_FLIGHT_EFFECTS = 5  # four timings and one more
SPLITS = {"number": "a number at a time", "interval": "an interval at a time"}


@dataclass(frozen=True)
class LinearisationPoint:
    """What a table's model is linearised about."""

    flips: frozenset[int] = frozenset()  # intervals whose slews are the other way round
    # numbers between zero and one for each candidate's timings, by its axis
    timings: Mapping[str, Array] = field(default_factory=lambda: {one.axis: np.full(len(one.names), 0.5) for one in TIMINGS})


def build_flight_model(
    table: ResidualTable, baseline: Baseline, point: LinearisationPoint, split: str = "number"
) -> LinearModel:
    """The linear model of a table under a baseline about a point; `split`, of `SPLITS`, is what is held out at a time."""
    assumed, case = compute_motion_numbers(table, baseline), compute_motion_numbers(table, baseline, point.flips)
    L = np.asarray(np.linalg.cholesky(case.covariance))
    groups = [
        *_list_direction_candidates(table, baseline, assumed, L),
        *(_make_timing_candidate(case, one, point.timings[one.axis], L) for one in TIMINGS),
        _make_noise_candidate(table, baseline, case),
        *_list_random_rivals(L),
    ]
    owner = np.array([f"{k + 1} {name}" if split == "number" else f"{k + 1}" for k, name in RESIDUAL_PLACES])
    held = list(dict.fromkeys(owner))
    return build_model(assumed.d, case.covariance, groups, owner, held, SPLITS[split], MOST_FLIGHT_EFFECTS)


def move_point(point: LinearisationPoint, fitted: FittedEffect) -> LinearisationPoint:
    """The point with the timings that were found, as far as they can be flown."""
    if fitted.effect != TIMING or fitted.axis is None:
        return point
    return LinearisationPoint(point.flips, {**point.timings, fitted.axis: np.clip(0.5 + FLAT * fitted.amplitudes, 0.0, 1.0)})


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
    """Timings about a point, by finite differences of the simulator."""
    steps = np.where(u > 0.5, -TIMING_STEP, TIMING_STEP)
    points = [u, *(u + np.diag(steps))]
    flown = [timings.apply_timings(case.sections, one) for one in points]
    values = case.predicted([sections[k] for sections in flown for k in timings.intervals])
    values = values.reshape(len(points), len(timings.intervals), 3)
    J = np.moveaxis((values[1:] - values[0]) / steps[:, None, None], 0, 2)  # (intervals, 3, m)
    columns = np.zeros((6, 3, u.size + 1))
    columns[timings.intervals, :, :-1] = J * FLAT
    columns[timings.intervals, :, -1] = values[0] - J @ (u - 0.5) - case.prediction[list(timings.intervals)]
    names = dict(zip(timings.names, timings.values(case.sections, u).tolist(), strict=True))
    return _make_shifted_candidate(TIMING, timings.axis, whiten(L, columns.reshape(18, -1)), names, 1.0, "")


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
