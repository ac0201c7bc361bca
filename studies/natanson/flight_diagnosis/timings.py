"""Timings of slews and of the hold: broad priors, and residuals and Θ over all of them.

A timing is a number between zero and one, uniform there; the simulator is interpolated by Chebyshev polynomials over the
unit cube of each interval, so that a prior can be integrated over with the simulator's own predictions.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from simulator.scenario import IntervalSection
from studies.natanson.flight_diagnosis.table import outcomes, trmm
from studies.natanson.flight_gap import HOLD, MINUS_Y, YAW_INTERVALS

Array = NDArray[np.float64]

TIMED = (*YAW_INTERVALS, MINUS_Y, HOLD)
# Prior ranges: slews of 0.1 to 0.6 deg/s on average (what fits), from a jerk to all ramp, anywhere in their interval; a stay in
# -y forward of "about one hour"; the hold begins within five minutes, as in `flight_gap`.
MEAN_RATES_DEG_S, RAMPS, SHORTEST_STAY_S = (0.1, 0.6), (0.02, 0.5), 3000.0
HOLD_START_S, HOLD_TRANSITION_S = 300.0, (10.0, 600.0)
COMMON = {"delay_s": (0.0, 300.0), "slew_rate_deg_s": (0.15, 0.6), "ramp_fraction": RAMPS, "stay_s": (3000.0, 4000.0)}
NODES = {1: (7, 8, 3), 5: (7, 8, 3), MINUS_Y: (5, 7, 4, 3), HOLD: (6, 8)}  # Chebyshev, in each timing
CLOUD = {1: 2**14, 5: 2**14, MINUS_Y: 2**15, HOLD: 2**12}  # points of the timings' priors
COMMON_CLOUD = 2**14


@dataclass(frozen=True)
class Timed:
    """The timings of one interval, each from a number between zero and one; uniform there is the prior.

    Attributes
    ----------
    k : interval, counted from 0
    names : of the timings
    """

    k: int
    names: tuple[str, ...]

    def values(self, u: Array) -> Array:
        """Timings (n, m) of numbers (n, m) in the unit cube, s (the ramp's share has no unit)."""
        section = trmm().interval[self.k]
        length = section.stop_s - section.start_s
        if self.k == HOLD:
            low, high = HOLD_TRANSITION_S
            return np.column_stack([HOLD_START_S * u[:, 0], low * (high / low) ** u[:, 1]])
        low, high = self.durations()
        duration = low * (high / low) ** u[:, 1]
        ramp = RAMPS[0] + (RAMPS[1] - RAMPS[0]) * u[:, -1]
        if self.k != MINUS_Y:
            return np.column_stack([u[:, 0] * (length - duration), duration, ramp])
        stay = SHORTEST_STAY_S + u[:, 2] * (length - duration - SHORTEST_STAY_S)
        return np.column_stack([u[:, 0] * (length - duration - stay), duration, stay, ramp])

    def durations(self) -> tuple[float, float]:
        """Shortest and longest slew, s."""
        section = trmm().interval[self.k]
        angle = abs(section.slew[0].angle_deg)
        return angle / MEAN_RATES_DEG_S[1], min(angle / MEAN_RATES_DEG_S[0], section.stop_s - section.start_s)

    def section(self, timings: Array, sign: int) -> IntervalSection:
        """The interval with these timings, its first slew of this sign."""
        section = trmm().interval[self.k]
        start = float(timings[0])
        if section.hold:
            hold = section.hold.model_copy(update={"start_s": start, "transition_s": float(timings[1])})
            return section.model_copy(update={"hold": hold})
        later = (0.0, float(timings[2])) if self.k == MINUS_Y else (0.0,)
        slews = tuple(
            slew.model_copy(
                update={
                    "angle_deg": sign * (-1) ** j * abs(slew.angle_deg),
                    "start_s": start + later[j],
                    "duration_s": float(timings[1]),
                    "ramp_fraction": float(timings[-1]),
                }
            )
            for j, slew in enumerate(section.slew)
        )
        return section.model_copy(update={"slew": slews})


SLEW_TIMINGS = ("start_s", "duration_s", "ramp_fraction")
TIMINGS = {
    **{k: Timed(k, SLEW_TIMINGS) for k in YAW_INTERVALS},
    MINUS_Y: Timed(MINUS_Y, ("start_s", "duration_s", "stay_s", "ramp_fraction")),
    HOLD: Timed(HOLD, ("start_s", "transition_s")),
}


def cube(count: int, dimensions: int) -> Array:
    """Evenly spread points (count, dimensions) of the unit cube: an additive recurrence (Roberts 2018)."""
    root = 2.0
    for _ in range(40):
        root = (1 + root) ** (1 / (dimensions + 1))
    return np.asarray((0.5 + np.outer(np.arange(1, count + 1), root ** -np.arange(1.0, dimensions + 1))) % 1.0)


@dataclass(frozen=True)
class Surrogate:
    """Residuals and Θ of one interval over its timings, by Chebyshev interpolation of the simulator.

    Attributes
    ----------
    counts : nodes along each timing
    coefficients : (Π counts, 39), of the residual and Θ
    """

    counts: tuple[int, ...]
    coefficients: Array

    def __call__(self, u: Array, shift: Array | None = None) -> Array:
        """Residual and Θ (n, 39) at points of the unit cube; with a shift (12,) of the truth, the residual then (n, 3)."""
        wanted = self.coefficients if shift is None else shifted(self.coefficients, shift)
        parts = []
        for some in np.array_split(u, max(1, len(u) // 4096)):
            basis = np.ones((len(some), 1))
            for j, count in enumerate(self.counts):
                along = np.polynomial.chebyshev.chebvander(2 * some[:, j] - 1, count - 1)
                basis = (basis[:, :, None] * along[:, None, :]).reshape(len(some), -1)
            parts.append(basis @ wanted)
        return np.concatenate(parts)


def shifted(values: Array, shift: Array) -> Array:
    """Residuals (n, 3) for a truth moved by shift, from residuals and Θ (n, 39)."""
    return np.asarray(values[:, :3] - values[:, 3:].reshape(-1, 3, 12) @ shift)


@cache
def surrogate(k: int, sign: int) -> Surrogate:
    """Of one interval and sign of its first slew."""
    counts = NODES[k]
    nodes = [0.5 - 0.5 * np.cos(np.pi * (np.arange(count) + 0.5) / count) for count in counts]
    u = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, len(counts))
    theta, Theta = outcomes([TIMINGS[k].section(row, sign) for row in TIMINGS[k].values(u)])
    values = np.hstack([theta, Theta.reshape(len(u), 36)]).reshape(*counts, 39)
    for j, count in enumerate(counts):
        inverse = np.linalg.inv(np.polynomial.chebyshev.chebvander(2 * nodes[j] - 1, count - 1))
        values = np.moveaxis(np.tensordot(inverse, values, axes=(1, j)), 0, j)
    return Surrogate(counts, values.reshape(-1, 39))


@cache
def cloud(k: int, sign: int) -> tuple[Array, Array]:
    """Points (n, m) of the timings' prior, with residuals and Θ (n, 39)."""
    u = cube(CLOUD[k], len(NODES[k]))
    return u, surrogate(k, sign)(u)


def common_points(u: Array) -> tuple[Array, dict[int, Array]]:
    """Which of the points (n, 4) of the common timings can be flown, and those as points of each slewing interval's cube."""
    low, high = np.array(list(COMMON.values())).T
    delay, _, ramp, stay = (low + u * (high - low)).T
    rate = low[1] * (high[1] / low[1]) ** u[:, 1]
    out, good = {}, np.ones(len(u), dtype=bool)
    for k in (*YAW_INTERVALS, MINUS_Y):
        section = trmm().interval[k]
        duration = abs(section.slew[0].angle_deg) / (rate * (1 - ramp))
        shortest, longest = TIMINGS[k].durations()
        slack = section.stop_s - section.start_s - duration - (stay if k == MINUS_Y else 0.0)
        share = [(stay - SHORTEST_STAY_S) / (slack + stay - SHORTEST_STAY_S)] if k == MINUS_Y else []
        with np.errstate(divide="ignore"):
            point = [
                delay / slack,
                np.log(duration / shortest) / np.log(longest / shortest),
                *share,
                (ramp - RAMPS[0]) / np.ptp(RAMPS),
            ]
        out[k] = np.column_stack(point)
        good &= (slack > 0) & (out[k] >= 0).all(axis=1) & (out[k] <= 1).all(axis=1)
    return good, {k: points[good] for k, points in out.items()}


@cache
def common_cloud(signs: tuple[int, ...]) -> tuple[Array, dict[int, Array]]:
    """Points (n, 4) of the common timings that can be flown, with residuals and Θ (n, 39) of each slewing interval."""
    u = cube(COMMON_CLOUD, 4)
    good, points = common_points(u)
    return u[good], {k: surrogate(k, sign)(points[k]) for k, sign in zip((*YAW_INTERVALS, MINUS_Y), signs, strict=True)}
