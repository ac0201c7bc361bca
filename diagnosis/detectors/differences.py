"""Differences of white noise: their variance, their correlation, and whether two orders of them show a motion.

Differences of order d of white noise of variance σ² have the variance C(2d, d) σ². The mean square of n of them has the
relative variance 2 Σρ²/n, with Σρ² the sum of their squared autocorrelations. A motion that is slow beside the sampling leaves
the less in them the higher the order. Mean squares of two orders of the same samples, scaled to the noise of one sample, differ
under white noise by the relative variance (2/n) (Σρ_aa² + Σρ_bb² − 2 Σρ_ab²).
"""

from __future__ import annotations

from functools import cache
from math import comb

import numpy as np
from numpy.typing import ArrayLike, NDArray

Mask = NDArray[np.bool_]

AGREE = 3.0  # sigmas of the difference up to which two orders show the same noise


def power_of(order: int) -> int:
    """Compute the variance of a difference of unit white noise."""
    return comb(2 * order, order)


def autocorrelation_of(order: int) -> float:
    """Compute the sum of the squared autocorrelations of differences of white noise."""
    return comb(4 * order, 2 * order) / power_of(order) ** 2


@cache
def disagreement_of(low: int, high: int) -> float:
    """Compute the sum of squared correlations that stands for the difference of the mean squares of two orders."""
    a, b = ([comb(order, k) * (-1.0) ** k / np.sqrt(power_of(order)) for k in range(order + 1)] for order in (low, high))
    both = float(np.sum(np.correlate(a, b, "full") ** 2))
    return autocorrelation_of(low) + autocorrelation_of(high) - 2 * both


def agree(low: ArrayLike, high: ArrayLike, orders: tuple[int, int], count: ArrayLike) -> Mask:
    """Test whether mean squares of two orders of differences of the same samples show one level, the lower no motion."""
    level = np.asarray(high, dtype=float)
    error = np.sqrt(2 * disagreement_of(*orders) / np.maximum(count, 1))
    return np.asarray(np.abs(np.subtract(low, level)) < AGREE * level * error)
