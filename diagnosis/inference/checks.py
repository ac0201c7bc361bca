"""Posterior predictive checks of a named explanation: would data of the named model look like this?

Under an explanation with the scaled columns C = [s_e X_e …] the observations are y ~ N(0, I + C Cᵀ), so that the innovations
e = L⁻¹ y, L the Cholesky factor, are independent with variance one, in the order of time within each interval. General
statistics ask whether they are: their size, their correlation in time, lines of any period, patterns that repeat with the time
since an interval's start or with the orbit, dependence on rate, acceleration, mission time and housekeeping, dependence on the
attitude (any element of its matrix, as the angle that a table has turned or the direction to something), constancy of their
variance over the intervals and with the rate, and their shape.

A random process has to look like a draw of itself as well. Its contribution C Cᵀ S⁻¹ y, S = I + C Cᵀ, as the data estimate it,
is asked the same: one bump, a swing or a pattern that a process has swallowed leaves nothing in the innovations, and is a draw
that hardly ever comes. Its changes from one observation to the next are asked for their shape, since what jumps now and then
changes as no normal process does; and it may not be too flat either, as a wave is, or what has two values.

The distribution of each statistic comes from draws of the named model itself, with the nuisance parameters projected out of
them as they are out of the data (Gelman et al., Bayesian Data Analysis, section 6.3). P-values beyond what the draws resolve
come from a distribution that is fitted to the draws: of a statistic that is a sum, a power or its logarithm is taken which
leaves the draws without skewness, and that is nearly normal (Box & Cox 1964; the cube root for a sum of squares, the logarithm
for fourth powers), or which Pearson's type III describes where even the logarithm is skewed to the right; the strongest of many
lines has a Gumbel distribution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.special
import scipy.stats
from numpy.typing import NDArray

from diagnosis.model.linear import LinearModel, Member

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

DRAWS = 1000
POWERS = (0.0, 1.0)  # that are tried; a negative one would bound how far a statistic can be from its draws
SKEWED = 0.25  # skewness that less than one set of normal draws in a thousand has by chance
LAGS = 6
PERIODS = 48  # of the scan for a line
FOLD = 12  # bins of a pattern that repeats
FEWEST = 12  # observations, below which nothing can be checked
TINY = 1e-300
VARIES = 1e-3  # of the largest scatter of an element of the attitude, from which on it changes at all
SIZE, FLAT, JUMPS = "size", "two values or a wave", "jumps"  # less size than expected is as odd as more
SETTLED = (SIZE, "correlation in time")  # by the evidence of a process
LINE, ATTITUDE = "line of any period", "dependence on the attitude"  # statistics that are a largest value


@dataclass(frozen=True)
class Layout:
    """What each observation of a linear model stands for.

    Attributes
    ----------
    axes : (r, 3, 3) rotation of each observation's three rows to body axes
    t_s : (r,) time, s
    since_s : (r,) time since the interval's start, s
    interval : (r,) its number
    period_s : of a cycle that patterns may repeat with, such as the orbit; NaN for none
    regressors : (r, q) what the innovations may depend on, such as rates, accelerations and temperatures
    activity : (r,) what their variance may depend on, the size of the rate
    """

    axes: Array
    t_s: Array
    since_s: Array
    interval: Indices
    period_s: float
    regressors: Array
    activity: Array


@dataclass(frozen=True)
class Check:
    """One statistic of the innovations.

    Attributes
    ----------
    name : what it looks for
    value, expected : the statistic, and its mean under the named model
    p_value : that the named model gives as much
    """

    name: str
    value: float
    expected: float
    p_value: float


def residual_checks(model: LinearModel, members: Sequence[Member], layout: Layout, seed: int = 0) -> tuple[Check, ...]:
    """All checks of an explanation; none where there is too little to check.

    Parameters
    ----------
    model : the data and the candidates
    members : the explanation
    layout : of the observations
    seed : of the draws
    """
    if layout.t_s.size < FEWEST or model.dof < FEWEST:
        return ()
    places, scales, shifts = model.design(members)
    C, shift = scales * model.X[:, places], model.X[:, shifts].sum(axis=1)
    L = np.asarray(np.linalg.cholesky(np.eye(model.y.size) + C @ C.T), dtype=float)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(b"residual_checks")))
    noise = rng.standard_normal((model.y.size, DRAWS))
    drawn = model.projected(noise) + C @ rng.standard_normal((C.shape[1], DRAWS))
    white = scipy.linalg.solve_triangular(L, np.column_stack([model.y - shift, drawn]), lower=True, check_finite=False)
    found = [_check(name, values) for name, values in _statistics(_in_body(white, layout), layout).items()]
    for member in members:
        if model.candidate(member).process:
            label = model.candidate(member).label
            own = _of_process(_estimated(model, member, L, white), layout)
            found += [_check(name, values, f"{name}, of {label} itself") for name, values in own.items()]
    return tuple(found)


def _of_process(z: Array, layout: Layout) -> dict[str, Array]:
    """(d,) each statistic of the estimates (N, d) of a process, but those that its evidence has settled."""
    e = _in_body(z, layout)
    out = {name: values for name, values in _statistics(e, layout).items() if name not in SETTLED}
    out[FLAT] = _geary(e)
    out[JUMPS] = 1 / _geary(np.diff(e, axis=0)[np.diff(layout.interval) == 0])
    return out


def _geary(e: Array) -> Array:
    """(d,) mean size of e (r, 3, d), over its RMS: near one if it is flat, small if it is peaked (Geary 1935)."""
    size = np.linalg.norm(e, axis=1)
    return np.asarray(np.mean(size, axis=0) / np.maximum(np.sqrt(np.mean(size**2, axis=0)), TINY))


def _estimated(model: LinearModel, member: Member, L: Array, white: Array) -> Array:
    """(N, d) what a random process contributes to the observations, as estimated: over its scatter in the draws, of RMS one.

    Its size is what the data have left of the prior, and says nothing.
    """
    places, scales, _ = model.design((member,))
    C = scales * model.X[:, places]
    mean = C @ (C.T @ scipy.linalg.solve_triangular(L, white, lower=True, trans="T", check_finite=False))
    z = mean / np.maximum(np.std(mean[:, 1:], axis=1, keepdims=True), TINY)
    return np.asarray(z / np.maximum(np.sqrt(np.mean(z**2, axis=0)), TINY))


def together(checks: Sequence[Check]) -> float:
    """P-value of all checks together, with an allowance for their number; one without checks."""
    return min([1.0, *(check.p_value * len(checks) for check in checks)])


def _in_body(e: Array, layout: Layout) -> Array:
    """(r, 3, d) innovations along the body axes."""
    return np.matmul(layout.axes, e.reshape(layout.t_s.size, 3, -1))


def _check(name: str, values: Array, says: str | None = None) -> Check:
    """The first value beside those of the draws."""
    value, draws = float(values[0]), values[1:]
    return Check(says or name, value, float(np.mean(draws)), float(_p_value(name, np.array([value]), draws)[0]))


def _p_value(name: str, values: Array, draws: Array) -> Array:
    """P-values of some values (c,) of a statistic, by the distribution of its draws (d,)."""
    if np.ptp(draws) == 0:
        return np.ones_like(values)
    if name in (LINE, ATTITUDE):
        scale = float(np.std(draws)) * np.sqrt(6) / np.pi
        p = scipy.stats.gumbel_r.sf(values, float(np.mean(draws)) - np.euler_gamma * scale, scale)
    else:
        middle = float(np.median(draws))
        power = _without_skewness(draws / middle)
        moved = scipy.special.boxcox(draws / middle, power)
        z = (scipy.special.boxcox(np.maximum(values / middle, TINY), power) - np.mean(moved)) / np.std(moved)
        p = _normal_or_skewed(z, float(scipy.stats.skew(moved)))
        if name == SIZE:
            p = np.minimum(1.0, 2 * np.minimum(p, 1 - p))
    return np.asarray(np.maximum(p, TINY))


def _normal_or_skewed(z: Array, skewness: float) -> Array:
    """Chance of more than z, of a normal distribution, or of Pearson's type III with a skewness to the right that is left."""
    if skewness < SKEWED:
        return np.asarray(scipy.stats.norm.sf(z))
    return np.asarray(scipy.stats.pearson3.sf(z, skewness))


def _without_skewness(draws: Array) -> float:
    """The power, within `POWERS`, to which draws have no skewness; zero is the logarithm."""

    def skewness(power: float) -> float:
        return float(scipy.stats.skew(scipy.special.boxcox(draws, power)))

    low, high = POWERS
    if skewness(low) > 0:
        return low
    return high if skewness(high) < 0 else float(scipy.optimize.brentq(skewness, low, high, xtol=1e-3))


def _statistics(e: Array, layout: Layout) -> dict[str, Array]:
    """(d,) each statistic of e (r, 3, d)."""
    out = {
        SIZE: np.sum(e**2, axis=(0, 1)),
        "shape": np.sum(e**4, axis=(0, 1)),
        "correlation in time": _autocorrelation(e, layout.interval),
        "pattern since the interval's start": _folded(e, _bins(layout.since_s, float(layout.since_s.max()))),
        "variance over the intervals": _spread_over(e, layout.interval),
        "variance with the rate": _along(np.sum(e**2, axis=1, keepdims=True) - 3, layout.activity[:, None]),
        "dependence on what is known": _along(e, layout.regressors),
        ATTITUDE: _largest_along(e, layout.axes.reshape(layout.t_s.size, 9)),
    }
    lines = _lines(e, layout)
    if lines is not None:
        out[LINE] = lines
    if np.isfinite(layout.period_s):
        out["pattern with the orbit"] = _folded(e, _bins(layout.t_s % layout.period_s, layout.period_s))
    return out


def _autocorrelation(e: Array, interval: Indices) -> Array:
    total = np.zeros(e.shape[2])
    for lag in range(1, LAGS + 1):
        if lag >= len(e):
            break
        alike = interval[lag:] == interval[:-lag]
        products = np.sum(e[lag:][alike] * e[:-lag][alike], axis=0)  # (3, d)
        total += np.sum(products**2, axis=0) / max(int(alike.sum()), 1)
    return total


def _bins(values: Array, span: float) -> Indices:
    return np.minimum((values / max(span, 1e-9) * FOLD).astype(np.intp), FOLD - 1)


def _folded(e: Array, bins: Indices) -> Array:
    """Square sum of the means in bins, in units of their variance."""
    total = np.zeros(e.shape[2])
    for number in np.unique(bins):
        own = e[bins == number]
        total += np.sum(own.sum(axis=0) ** 2, axis=0) / len(own)
    return total


def _spread_over(e: Array, interval: Indices) -> Array:
    total = np.zeros(e.shape[2])
    for number in np.unique(interval):
        own = np.sum(e[interval == number] ** 2 - 1, axis=0)  # (3, d)
        total += np.sum(own**2, axis=0) / (2 * np.sum(interval == number))
    return total


def _along(values: Array, regressors: Array) -> Array:
    """Square sum of the components of values (r, 3, d) along the regressors (r, q)."""
    centred = regressors - regressors.mean(axis=0)
    size = np.linalg.norm(centred, axis=0)
    if not np.any(size > 0):
        return np.ones(values.shape[2])
    unit = scipy.linalg.orth(centred[:, size > 0] / size[size > 0])
    return np.asarray(np.sum(np.einsum("rq,rad->qad", unit, values) ** 2, axis=(0, 1)))


def _largest_along(values: Array, regressors: Array) -> Array:
    """Largest square of the component of values (r, 3, d), about any axis, along any one of the regressors (r, q)."""
    centred = regressors - regressors.mean(axis=0)
    size = np.linalg.norm(centred, axis=0)
    varies = size > VARIES * max(float(size.max()), TINY)
    if not np.any(varies):
        return np.ones(values.shape[2])
    along = np.einsum("rq,rad->qad", centred[:, varies] / size[varies], values)
    return np.asarray(np.max(along**2, axis=(0, 1)))


def _lines(e: Array, layout: Layout) -> Array | None:
    """Strongest line of any period, its phase another in each interval; None if the arcs are too short.

    The power at one frequency has a gamma distribution under the named model, with a shape of one for each interval. The
    strongest is told by the natural logarithm of the chance of so much power at that frequency, with the sign turned.
    """
    longest = float(layout.since_s.max())
    gaps = np.diff(layout.t_s)[(np.diff(layout.interval) == 0) & (np.diff(layout.t_s) > 0)]
    if not gaps.size or longest < 8 * float(np.median(gaps)):
        return None
    # Nearer to half the rate of the observations a wave has no phase of its own, and its power another distribution.
    frequencies = np.linspace(1 / longest, 0.5 / float(np.median(gaps)) - 1 / longest, PERIODS)
    power = np.zeros((PERIODS, 3, e.shape[2]))
    count = 0
    for number in np.unique(layout.interval):
        own = layout.interval == number
        if own.sum() < 4:
            continue
        angle = 2 * np.pi * np.outer(frequencies, layout.since_s[own])
        waves = np.exp(-1j * angle)
        power += np.abs(np.einsum("fr,rad->fad", waves, e[own])) ** 2 / own.sum()
        count += 1
    return np.asarray(-scipy.stats.gamma.logsf(power.max(axis=(0, 1)), count)) if count else None
