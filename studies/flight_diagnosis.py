"""The flight's table diagnosed: what parts the predicted from the flown pre-launch residuals of N Table 2.

The numbers. y, the 18 pre-launch residuals at 0.5 s; c, the same after calibration; the columns at 1 and 2 s; the published
calibration x̂ (R eq. (9)); the pre-launch parameters x₀ (N Table 3). To first order, with noise n and the sensitivities Θ,

    y = Θ(x₀ − x) + n,   c = Θ(x̂ − x) + n   so that   y − c = Θ(x₀ − x̂)

whatever the noise and whatever the weights of the flight's estimator: x̂ was fitted to these very residuals, and what makes it
uncertain is the noise in them. So the uncertainty of G and b must not be added to that of the residuals as if it were another
one. The diagnosis therefore has two parts, which share no noise:

- *Motion*, 18 numbers: d = y − c − prediction. What is left in them is print: cells to 0.001 deg, the intervals' times to 15 s,
  Table 3 and R (9) to their last digits (which correlates the intervals through Θ), and one second-iteration correction (N
  Table 5), since the papers do not say which iterate c belongs to.
- *Noise*, 6 + 36 numbers: c off the columns of Θ (the six numbers no calibration can take away, whatever its weights), of
  covariance V = 2σ² + a²T (references at both ends, gyro), and the differences between the step columns, a²T and 2a²T.

Hypotheses, in families of equal prior weight, pairs of families a tenth of that: nothing; the yaw of interval 2, 6 or both the
other way; the other sign of the -y forward rate; other slew timings, of any set of the four maneuvers each its own, or common
to all; another noise level; and *unknown*, a random residual in all numbers, in one interval or in one number, its size mixed
over log-spaced scales. Timings have broad priors and are integrated over with the simulator's own predictions; nothing is
fitted. A cause is named at a probability of 0.95 or more.

Two settings were made after a first look at the flight's table, neither to fit it: the times' 15 s, a source of print that had
been forgotten, and 0.001 instead of 0.003 deg as the smallest unknown. The verdict was the same without them.

The yaw and rate hypotheses keep the baseline's timings; Θ in the noise part is that of the assumed timings.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache, partial
from itertools import combinations
from pathlib import Path
from typing import Any, Self

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydantic import model_validator
from rich.console import Console
from scipy.special import chdtrc, logsumexp

from gyrocal import accumulation, attitude, propagate
from gyrocal.sampling import measurements
from simulator import scenario as scenarios
from simulator.scenario import IntervalSection, Scenario
from simulator.simulate import motion, observe
from studies import engine, flight, flight_gap, report
from studies.figures import STYLE, save
from studies.flight_gap import HOLD, MINUS_Y, YAW_INTERVALS
from studies.manifest import write_json
from studies.report import Entry, Report
from studies.statistics import binomial_interval
from studies.study import Streams, Study, StudyConfig

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Families = frozenset[str]

YAW, RATE, TIMING, NOISE, UNKNOWN = "yaw direction", "-y rate sign", "slew timing", "noise level", "unknown"
FAMILIES = (YAW, RATE, TIMING, NOISE, UNKNOWN)
PAIR_WEIGHT = 0.1  # prior of two families at once over that of one
SURE = 0.95
FALSE_ALARM = 0.01
TIMED = (*YAW_INTERVALS, MINUS_Y, HOLD)

# Prior ranges: slews of 0.1 to 0.6 deg/s on average (what fits), from a jerk to all ramp, anywhere in their interval; a stay in
# -y forward of "about one hour"; the hold begins within five minutes, as in `flight_gap`.
MEAN_RATES_DEG_S, RAMPS, SHORTEST_STAY_S = (0.1, 0.6), (0.02, 0.5), 3000.0
HOLD_START_S, HOLD_TRANSITION_S = 300.0, (10.0, 600.0)
COMMON = {"delay_s": (0.0, 300.0), "slew_rate_deg_s": (0.15, 0.6), "ramp_fraction": RAMPS, "stay_s": (3000.0, 4000.0)}
NOISE_FACTORS = np.geomspace(0.1, 10.0, 81)
UNKNOWN_DEG = np.geomspace(0.001, 1.0, 7)

# Last digits printed: Table 2 in deg; Table 3 before launch (its scale factors of one are exact), R (9); G, then b in deg/s.
CELL_DEG = 1e-3
CLOCK_S = 15.0  # Table 1's times are multiples of it
_M = np.deg2rad(1e-3)
INITIAL_DIGITS = np.array([0, _M, _M, _M, 0, _M, _M, _M, 0, *np.deg2rad([1e-6, 1e-6, 1e-6])])
PUBLISHED_DIGITS = np.array([1e-6, 1e-6, 1e-9, 1e-9, 1e-5, 1e-7, 1e-9, 1e-7, 1e-5, *np.deg2rad([1e-10, 1e-10, 1e-11])])

NODES = {1: (7, 8, 3), 5: (7, 8, 3), MINUS_Y: (5, 7, 4, 3), HOLD: (6, 8)}  # Chebyshev, in each timing
CLOUD = {1: 2**14, 5: 2**14, MINUS_Y: 2**15, HOLD: 2**12}  # points of the timings' priors
COMMON_CLOUD = 2**14
DRAWS = 1024
WIDENED = 2.0  # covariance of the sampling density over that of the likelihood


# --- The numbers --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Table:
    """What the paper prints of a calibration.

    Attributes
    ----------
    before, after : (6, 3) residuals at 0.5 s before and after calibration, deg
    coarser : (2, 6, 3) residuals before calibration at 1 and 2 s, deg
    published : (12,) the calibration; G, and b in rad/s
    """

    before: Array
    after: Array
    coarser: Array
    published: Array


def flown() -> Table:
    """The flight's."""
    coarser = np.array([flight.residuals("prelaunch", step) for step in flight.STEPS[1:]])
    return Table(flight.residuals("prelaunch"), flight.residuals("calibrated"), coarser, flight.calibration().vector)


@dataclass(frozen=True)
class Baseline:
    """What the simulator is told.

    Attributes
    ----------
    name : for people
    scenario : motion and noise
    noise_factor : on the scenario's noise
    """

    name: str
    scenario: Scenario
    noise_factor: float = 1.0

    def variances(self) -> tuple[Array, Array]:
        """(6,) of a residual, and its gyro part a²T, deg²."""
        T = np.array([interval.stop_s - interval.start_s for interval in self.scenario.interval])
        gyro = self.noise_factor**2 * self.scenario.gyro.arw_deg_per_sqrt_s**2 * T
        sigma = np.mean(np.square(self.scenario.reference.sigma_deg))
        return gyro + 2 * self.noise_factor**2 * sigma, gyro


@cache
def trmm() -> Scenario:
    """The scenario every prediction takes orbit and sampling from, at coarse samples."""
    return scenarios.override(scenarios.load("trmm"), {"gyro.sample_s": flight_gap.COARSE_SAMPLE_S})


def outcomes(sections: Sequence[IntervalSection]) -> tuple[Array, Array]:
    """Noise-free residuals (n, 3) deg and Θ (n, 3, 12) deg per unit, of R (9) as truth and Table 3 as a priori.

    The intervals are simulated one after the other, wherever they were: on a circular orbit their residuals do not depend on
    when they begin.
    """
    longest = max(section.stop_s - section.start_s for section in sections) + 1000.0
    moved = tuple(
        section.model_copy(
            update={"name": f"v{i}", "start_s": i * longest, "stop_s": i * longest + section.stop_s - section.start_s}
        )
        for i, section in enumerate(sections)
    )
    scenario = trmm().model_copy(update={"interval": moved})
    truth, initial = flight.calibration(), flight.parameters("prelaunch")
    recording = observe(scenario, motion(scenario), gyro_rng=None, reference_rng=None, G=truth.G, bias=truth.bias)
    prepared = measurements(recording)
    passed = propagate(prepared.arcs, initial.G, initial.bias)
    A = attitude.matrix_from_quaternion(recording.attitudes.quaternions)
    theta = accumulation.residuals(passed.R, A[prepared.start], A[prepared.row])
    return np.rad2deg(theta), np.rad2deg(passed.Theta)


@lru_cache(maxsize=256)
def _outcome(section: IntervalSection) -> tuple[Array, Array]:
    theta, Theta = outcomes([section])
    return theta[0], Theta[0]


def reversed_slews(section: IntervalSection) -> IntervalSection:
    """The interval with its slews the other way round: yaws reversed; −y forward becomes +y forward, of the other rate."""
    return section.model_copy(update={"slew": tuple(s.model_copy(update={"angle_deg": -s.angle_deg}) for s in section.slew)})


def _sign(section: IntervalSection) -> int:
    return int(np.sign(section.slew[0].angle_deg)) if section.slew else 1


# --- Timings and their priors -------------------------------------------------------------------------------------------------


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
        wanted = self.coefficients if shift is None else _shifted(self.coefficients, shift)
        parts = []
        for some in np.array_split(u, max(1, len(u) // 4096)):
            basis = np.ones((len(some), 1))
            for j, count in enumerate(self.counts):
                along = np.polynomial.chebyshev.chebvander(2 * some[:, j] - 1, count - 1)
                basis = (basis[:, :, None] * along[:, None, :]).reshape(len(some), -1)
            parts.append(basis @ wanted)
        return np.concatenate(parts)


def _shifted(values: Array, shift: Array) -> Array:
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
def _common_cloud(signs: tuple[int, ...]) -> tuple[Array, dict[int, Array]]:
    u = cube(COMMON_CLOUD, 4)
    good, points = common_points(u)
    return u[good], {k: surrogate(k, sign)(points[k]) for k, sign in zip((*YAW_INTERVALS, MINUS_Y), signs, strict=True)}


# --- Evidence -----------------------------------------------------------------------------------------------------------------


def _log_normal(residuals: Array, covariance: Array) -> Array:
    """Log density of rows (n, m) with zero mean."""
    L = np.linalg.cholesky(covariance)
    z = np.linalg.inv(L) @ residuals.T  # of a few rows: faster than a solve, and as good at these condition numbers
    return np.asarray(-0.5 * np.sum(z**2, axis=0) - np.log(np.diag(L)).sum() - 0.5 * len(L) * np.log(2 * np.pi))


@lru_cache(maxsize=256)
def clock_derivatives(section: IntervalSection, step_s: float = 4.0) -> Array:
    """What a second of the interval's start and of its stop does to its residuals while the motion stays, (3, 2) deg/s."""
    later = section.model_copy(update={"stop_s": section.stop_s + step_s})
    slews = tuple(slew.model_copy(update={"start_s": slew.start_s + step_s}) for slew in section.slew)
    hold = section.hold and section.hold.model_copy(
        update={"start_s": section.hold.start_s + step_s, "stop_s": section.hold.stop_s + step_s}
    )
    earlier = later.model_copy(update={"slew": slews, "hold": hold})
    theta, _ = outcomes([section, earlier, later])
    return np.asarray((theta[1:] - theta[0]).T / step_s)


def motion_covariance(Theta: Array, sections: Sequence[IntervalSection]) -> Array:
    """What print leaves of d, (18, 18) deg²; Theta (6, 3, 12) deg per unit."""
    H = Theta.reshape(18, 12)
    clock = np.zeros((18, 18))
    for k, section in enumerate(sections):
        moved = clock_derivatives(section) * CLOCK_S
        clock[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = moved @ moved.T / 12
    digits = (INITIAL_DIGITS**2 + PUBLISHED_DIGITS**2) / 12
    G, bias = flight.corrections(2)
    second = H @ np.concatenate([G.ravel(), np.deg2rad(bias)])
    return np.asarray(2 * CELL_DEG**2 / 12 * np.eye(18) + clock + H * digits @ H.T + np.outer(second, second))


@dataclass(frozen=True)
class Prepared:
    """A table against a baseline, some of its slews reversed.

    Attributes
    ----------
    flips : intervals whose slews are reversed
    sections : the six intervals
    target : (18,) y − c, deg
    prediction : (18,) deg
    covariance : (18, 18) of d, deg²
    shift : (12,) published minus R (9)
    noise : log likelihood of the noise numbers at `NOISE_FACTORS`, and at one
    """

    flips: tuple[int, ...]
    sections: tuple[IntervalSection, ...]
    target: Array
    prediction: Array
    covariance: Array
    shift: Array
    noise: tuple[Array, float]

    @property
    def d(self) -> Array:
        """(18,) deg."""
        return self.target - self.prediction


def noise_numbers(table: Table, Theta: Array, baseline: Baseline) -> tuple[Array, Array]:
    """The 42 numbers of the noise, whitened under the baseline, and the share of print in the variance of each, (42,).

    c is projected off Θ's columns, which takes out whatever the flight's estimator made of the noise.
    """
    total, gyro = baseline.variances()
    H = Theta.reshape(18, 12) / np.linalg.norm(Theta.reshape(18, 12), axis=0)
    V = np.repeat(total, 3)
    whiten = 1 / np.sqrt(V)
    U = np.linalg.svd(H * whiten[:, None])[0][:, 12:]
    # Print adds to V but little: kept as a variance of each of the six numbers, without their correlation.
    z = U.T @ (table.after.ravel() * whiten)
    z_print = CELL_DEG**2 / 12 * np.sum((U * whiten[:, None]) ** 2, axis=0)
    columns = [table.before, *table.coarser]
    steps = np.array([columns[1] - columns[0], (columns[2] - columns[1]) / np.sqrt(2)]) / np.sqrt(gyro)[:, None]
    steps_print = CELL_DEG**2 / 6 * np.array([1.0, 0.5])[:, None, None] / np.broadcast_to(gyro[:, None], (2, 6, 3))
    return np.concatenate([z, steps.ravel()]), np.concatenate([z_print, steps_print.ravel()])


def _noise_likelihood(z: Array, z_print: Array, factors: Array) -> Array:
    variance = factors[:, None] ** 2 + z_print
    return np.asarray(-0.5 * np.sum(z**2 / variance + np.log(2 * np.pi * variance), axis=1))


def prepare(table: Table, baseline: Baseline, flips: tuple[int, ...] = ()) -> Prepared:
    """Predict under the baseline with some slews reversed."""
    sections = tuple(reversed_slews(s) if k in flips else s for k, s in enumerate(baseline.scenario.interval))
    theta, Theta = (np.array(part) for part in zip(*(_outcome(section) for section in sections), strict=True))
    shift = table.published - flight.calibration().vector
    z, z_print = noise_numbers(table, Theta, baseline)
    likelihood = _noise_likelihood(z, z_print, np.append(NOISE_FACTORS, 1.0))
    return Prepared(
        flips=flips,
        sections=sections,
        target=(table.before - table.after).ravel(),
        prediction=(theta - Theta @ shift).ravel(),
        covariance=motion_covariance(Theta, sections),
        shift=shift,
        noise=(likelihood[:-1], float(likelihood[-1])),
    )


@dataclass(frozen=True)
class Draws:
    """Timings drawn near what the data want, and what corrects for that.

    Attributes
    ----------
    predictions : interval to predicted residuals (n, 3), deg
    log_weight : (n,) log of prior over sampling density
    timings : names to (n,) values
    """

    predictions: dict[int, Array]
    log_weight: Array
    timings: dict[str, Array]


def _systematic(log_weight: Array, seed: int) -> tuple[Indices, Array]:
    """`DRAWS` indices in proportion to the weights, in random order, and the log of each one's share."""
    share = np.exp(log_weight - logsumexp(log_weight))
    edges = np.cumsum(share)
    chosen = np.minimum(np.searchsorted(edges, (np.arange(DRAWS) + 0.5) / DRAWS * edges[-1]), len(share) - 1)
    np.random.default_rng(seed).shuffle(chosen)  # so that two intervals' draws do not go hand in hand
    return chosen, np.log(share[chosen])


def own_draws(case: Prepared, k: int, used: NDArray[np.bool_] | None = None) -> Draws:
    """Timings of interval k by itself, drawn by those of its three numbers that are used."""
    u, values = cloud(k, _sign(case.sections[k]))
    predictions = _shifted(values, case.shift)
    rows = np.arange(3 * k, 3 * k + 3)[np.ones(3, dtype=bool) if used is None else used]
    log_weight = np.zeros(len(u))
    if rows.size:
        spread = WIDENED * case.covariance[np.ix_(rows, rows)]
        log_weight = _log_normal(case.target[rows] - predictions[:, rows - 3 * k], spread)
    chosen, log_share = _systematic(log_weight, k)
    names = TIMINGS[k].names
    timings = dict(zip((f"m{k + 1} {name}" for name in names), TIMINGS[k].values(u[chosen]).T, strict=True))
    return Draws({k: predictions[chosen]}, -np.log(len(u)) - log_share, timings)


def common_draws(case: Prepared, used: NDArray[np.bool_] | None = None) -> Draws:
    """Timings common to all slews: a coarse look at the whole prior, then points inside the box of what is likely."""
    slewing = (*YAW_INTERVALS, MINUS_Y)
    signs = tuple(_sign(case.sections[k]) for k in slewing)
    rows = np.concatenate([np.arange(3 * k, 3 * k + 3) for k in slewing])
    rows = rows if used is None else rows[used[rows]]
    spread = WIDENED * case.covariance[np.ix_(rows, rows)]

    def weigh(predictions: Mapping[int, Array]) -> Array:
        full = np.zeros((len(predictions[MINUS_Y]), 18))
        for k in slewing:
            full[:, 3 * k : 3 * k + 3] = predictions[k]
        return _log_normal(case.target[rows] - full[:, rows], spread)

    u, values = _common_cloud(signs)
    coarse = weigh({k: _shifted(values[k], case.shift) for k in slewing})
    best = u[np.argsort(coarse)[-48:]]
    low, high = best.min(axis=0), best.max(axis=0)
    margin = 0.15 * (high - low) + 0.01
    low, high = np.maximum(low - margin, 0), np.minimum(high + margin, 1)
    fine = low + cube(COMMON_CLOUD // 4, 4) * (high - low)
    good, points = common_points(fine)
    predictions = {k: surrogate(k, sign)(points[k], case.shift) for k, sign in zip(slewing, signs, strict=True)}
    chosen, log_share = _systematic(weigh(predictions), 9)
    # Prior density: uniform over what can be flown; the box holds its volume's share of that.
    density = np.prod(high - low) / len(fine) / (len(u) / COMMON_CLOUD)
    names = ("delay_s", "slew_rate_deg_s", "ramp_fraction", "stay_s")
    bounds = np.array(list(COMMON.values()))
    u_fine = fine[good][chosen]
    physical = bounds[:, 0] + u_fine * np.ptp(bounds, axis=1)
    physical[:, 1] = bounds[1, 0] * (bounds[1, 1] / bounds[1, 0]) ** u_fine[:, 1]
    timings = {f"common {name}": physical[:, j] for j, name in enumerate(names)}
    return Draws({k: predictions[k][chosen] for k in slewing}, np.log(density) - log_share, timings)


def joined(parts: Sequence[Draws]) -> Draws:
    """Independent draws side by side."""
    return Draws(
        {k: p for part in parts for k, p in part.predictions.items()},
        np.sum([part.log_weight for part in parts], axis=0),
        {name: values for part in parts for name, values in part.timings.items()},
    )


def residuals_of(case: Prepared, draws: Draws) -> Array:
    """d (n, 18) at each draw, deg."""
    out = np.tile(case.d, (DRAWS, 1))
    for k, predictions in draws.predictions.items():
        out[:, 3 * k : 3 * k + 3] = case.target[3 * k : 3 * k + 3] - predictions
    return out


def _evidence(case: Prepared, d: Array, log_weight: Array | float = 0.0, extra: Array | float = 0.0) -> float:
    """Log evidence of d (n, 18) at n draws of log weight (n,), with extra variances (18,) in deg²."""
    covariance = case.covariance + np.diag(np.broadcast_to(extra, 18))
    return float(logsumexp(_log_normal(d, covariance) + log_weight) - np.log(len(d)))


def _patterns(scales: Array, single: bool) -> list[tuple[str, float, Array]]:
    """Unknown residuals: name, log prior within the family, and variances (18,)."""
    kinds: list[list[tuple[str, Array]]] = [
        [("all numbers", np.ones(18))],
        [(f"interval {k + 1}", np.repeat(np.arange(6) == k, 3).astype(float)) for k in range(6)],
    ]
    if single:
        kinds.append([(f"interval {i // 3 + 1} {flight.ROTATIONS[i % 3]}", np.eye(18)[i]) for i in range(18)])
    return [
        (name, -np.log(len(kinds) * len(kind) * len(scales)), scale**2 * where)
        for kind in kinds
        for name, where in kind
        for scale in scales
    ]


@dataclass(frozen=True)
class Hypothesis:
    """One member of one or two families.

    Attributes
    ----------
    families : what it is made of; empty for the baseline as it is
    label : for people
    log_weight : log of prior times evidence
    flips : intervals whose slews are reversed
    timed : intervals with timings of their own, or "common"
    extra : (18,) variances of an unknown residual, deg²
    """

    families: Families
    label: str
    log_weight: float
    flips: tuple[int, ...] = ()
    timed: tuple[int, ...] | str = ()
    extra: Array = field(default_factory=lambda: np.zeros(18))


FLIPS: tuple[tuple[int, ...], ...] = ((), (1,), (5,), (1, 5), (3,), (1, 3), (3, 5), (1, 3, 5))
_YAW_MEMBERS = 3


def _flip_families(flips: tuple[int, ...]) -> tuple[Families, str, float]:
    """Families, label and log prior within them."""
    yaws = [k for k in flips if k != MINUS_Y]
    families = frozenset(([YAW] if yaws else []) + ([RATE] if MINUS_Y in flips else []))
    labels = ([f"yaw reversed in {' and '.join(str(k + 1) for k in yaws)}"] if yaws else []) + (
        ["rate sign reversed in 4"] if MINUS_Y in flips else []
    )
    return families, ", ".join(labels), -np.log(_YAW_MEMBERS) if yaws else 0.0


def _timing_sets() -> list[tuple[tuple[int, ...] | str, float]]:
    """Sets of intervals with timings of their own, and common ones; log prior: each number of intervals as likely."""
    sets: list[tuple[tuple[int, ...] | str, float]] = [("common", -np.log(5))]
    for size in range(1, 5):
        members = list(combinations(TIMED, size))
        sets += [(tuple(sorted(member)), -np.log(5 * len(members))) for member in members]
    return sets


def _timing_label(timed: tuple[int, ...] | str) -> str:
    return "timings common to all" if isinstance(timed, str) else f"timing of {', '.join(str(k + 1) for k in timed)}"


def draws_of(case: Prepared, timed: tuple[int, ...] | str, used: NDArray[np.bool_] | None = None) -> Draws:
    """Draws of a timing hypothesis; used (18,) says which numbers may steer them."""
    if isinstance(timed, str):
        return common_draws(case, used)
    return joined([own_draws(case, k, None if used is None else used[3 * k : 3 * k + 3]) for k in timed])


def hypotheses(table: Table, baseline: Baseline) -> list[Hypothesis]:
    """All of them, weighed."""
    out: list[Hypothesis] = []

    def add(families: Families, label: str, log_prior: float, motion_part: float, case: Prepared, **recipe: Any) -> None:
        curve, one = case.noise
        for noisy in (False, True):
            both = families | {NOISE} if noisy else families
            if len(both) > 2:
                continue
            prior = log_prior + (np.log(PAIR_WEIGHT) if len(both) == 2 else 0.0)
            noise_part = float(logsumexp(curve) - np.log(len(curve))) if noisy else one
            name = ", ".join(part for part in (label, "noise level" if noisy else "") if part)
            out.append(Hypothesis(both, name or "baseline", prior + motion_part + noise_part, case.flips, **recipe))

    for flips in FLIPS:
        families, label, log_prior = _flip_families(flips)
        case = prepare(table, baseline, flips)
        add(families, label, log_prior, _evidence(case, case.d[None]), case)
        if len(families) > 1:
            continue
        for name, within, extra in _patterns(UNKNOWN_DEG, single=True):
            text = f"{label}, unknown in {name}".removeprefix(", ")
            add(families | {UNKNOWN}, text, log_prior + within, _evidence(case, case.d[None], extra=extra), case, extra=extra)
        own = {k: own_draws(case, k) for k in TIMED}
        for timed, within in _timing_sets():
            draws = common_draws(case) if isinstance(timed, str) else joined([own[k] for k in timed])
            text = f"{label}, {_timing_label(timed)}".removeprefix(", ")
            d = residuals_of(case, draws)
            add(families | {TIMING}, text, log_prior + within, _evidence(case, d, draws.log_weight), case, timed=timed)
            if flips:
                continue
            for name, inside, extra in _patterns(UNKNOWN_DEG, single=False):
                both = f"{text}, unknown in {name}"
                weight = _evidence(case, d, draws.log_weight, extra)
                add(frozenset((TIMING, UNKNOWN)), both, within + inside, weight, case, timed=timed, extra=extra)
    return out


# --- Verdict ------------------------------------------------------------------------------------------------------------------


def holm(p_values: Array) -> Array:
    """Holm's corrected p-values."""
    order = np.argsort(p_values)
    stepped = np.maximum.accumulate((len(p_values) - np.arange(len(p_values))) * p_values[order])
    out = np.empty(len(p_values))
    out[order] = np.minimum(stepped, 1.0)
    return out


def gap_test(table: Table, baseline: Baseline) -> dict[str, float]:
    """χ² of the motion's 18 and of the noise's 42 numbers under the baseline, the latter two-sided, and Holm's p of both."""
    case = prepare(table, baseline)
    motion_chi2 = float(case.d @ np.linalg.solve(case.covariance, case.d))
    Theta = np.array([_outcome(section)[1] for section in case.sections])
    z, z_print = noise_numbers(table, Theta, baseline)
    noise_chi2 = float(np.sum(z**2 / (1 + z_print)))
    upper = float(chdtrc(42, noise_chi2))
    p = holm(np.array([chdtrc(18, motion_chi2), 2 * min(upper, 1 - upper)]))
    return {
        "motion_chi2": motion_chi2,
        "motion_p": float(p[0]),
        "noise_chi2": noise_chi2,
        "noise_p": float(p[1]),
        "p_value": float(p.min()),
    }


def where(table: Table, baseline: Baseline) -> pd.DataFrame:
    """A row per number and per interval: d over its sigma, χ², and Holm's p over the 18 numbers and over the six intervals."""
    case = prepare(table, baseline)
    z = case.d / np.sqrt(np.diag(case.covariance))
    blocks = [slice(3 * k, 3 * k + 3) for k in range(6)]
    chi2 = np.array([case.d[b] @ np.linalg.solve(case.covariance[b, b], case.d[b]) for b in blocks])
    numbers = holm(chdtrc(1, z**2))
    intervals = holm(chdtrc(3, chi2))
    rows = [
        {
            "interval": k + 1,
            "axis": axis,
            "gap_deg": (table.before.ravel() - case.prediction)[3 * k + j],
            "beyond_calibration_deg": case.d[3 * k + j],
            "sigma_deg": float(np.sqrt(case.covariance[3 * k + j, 3 * k + j])),
            "chi2": float(z[3 * k + j] ** 2),
            "p_holm": numbers[3 * k + j],
            "interval_chi2": chi2[k],
            "interval_p_holm": intervals[k],
        }
        for k in range(6)
        for j, axis in enumerate(flight.ROTATIONS)
    ]
    return pd.DataFrame(rows)


def by_step() -> pd.DataFrame:
    """y − c − prediction under the present baseline at every step, each with its own calibration of N Table 3, deg.

    A check that shares no print but that of the pre-launch parameters: what is motion is the same in all three columns.
    """
    sections = present().scenario.interval
    theta, Theta = (np.array(part) for part in zip(*(_outcome(section) for section in sections), strict=True))
    digits = np.where(np.eye(3, dtype=bool).ravel(), 1e-5, _M)
    table3 = np.append(digits, np.deg2rad([1e-6] * 3))
    H = Theta.reshape(18, 12)
    rows = []
    for step in flight.STEPS:
        exact = step == flight.STEPS[0]  # R (9)
        used = flight.calibration() if exact else flight.parameters("calibrated", step)
        after = flight.residuals("calibrated", step)
        gap = flight.residuals("prelaunch", step) - after - theta + Theta @ (used.vector - flight.calibration().vector)
        covariance = motion_covariance(Theta, sections) + (0 if exact else H * table3**2 / 12 @ H.T)
        sigma = np.sqrt(np.diag(covariance)).reshape(6, 3)
        rows += [
            {
                "step_s": step,
                "interval": k + 1,
                "axis": axis,
                "gap_deg": gap[k, j],
                "sigma_deg": sigma[k, j],
                "after_deg": after[k, j],
            }
            for k in range(6)
            for j, axis in enumerate(flight.ROTATIONS)
        ]
    return pd.DataFrame(rows)


@dataclass(frozen=True)
class Judgement:
    """What the hypotheses' weights say.

    Attributes
    ----------
    verdict : "none", "named", "group" or "unknown"
    causes : families at work
    group : sets of families that hold `SURE` of the probability together, the likeliest first
    sets : probability of each set of families, the likeliest first
    includes : probability that a family is at work; of "unknown", that something remains beside what is named
    best : likeliest hypothesis of the likeliest set
    p_value : of there being a gap
    """

    verdict: str
    causes: tuple[str, ...]
    group: tuple[Families, ...]
    sets: dict[Families, float]
    includes: dict[str, float]
    best: Hypothesis
    p_value: float
    weighed: tuple[Hypothesis, ...] = field(repr=False, default=())

    def unknown_deg(self) -> tuple[float, float]:
        """Size of what is unknown, mean and sigma over the hypotheses that hold one, deg; zeros without."""
        holding = [h for h in self.weighed if UNKNOWN in h.families]
        if not holding:
            return 0.0, 0.0
        weight = np.exp(np.array([h.log_weight for h in holding]) - logsumexp([h.log_weight for h in holding]))
        size = np.sqrt([h.extra.max() for h in holding])
        mean = float(weight @ size)
        return mean, float(np.sqrt(weight @ (size - mean) ** 2))

    def members(self) -> dict[str, float]:
        """Probability of each interval's slew reversed or timing other than assumed, over all hypotheses."""
        total = logsumexp([h.log_weight for h in self.weighed])
        out: dict[str, float] = {}
        for h in self.weighed:
            share = float(np.exp(h.log_weight - total))
            places = [f"reversed in {k + 1}" for k in h.flips]
            places += ["timings common to all"] if isinstance(h.timed, str) else [f"timing of {k + 1}" for k in h.timed]
            for place in places:
                out[place] = out.get(place, 0.0) + share
        return out


def judge(weighed: Sequence[Hypothesis], p_value: float) -> Judgement:
    """The verdict: no gap at `FALSE_ALARM`; or the causes that reach `SURE`, with or without an unknown beside them."""
    total = logsumexp([h.log_weight for h in weighed])
    found: dict[Families, float] = {}
    for h in weighed:
        found[h.families] = found.get(h.families, 0.0) + float(np.exp(h.log_weight - total))
    sets = dict(sorted(found.items(), key=lambda item: -item[1]))
    includes = {name: sum(p for families, p in sets.items() if name in families) for name in FAMILIES}
    likeliest = next(iter(sets))
    best = max((h for h in weighed if h.families == likeliest), key=lambda h: h.log_weight)
    causes = tuple(name for name in FAMILIES if name != UNKNOWN and includes[name] >= SURE)
    group, reached = [], 0.0
    for families, p in sets.items():
        if reached >= SURE:
            break
        group.append(families)
        reached += p
    if p_value > FALSE_ALARM:
        verdict, causes, group = "none", (), []
    elif causes:
        verdict = "named"
    else:
        verdict = "unknown" if likeliest == frozenset({UNKNOWN}) and includes[UNKNOWN] >= SURE else "group"
    return Judgement(verdict, causes, tuple(group), sets, includes, best, p_value, tuple(weighed))


def diagnose(table: Table, baseline: Baseline) -> Judgement:
    """The verdict on a table under a baseline; without a gap no hypotheses are weighed."""
    p_value = gap_test(table, baseline)["p_value"]
    if p_value > FALSE_ALARM:
        nothing = Hypothesis(frozenset(), "baseline", 0.0)
        return Judgement("none", (), (), {frozenset(): 1.0}, dict.fromkeys(FAMILIES, 0.0), nothing, p_value)
    return judge(hypotheses(table, baseline), p_value)


# --- How far the gap shrinks --------------------------------------------------------------------------------------------------


def _predictive(case: Prepared, timed: tuple[int, ...] | str, extra: Array, left_out: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Mean and variance (m,) of the left-out numbers' d, timings integrated over and steered by the other numbers only."""
    covariance = case.covariance + np.diag(extra)
    out = np.flatnonzero(left_out)
    kept = np.flatnonzero(~left_out)
    gain = np.linalg.solve(covariance[np.ix_(kept, kept)], covariance[np.ix_(kept, out)])
    variance = np.diag(covariance[np.ix_(out, out)] - covariance[np.ix_(out, kept)] @ gain)
    if not timed:
        return case.d[out] - case.d[kept] @ gain, variance
    draws = draws_of(case, timed, ~left_out)
    d = residuals_of(case, draws)
    log_weight = _log_normal(d[:, kept], covariance[np.ix_(kept, kept)]) + draws.log_weight
    weight = np.exp(log_weight - logsumexp(log_weight))[:, None]
    errors = d[:, out] - d[:, kept] @ gain
    mean = np.sum(weight * errors, axis=0)
    return mean, variance + np.sum(weight * (errors - mean) ** 2, axis=0)


def _posterior(case: Prepared, h: Hypothesis) -> tuple[Array, dict[str, tuple[float, float]]]:
    """Mean d (18,) under a hypothesis, and mean and sigma of its timings."""
    if not h.timed:
        return case.d, {}
    draws = draws_of(case, h.timed)
    d = residuals_of(case, draws)
    log_weight = _log_normal(d, case.covariance + np.diag(h.extra)) + draws.log_weight
    weight = np.exp(log_weight - logsumexp(log_weight))
    sizes = {}
    for name, values in draws.timings.items():
        mean = float(weight @ values)
        sizes[name] = (mean, float(np.sqrt(weight @ (values - mean) ** 2)))
    return weight @ d, sizes


@dataclass(frozen=True)
class Closure:
    """Gap before and after the likeliest explanation.

    Attributes
    ----------
    rms_deg : flown minus predicted, "before", "after" and "floor", the residuals after calibration
    whitened : mean square of d over its sigma: "before", "after" (in sample), and held out, a number or an interval at a time
    after : (18,) flown minus predicted with the explanation, deg
    sigma : (18,) that print leaves, deg
    sizes : mean and sigma of the timings
    """

    rms_deg: dict[str, float]
    whitened: dict[str, float]
    after: Array
    sigma: Array
    sizes: dict[str, tuple[float, float]]


def closure(table: Table, baseline: Baseline, h: Hypothesis) -> Closure:
    """How far a hypothesis closes the gap."""
    before, case = prepare(table, baseline), prepare(table, baseline, h.flips)
    d, sizes = _posterior(case, h)
    c = table.after.ravel()
    numbers = [np.arange(18) == i for i in range(18)]
    intervals = [np.arange(18) // 3 == k for k in range(6)]
    # An unknown residual predicts nothing: it does not count as shrinking the gap.
    none = np.zeros(18)

    def held_out(folds: Sequence[NDArray[np.bool_]]) -> float:
        parts = [_predictive(case, h.timed, none, fold) for fold in folds]
        return float(np.mean(np.concatenate([mean**2 / variance for mean, variance in parts])))

    def rms(x: Array) -> float:
        return float(flight.rms(x))

    return Closure(
        rms_deg={"before": rms(before.d + c), "after": rms(d + c), "floor": rms(c)},
        whitened={
            "before": float(before.d @ np.linalg.solve(before.covariance, before.d)) / 18,
            "after": float(d @ np.linalg.solve(case.covariance, d)) / 18,
            "before, number held out": float(
                np.mean([m[0] ** 2 / v[0] for m, v in (_predictive(before, (), none, fold) for fold in numbers)])
            ),
            "after, number held out": held_out(numbers),
            "before, interval held out": float(
                np.mean(np.concatenate([m**2 / v for m, v in (_predictive(before, (), none, fold) for fold in intervals)]))
            ),
            "after, interval held out": held_out(intervals),
        },
        after=d + c,
        sigma=np.sqrt(np.diag(case.covariance)),
        sizes=sizes,
    )


def noise_factor(table: Table, baseline: Baseline, flips: tuple[int, ...] = ()) -> tuple[float, float]:
    """Noise over the baseline's: mean and sigma."""
    curve = prepare(table, baseline, flips).noise[0]
    weight = np.exp(curve - logsumexp(curve))
    mean = float(weight @ NOISE_FACTORS)
    return mean, float(np.sqrt(weight @ (NOISE_FACTORS - mean) ** 2))


# --- Simulated tables ---------------------------------------------------------------------------------------------------------

KINDS: dict[str, Families] = {
    "nothing": frozenset(),
    "yaw of 2": frozenset({YAW}),
    "yaw of 6": frozenset({YAW}),
    "both yaws": frozenset({YAW}),
    "rate sign": frozenset({RATE}),
    "one timing": frozenset({TIMING}),
    "four timings": frozenset({TIMING}),
    "common timing": frozenset({TIMING}),
    "noise x3": frozenset({NOISE}),
    "noise /3": frozenset({NOISE}),
    "unknown": frozenset({UNKNOWN}),
    "yaw of 2, four timings": frozenset({YAW, TIMING}),
}
UNKNOWN_SIMULATED_DEG = 0.05


def rounded(values: Array, digits: Array | float) -> Array:
    """Values as printed; digits of zero are exact."""
    digits = np.broadcast_to(digits, np.shape(values))
    return np.asarray(np.where(digits > 0, np.round(values / np.where(digits > 0, digits, 1.0)) * digits, values))


def simulated_motion(kind: str, scenario: Scenario, rng: np.random.Generator) -> tuple[IntervalSection, ...]:
    """The six intervals as flown in a kind of table."""
    sections = list(scenario.interval)
    own: Sequence[int] = TIMED if "four" in kind else ([int(rng.choice(TIMED))] if kind == "one timing" else ())
    for k in own:
        timings = TIMINGS[k].values(rng.random((1, len(TIMINGS[k].names))))[0]
        sections[k] = TIMINGS[k].section(timings, _sign(sections[k]))
    if kind == "common timing":
        good = False
        while not good:
            ok, points = common_points(rng.random((1, 4)))
            good = bool(ok[0])
        for k, u in points.items():
            sections[k] = TIMINGS[k].section(TIMINGS[k].values(u)[0], _sign(sections[k]))
    flips = {"yaw of 2": (1,), "yaw of 6": (5,), "both yaws": (1, 5), "rate sign": (3,), "yaw of 2, four timings": (1,)}
    for k in flips.get(kind, ()):
        sections[k] = reversed_slews(sections[k])
    return tuple(sections)


def simulated(kind: str, baseline: Baseline, rng: np.random.Generator) -> Table:
    """A table as the paper would print it: noise, least squares for the twelve parameters, and every number rounded."""
    sections = simulated_motion(kind, baseline.scenario, rng)
    factor = {"noise x3": 3.0, "noise /3": 1 / 3}.get(kind, 1.0)
    total, gyro = (factor**2 * v for v in baseline.variances())
    theta, Theta = (np.array(part) for part in zip(*(_outcome(section) for section in sections), strict=True))
    for k, section in enumerate(sections):
        theta[k] += clock_derivatives(section) @ rng.uniform(-0.5, 0.5, 2) * CLOCK_S  # Table 1 rounds the times
    H = Theta.reshape(18, 12)
    noise = rng.normal(size=(6, 3)) * np.sqrt(total)[:, None]
    scale = np.linalg.norm(H, axis=0)
    error = np.linalg.lstsq(H / scale, noise.ravel(), rcond=None)[0] / scale
    used = H @ (INITIAL_DIGITS * rng.uniform(-0.5, 0.5, 12))  # what was used has more digits than Table 3
    before = theta + noise + used.reshape(6, 3)
    if kind == "unknown":
        before[rng.integers(6)] += rng.normal(size=3) * UNKNOWN_SIMULATED_DEG
    steps = rng.normal(size=(2, 6, 3)) * np.sqrt(gyro[:, None] * np.array([1.0, 2.0])[:, None, None])
    coarser = before + np.cumsum(steps, axis=0)
    after = noise - (H @ error).reshape(6, 3)
    published = flight.calibration().vector - error
    return Table(
        rounded(before, CELL_DEG), rounded(after, CELL_DEG), rounded(coarser, CELL_DEG), rounded(published, PUBLISHED_DIGITS)
    )


class FlightConfig(StudyConfig):
    """The simulated tables.

    Attributes
    ----------
    nothing : tables made of the baseline itself
    each : tables of every other kind
    cases : all of them
    """

    nothing: int = 200
    each: int = 5
    cases: int = 200 + 5 * (len(KINDS) - 1)

    @model_validator(mode="after")
    def _cases_are_the_tables(self) -> Self:
        count = len(self.tables())
        if "cases" not in self.model_fields_set:
            self.__dict__["cases"] = count  # it is frozen for everybody else
        if self.cases != count:
            raise ValueError(f"there are {count} tables, so cases must be {count}, not {self.cases}")
        if self.scenario != "trmm" and not isinstance(self.scenario, Scenario):
            raise ValueError('the flight\'s table belongs to the scenario "trmm"')
        if self.dispersions or self.overrides:
            raise ValueError("the flight's table is diagnosed under the scenario as it is, without dispersions or overrides")
        return self

    def tables(self) -> list[str]:
        """Kind of each case."""
        return [kind for kind in KINDS for _ in range(self.each if KINDS[kind] else self.nothing)]


def present() -> Baseline:
    """The simulator as it is."""
    return Baseline("as assumed", scenarios.load("trmm"))


def case(config: FlightConfig, number: int, streams: Streams) -> dict[str, Any]:
    """Diagnose one simulated table."""
    kind = config.tables()[number]
    truth = KINDS[kind]
    found = diagnose(simulated(kind, present(), streams.generator("table")), present())
    likeliest = next(iter(found.sets))
    named = frozenset(found.causes)
    return {
        "kind": kind,
        "verdict": found.verdict,
        "causes": ", ".join(found.causes),
        "p_value": found.p_value,
        "right": found.verdict == {frozenset(): "none", frozenset({UNKNOWN}): "unknown"}[truth]
        if truth <= {UNKNOWN}
        else named == truth,
        "in_group": truth in found.group,
        "false_name": bool(named - truth),
        "likeliest": " + ".join(sorted(likeliest)) or "nothing",
        "truth_probability": found.sets.get(truth, 0.0),
    }


STUDY = Study("studies.flight_diagnosis:STUDY", FlightConfig, case)


# --- The flight under right and wrong baselines -------------------------------------------------------------------------------


def centred(scenario: Scenario) -> Scenario:
    """Slews in the middle of their intervals and nothing but ramps, as slow as the rate of the assumed ones peaks."""
    sections = list(scenario.interval)
    for k in (*YAW_INTERVALS, MINUS_Y):
        section, timed = sections[k], TIMINGS[k]
        u = np.full((1, len(timed.names)), 0.5)
        u[0, -1] = 1.0
        low, high = timed.durations()
        wanted = min(abs(section.slew[0].angle_deg) / 0.2, 0.95 * (section.stop_s - section.start_s))
        u[0, 1] = np.log(wanted / low) / np.log(high / low)
        timings = timed.values(u)[0]
        if k == MINUS_Y:
            stay = 3600.0
            timings[2], timings[0] = stay, 0.5 * (section.stop_s - section.start_s - timings[1] - stay)
        sections[k] = timed.section(timings, _sign(section))
    return scenario.model_copy(update={"interval": tuple(sections)})


@dataclass(frozen=True)
class Trial:
    """A baseline the flight is diagnosed under, and what was done to it on purpose."""

    baseline: Baseline
    done: Families
    flips: tuple[int, ...] = ()


def trials() -> list[Trial]:
    """The present baseline first, then the deliberately wrong ones."""
    right = present()

    def wrong(name: str, flips: tuple[int, ...]) -> Trial:
        sections = tuple(reversed_slews(s) if k in flips else s for k, s in enumerate(right.scenario.interval))
        return Trial(Baseline(name, right.scenario.model_copy(update={"interval": sections})), _flip_families(flips)[0], flips)

    return [
        Trial(right, frozenset()),
        wrong("yaw of 2 reversed", (1,)),
        wrong("yaw of 6 reversed", (5,)),
        wrong("both yaws reversed", (1, 5)),
        wrong("rate of 4 at +1 RPO", (3,)),
        Trial(Baseline("slews centred and smooth", centred(right.scenario)), frozenset({TIMING})),
        Trial(replace(right, name="noise three times", noise_factor=3.0), frozenset({NOISE})),
        Trial(replace(right, name="noise a third", noise_factor=1 / 3), frozenset({NOISE})),
    ]


@dataclass(frozen=True)
class Diagnosis:
    """A table's diagnosis under one baseline."""

    trial: Trial
    judgement: Judgement
    gap: dict[str, float]
    where: pd.DataFrame
    closure: Closure
    noise: tuple[float, float]
    prediction: Array

    def row(self) -> dict[str, Any]:
        """For the table of all baselines."""
        found, closed = self.judgement, self.closure
        members = [name for name, p in found.members().items() if p >= 0.5]
        return {
            "baseline": self.trial.baseline.name,
            "done": " + ".join(sorted(self.trial.done)) or "nothing",
            "verdict": found.verdict,
            "causes": " + ".join(found.causes) or "none",
            "named_what_was_done": "yes"
            if self.trial.done and self.trial.done <= set(found.causes)
            else "no"
            if self.trial.done
            else "",
            "which": ", ".join(members) or "none",
            "unknown_probability": found.includes[UNKNOWN],
            "before_deg": closed.rms_deg["before"],
            "after_deg": closed.rms_deg["after"],
            "floor_deg": closed.rms_deg["floor"],
            "noise_factor": self.noise[0],
        }

    def document(self) -> dict[str, Any]:
        """In the form of `gyrocal diagnose`."""
        found, closed = self.judgement, self.closure
        places = self.where[(self.where["p_holm"] < FALSE_ALARM)].sort_values("p_holm")
        before, after, floor = closed.rms_deg["before"], closed.rms_deg["after"], closed.rms_deg["floor"]
        return {
            "format": 1,
            "recording": f"N Table 2 under the baseline: {self.trial.baseline.name}",
            "verdict": found.verdict,
            "gap": {"present": found.p_value <= FALSE_ALARM, "false_alarm_rate": FALSE_ALARM, **self.gap},
            "where": [
                {
                    "signal": "attitude",
                    "interval": f"m{row['interval']}",
                    "axis": row["axis"],
                    "statistic": "chi2",
                    "value": float(row["chi2"]),
                    "p_value": float(row["p_holm"]),
                    "text": f"interval {row['interval']} {row['axis']}: {row['beyond_calibration_deg']:+.4f} "
                    f"± {row['sigma_deg']:.4f} deg",
                }
                for _, row in places.iterrows()
            ],
            "causes": [self._cause(name) for name in found.causes],
            "alternatives": [
                {"effects": sorted(families) or ["none"], "probability": p} for families, p in list(found.sets.items())[1:6]
            ],
            "group": [sorted(families) for families in found.group],
            "members": found.members(),
            "unknown_probability": found.includes[UNKNOWN],
            "unknown_deg": dict(zip(("size", "sigma"), found.unknown_deg(), strict=True)),
            "best": found.best.label,
            "closure": {
                "measure": "RMS of flown minus predicted, deg",
                "before": before,
                "after": after,
                "floor": floor,
                "closed": None if before <= floor else 1 - (after - floor) / (before - floor),
                "whitened_mean_square": closed.whitened,
            },
        }

    def _cause(self, name: str) -> dict[str, Any]:
        found = self.judgement
        out: dict[str, Any] = {"effect": name, "axis": None, "probability": found.includes[name], "group": [name]}
        if name == NOISE:
            return out | {"size": self.noise[0], "sigma": self.noise[1], "unit": "factor"}
        if name == TIMING:
            values = {key: {"mean": mean, "sigma": sigma} for key, (mean, sigma) in self.closure.sizes.items()}
            return out | {"size": None, "sigma": None, "unit": "s", "parameters": values}
        flips = [k + 1 for k in found.best.flips if (k == MINUS_Y) == (name == RATE)]
        size, unit = (2.0, "RPO") if name == RATE else (360.0, "deg")
        return out | {"size": size, "sigma": 0.0, "unit": unit, "parameters": {"intervals": flips}}


def examine(table: Table, trial: Trial) -> Diagnosis:
    """Diagnose a table under one baseline, with places and closure."""
    baseline = trial.baseline
    found = diagnose(table, baseline)
    return Diagnosis(
        trial,
        found,
        gap_test(table, baseline),
        where(table, baseline),
        closure(table, baseline, found.best),
        noise_factor(table, baseline, found.best.flips),
        prepare(table, baseline).prediction.reshape(6, 3),
    )


@cache
def flight_diagnoses() -> tuple[Diagnosis, ...]:
    """The flight's table under every baseline of `trials`."""
    return tuple(examine(flown(), trial) for trial in trials())


def documents() -> dict[str, Any]:
    """Result of each baseline, by its name."""
    return {found.trial.baseline.name: found.document() for found in flight_diagnoses()}


def power(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per kind of simulated table: detected, rightly named, wrongly named."""
    out = []
    for kind, part in rows.groupby("kind", sort=False):
        seen = part["verdict"] != "none"
        out.append(
            {
                "kind": kind,
                "tables": len(part),
                "gap_found": int(seen.sum()),
                "right": int(part["right"].sum()),
                "in_group": int((part["in_group"] & ~part["right"]).sum()),
                "false_name": int(part["false_name"].sum()),
            }
        )
    return pd.DataFrame(out)


def evidence_table(found: Diagnosis) -> pd.DataFrame:
    """Sets of families by probability."""
    sets = found.judgement.sets
    return pd.DataFrame(
        {
            "hypothesis": [" + ".join(sorted(families)) or "nothing" for families in sets],
            "log10_probability": [np.log10(max(p, 1e-300)) for p in sets.values()],
        }
    )


def _findings(rows: pd.DataFrame, found: Sequence[Diagnosis]) -> list[str]:
    own, wrong = found[0], found[1:]
    closed = own.closure
    places = own.where[own.where["p_holm"] < FALSE_ALARM]
    table = power(rows).set_index("kind")
    columns = by_step()
    sides: dict[Any, set[float]] = {}
    for _, row in columns.iterrows():
        sides.setdefault((row["interval"], row["axis"]), set()).add(float(np.sign(row["gap_deg"])))
    steady = [sides[at] == {1.0} or sides[at] == {-1.0} for at in zip(places["interval"], places["axis"], strict=True)]
    others = columns[columns["step_s"] > flight.STEPS[0]]
    outlier = others.iloc[int((others["gap_deg"] / others["sigma_deg"]).abs().to_numpy().argmax())]
    out = [
        f"Under the present baseline the gap is {closed.rms_deg['before']:.4f} deg RMS, {closed.rms_deg['after']:.4f} with the "
        f"likeliest explanation ({own.judgement.best.label}), floor {closed.rms_deg['floor']:.4f}; verdict: "
        f"{own.judgement.verdict}, causes: {' + '.join(own.judgement.causes) or 'none'}, probability that something unknown "
        f"remains {own.judgement.includes[UNKNOWN]:.2f} (about {own.judgement.unknown_deg()[0]:.4f} deg a number).",
        f"The gap stands out in {len(places)} of 18 numbers (intervals "
        f"{', '.join(map(str, sorted(set(places['interval']))))}), χ² {own.gap['motion_chi2']:.0f} of 18; noise: χ² "
        f"{own.gap['noise_chi2']:.1f} of 42, {own.noise[0]:.2f} ± {own.noise[1]:.2f} of the stated one.",
        f"Of {len(wrong)} deliberately wrong baselines {sum(d.trial.done <= set(d.judgement.causes) for d in wrong)} were "
        "named for what was done to them.",
        f"The same comparison at 1 and 2 s: the gap keeps its sign at both in {sum(steady)} of the {len(steady)} numbers "
        f"that stand out at 0.5 s: rounded residuals are not its cause. Farthest off is {outlier['step_s']:g} s, interval "
        f"{outlier['interval']:g}, {outlier['axis']}: {outlier['gap_deg']:+.4f} ± {outlier['sigma_deg']:.4f} deg as printed, "
        f"{outlier['gap_deg'] + 2 * outlier['after_deg']:+.4f} with the other sign of its residual after calibration.",
    ]
    if "nothing" in table.index:
        alarms, count = (int(power(rows).set_index("kind")[name].to_dict()["nothing"]) for name in ("gap_found", "tables"))
        low, high = binomial_interval(alarms, count)
        out.append(
            f"Tables simulated from the baseline: a gap in {alarms} of {count} "
            f"({100 * low:.1f} to {100 * high:.1f} %; stated {100 * FALSE_ALARM:g} %)."
        )
    effects = table.drop(index="nothing", errors="ignore")
    if len(effects):
        out.append(
            f"Tables with an effect: {effects['gap_found'].sum()} of {effects['tables'].sum()} found, {effects['right'].sum()} "
            f"rightly named, {effects['in_group'].sum()} more in a group, {effects['false_name'].sum()} with a wrong name."
        )
    return out


def make_report(config: FlightConfig, rows: pd.DataFrame) -> Report:
    """The flight's table under every baseline, and what simulated tables say of the diagnosis."""
    found = flight_diagnoses()
    sizes = [
        {"baseline": d.trial.baseline.name, "timing": name, "mean": mean, "sigma": sigma}
        for d in found
        for name, (mean, sigma) in d.closure.sizes.items()
    ]
    whitened = [{"baseline": d.trial.baseline.name, **d.closure.whitened} for d in found]
    tables = {
        "The flight's table under each baseline": pd.DataFrame([d.row() for d in found]),
        "Where, under the present baseline": found[0].where,
        "The gap at each step": by_step(),
        "Mean square of the whitened gap": pd.DataFrame(whitened),
        "Timings under the likeliest hypothesis": pd.DataFrame(sizes, columns=["baseline", "timing", "mean", "sigma"]),
        "Hypotheses under the present baseline": evidence_table(found[0]),
        "Simulated tables": power(rows),
    }
    figures = {
        "flight_table": partial(gap_figure, found[0]),
        "flight_table_wrong_yaw": partial(gap_figure, found[1]),
        "flight_evidence": partial(evidence_figure, found),
    }
    return Report(tuple(_findings(rows, found)), tables, figures)


ENTRY = Entry(STUDY, "N Table 2 diagnosed: what parts predicted from flown pre-launch residuals", make_report)


def run(folder: Path, config: FlightConfig | None = None, jobs: int = 1, console: Console | None = None) -> dict[str, Any]:
    """Run the study, write its report, and the diagnoses as ``diagnosis.json``.

    Parameters
    ----------
    folder : where everything is written
    config : the simulated tables
    jobs : worker processes; the results do not depend on it
    console : for the findings; None prints nothing

    Returns
    -------
    The result of every baseline, by its name.
    """
    chosen = config or FlightConfig()
    outcome = engine.run(STUDY, chosen, folder, backend="loky" if jobs > 1 else "serial", jobs=jobs)
    rows = outcome.load()
    made = make_report(chosen, rows[rows["error"] == ""].reset_index(drop=True))
    report.write(made, ENTRY.summary, folder)
    results = documents()
    write_json(folder / "diagnosis.json", results)
    for finding in made.findings:
        (console or Console(quiet=True)).print(f"- {finding}", highlight=False, markup=False)
    return results


def gap_figure(found: Diagnosis, path: Path) -> Path:
    """Flown and predicted residuals above; below flown minus predicted before and after, and the flight's after calibration."""
    flown_deg, closed = flight.residuals("prelaunch"), found.closure
    after = closed.after.reshape(6, 3)
    sigma = closed.sigma.reshape(6, 3)
    x = np.arange(1, 7)
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(9.0, 5.0), layout="constrained")
        panels = drawing.subplots(2, 3, sharey="row", sharex=True)
        for j, name in enumerate(flight.ROTATIONS):
            top, low = panels[0, j], panels[1, j]
            top.plot(x, found.prediction[:, j], "_", color="#00798c", markersize=13, markeredgewidth=2, label="predicted")
            top.plot(x, (flown_deg - after)[:, j], "x", color="#30343f", markersize=5, label="with the explanation")
            top.plot(x, flown_deg[:, j], "o", color="#d1495b", markersize=4, label="flown")
            low.axhline(0, color="0.4", linewidth=0.8)
            low.bar(x, flight.residuals("calibrated")[:, j], width=0.7, color="0.85", label="flown, after calibration")
            style: dict[str, Any] = {"capsize": 2, "markersize": 4, "linewidth": 1}
            before = (flown_deg - found.prediction)[:, j]
            low.errorbar(x - 0.15, before, sigma[:, j], fmt="s", color="#00798c", label="gap before", **style)
            low.errorbar(x + 0.15, after[:, j], sigma[:, j], fmt="o", color="#30343f", label="gap after", **style)
            top.set_title(name, loc="left")
            low.set_xticks(x)
            low.set_xlabel("calibration interval")
        panels[0, 0].set_ylabel("residual (deg)")
        panels[1, 0].set_ylabel("flown − predicted (deg)")
        panels[0, 2].legend(fontsize=7)
        panels[1, 2].legend(fontsize=7)
        drawing.suptitle(
            f"Baseline: {found.trial.baseline.name}; explanation: {found.judgement.best.label}; bars: 1σ of print", fontsize=9
        )
        return save(drawing, path)


def evidence_figure(found: Sequence[Diagnosis], path: Path, most: int = 6, lowest: float = -12.0) -> Path:
    """Probability of the likeliest sets of families under each baseline."""
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(10.0, 2.1 * ((len(found) + 1) // 2)), layout="constrained")
        panels = drawing.subplots((len(found) + 1) // 2, 2, sharex=True, squeeze=False)
        for axes, diagnosis in zip(panels.ravel(), found, strict=False):
            table = evidence_table(diagnosis).head(most).iloc[::-1]
            length = np.maximum(table["log10_probability"].to_numpy(), lowest) - lowest
            done = " + ".join(sorted(diagnosis.trial.done))
            named = [bool(done) and set(diagnosis.trial.done) <= set(name.split(" + ")) for name in table["hypothesis"]]
            axes.barh(table["hypothesis"], length, left=lowest, color=["#d1495b" if hit else "#00798c" for hit in named])
            axes.set_title(f"baseline: {diagnosis.trial.baseline.name}", loc="left", fontsize=9)
            axes.axvline(np.log10(1 - SURE), color="0.4", linewidth=0.8, linestyle="--")
            axes.set_xlim(lowest, 0)
        for axes in panels[-1]:
            axes.set_xlabel("log$_{10}$ probability (red: has what was done)")
        return save(drawing, path)
