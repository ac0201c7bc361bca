"""Posterior predictive checks of a named explanation: would data of the named model look like this?

Under an explanation with the scaled columns C = [s_e X_e …] the observations are y ~ N(0, I + C Cᵀ), so that the innovations
e = L⁻¹ y, L the Cholesky factor, are independent with variance one, in the order of time within each interval. The statistics
test their size, their correlation in time, lines of any period, dependence on rate, acceleration, mission time and
housekeeping, constancy of their variance over the intervals and with the rate, and their shape.

A random process has to look like a draw of itself as well. Its contribution C Cᵀ S⁻¹ y, S = I + C Cᵀ, as the data estimate it,
has the same tests. A process can absorb a bump or a sine completely although it would hardly ever generate one. Its changes
from one observation to the next are tested for their shape, since a value that jumps now and then changes as no normal process.

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

from diagnosis.inference.check_statistics import LARGEST, SIZE, Layout, of_innovations, of_process
from diagnosis.model.linear import LinearModel, Member

Array = NDArray[np.float64]

DRAWS = 1000
POWERS = (0.0, 1.0)  # that are tried; a negative one would bound how far a statistic can be from its draws
SKEWED = 0.25  # skewness that less than one set of normal draws in a thousand has by chance
FEWEST = 12  # observations, below which nothing can be checked
TINY = 1e-300


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
    found = [_check(name, values) for name, values in of_innovations(_in_body(white, layout), layout).items()]
    for member in members:
        if model.candidate(member).process:
            label = model.candidate(member).label
            own = of_process(_in_body(_estimated(model, member, L, white), layout), layout)
            found += [_check(name, values, f"{name}, of {label} itself") for name, values in own.items()]
    return tuple(found)


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
    if name in LARGEST:
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
