"""The linear model of a table: motion numbers, and a candidate for everything that could part them from the prediction.

Observations are the 18 motion numbers, whitened by what print leaves of them (`numbers`). The candidates are

- *slew timing* of an interval, or common to all slews: linearised about a point of its own, which leaves a shift. Its
  amplitudes are the timings in standard deviations of their broad priors;
- *yaw direction* and *-y rate sign*: a shift alone, the prediction with the slews reversed less that with those assumed;
- *noise level*: without columns. The noise numbers share no noise with those of motion, so what they say of it comes from
  outside the linear model;
- unlisted rivals: a random residual of any size in all numbers, in one interval or in one number.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from diagnosis.inference.amplitudes import Fitted
from diagnosis.model.folds import held_out
from diagnosis.model.groups import Group, placed
from diagnosis.model.linear import LinearModel, Parameters
from diagnosis.settings import DEFAULT, DiagnosisSettings
from studies.natanson.flight_diagnosis.numbers import PLACES, Motion, motion, noise_factor
from studies.natanson.flight_diagnosis.table import Baseline, Table
from studies.natanson.flight_diagnosis.timings import TIMINGS, Timings
from studies.natanson.flight_gap import MINUS_Y, YAW_INTERVALS

Array = NDArray[np.float64]

YAW, RATE, TIMING, NOISE = "yaw direction", "-y rate sign", "slew timing", "noise level"
UNKNOWN_DEG = (0.001, 1.0)  # of what is unknown
FLAT = 12**-0.5  # standard deviation of what is flat between zero and one
STEP = 0.01  # of a timing between zero and one, for its derivative
MOST_EFFECTS = 5  # four timings and one more
BEAM = (40,) * (MOST_EFFECTS - 1)  # wide, since one of four timings alone explains little
SPLITS = {"number": "a number at a time", "interval": "an interval at a time"}


@dataclass(frozen=True)
class Point:
    """What a table's model is linearised about.

    Attributes
    ----------
    flips : intervals whose slews are the other way round
    timings : numbers between zero and one for each candidate's timings, by its axis
    """

    flips: frozenset[int] = frozenset()
    timings: Mapping[str, Array] = field(default_factory=lambda: {one.axis: np.full(len(one.names), 0.5) for one in TIMINGS})


def linear_model(
    table: Table, baseline: Baseline, point: Point, split: str = "number", settings: DiagnosisSettings = DEFAULT
) -> LinearModel:
    """The linear model of a table under a baseline.

    Parameters
    ----------
    table : what the paper prints
    baseline : what the simulator is told
    point : what it is linearised about
    split : what is held out at a time, one of `SPLITS`
    settings : priors
    """
    assumed, case = motion(table, baseline), motion(table, baseline, point.flips)
    L = np.asarray(np.linalg.cholesky(case.covariance))
    groups = [
        *_directions(table, baseline, assumed, L),
        *(_timing(case, one, point.timings[one.axis], L) for one in TIMINGS),
        _noise(table, baseline, case),
        *_rivals(L),
    ]
    candidates, W = placed(groups, lambda columns: columns, settings, len(PLACES))
    owner = np.array([f"{k + 1} {name}" if split == "number" else f"{k + 1}" for k, name in PLACES])
    return LinearModel(
        y=_whitened(L, assumed.d),
        X=W,
        W=W,
        candidates=candidates,
        dof=len(PLACES),
        projected=lambda values: values,
        most_effects=MOST_EFFECTS,
        beam=BEAM,
        split=SPLITS[split],
        folds=lambda W: (held_out(case.covariance, assumed.d, L @ W, owner == name, owner) for name in dict.fromkeys(owner)),
    )


def moved(point: Point, fitted: Fitted) -> Point:
    """The point with the timings that were found, as far as they can be flown."""
    if fitted.effect != TIMING or fitted.axis is None:
        return point
    return Point(point.flips, {**point.timings, fitted.axis: np.clip(0.5 + FLAT * fitted.amplitudes, 0.0, 1.0)})


def _whitened(L: Array, values: Array) -> Array:
    return np.asarray(scipy.linalg.solve_triangular(L, values, lower=True))


def _listed(effect: str, axis: str | None, columns: Array, read: Parameters, size: float, unit: str) -> Group:
    """A candidate with one option, whose prior is in its columns and whose last column is a shift."""
    return Group(
        effect, axis, True, [columns], [{}], np.ones(1), (0.0, np.inf), unit,
        read=lambda _: (size, read), shifted=True, scales=np.ones(1),
    )  # fmt: skip


def _directions(table: Table, baseline: Baseline, assumed: Motion, L: Array) -> Iterator[Group]:
    """Slews the other way round."""
    for k in (*YAW_INTERVALS, MINUS_Y):
        shift = (motion(table, baseline, (k,)).prediction - assumed.prediction).ravel()
        effect, size, unit = (RATE, 2.0, "RPO") if k == MINUS_Y else (YAW, 360.0, "deg")
        yield _listed(effect, f"{k + 1}", _whitened(L, shift[:, None]), {}, size, unit)


def _timing(case: Motion, timings: Timings, u: Array, L: Array) -> Group:
    """Timings about a point, by finite differences of the simulator."""
    steps = np.where(u > 0.5, -STEP, STEP)
    points = [u, *(u + np.diag(steps))]
    flown = [timings.moved(case.sections, one) for one in points]
    values = case.predicted([sections[k] for sections in flown for k in timings.intervals])
    values = values.reshape(len(points), len(timings.intervals), 3)
    J = np.moveaxis((values[1:] - values[0]) / steps[:, None, None], 0, 2)  # (intervals, 3, m)
    columns = np.zeros((6, 3, u.size + 1))
    columns[timings.intervals, :, :-1] = J * FLAT
    columns[timings.intervals, :, -1] = values[0] - J @ (u - 0.5) - case.prediction[list(timings.intervals)]
    names = dict(zip(timings.names, timings.values(case.sections, u).tolist(), strict=True))
    return _listed(TIMING, timings.axis, _whitened(L, columns.reshape(18, -1)), names, 1.0, "")


def _noise(table: Table, baseline: Baseline, case: Motion) -> Group:
    log_odds, mean, sigma = noise_factor(table, case.Theta, baseline)
    return Group(
        NOISE, None, True, [np.empty((len(PLACES), 0))], [{}], np.ones(1), (0.0, np.inf), "factor",
        log_odds=log_odds, read=lambda _: (mean, {}), size_sigma=lambda _: sigma, scales=np.ones(1),
    )  # fmt: skip


def _rivals(L: Array) -> Iterator[Group]:
    """Random residuals, per deg."""
    each = _whitened(L, np.eye(len(PLACES)))
    places: list[tuple[str, str | None, Array]] = [("unknown in all numbers", None, each)]
    places += [("unknown in an interval", f"{k + 1}", each[:, 3 * k : 3 * k + 3]) for k in range(6)]
    places += [("unknown in a number", f"{k + 1} {name}", each[:, [i]]) for i, (k, name) in enumerate(PLACES)]
    for effect, axis, columns in places:
        yield Group(effect, axis, False, [columns], [{}], np.ones(1), UNKNOWN_DEG, "deg", process=True)
