"""Smoothed rates: the gyro's noise taken out, slews left in.

A local quadratic is fitted to the mean rates in a window around each sample (Savitzky and Golay, Analytical Chemistry 36 (1964)
1627). A long window takes out more noise and bends a slew's ramps; each sample of each axis therefore gets the longest of a
ladder of windows, up to the whole run, whose estimate still agrees, within the noise of both, with those of all shorter ones
(Lepski's rule: Goldenshluger and Nemirovski, Mathematical Methods of Statistics 6 (1997) 135). Windows of many samples are
fitted to means over short blocks of them. Single outliers, further off the median of five than ten sigma, are replaced by that
median first.

An axis at rest needs the long windows: a function such as ω|ω| of a rate that is nothing but noise goes with the noise of the
attitude that is propagated with it, and would be taken for an effect.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.linalg import lstsq
from scipy.ndimage import convolve1d, median_filter

from simulator.effects.base import Array

ORDER = 2  # of the local polynomial in the rate
AGREEMENT = 4.0  # sigma; tens of thousands of samples
OUTLIER = 10.0  # sigma
BLOCKS = 33  # of a long window; a quadratic bends little over a thirtieth of it
SHORTEST = 5  # samples; a quadratic through three is no smoothing


def noise_level(rates: Array, stated: float) -> Array:
    """Sigma of one sample of each axis, rad/s: the stated one, or that of the second differences if it is larger; (3,).

    Second differences of a smooth rate are noise with the standard deviation √6 σ; the median is not moved by slews.
    """
    if len(rates) < SHORTEST:
        return np.full(rates.shape[1], stated)
    second = np.abs(np.diff(rates, n=2, axis=0))
    return np.asarray(np.maximum(stated, np.median(second, axis=0) * 1.4826 / np.sqrt(6)))


def smoothed(rates: Array, sample_s: float, smooth_s: float, sigma: Array) -> Array:
    """Smoothed rates of one run of samples.

    Parameters
    ----------
    rates : (n, 3) rad/s, evenly sampled
    sample_s : spacing, s
    smooth_s : longest window, s; infinite for the whole run, zero for no smoothing
    sigma : (3,) noise of one sample of each axis, rad/s

    Returns
    -------
    (n, 3)
    """
    return np.column_stack([smoothed_axis(rates[:, axis], sample_s, smooth_s, level)[0] for axis, level in enumerate(sigma)])


def smoothed_axis(rates: Array, sample_s: float, smooth_s: float, sigma: float) -> tuple[Array, float]:
    """Smoothed rates of one axis, (n,), and the degrees of freedom that they have: σ² of the noise is in them so many times.

    These are the sum over the samples of what each contributes to its own estimate, n without smoothing.
    """
    longest = int(min(smooth_s / sample_s, len(rates) - 1 + len(rates) % 2))
    if longest < SHORTEST or not sigma > 0:
        return rates, float(rates.size)
    return _axis(without_outliers(rates, sigma), _ladder(longest), sigma)


def without_outliers(rates: Array, sigma: float) -> Array:
    """Rates of one axis (n,) with single outliers replaced by the median of five."""
    median = median_filter(rates, size=5, mode="nearest")
    return np.where(np.abs(rates - median) > OUTLIER * sigma, median, rates)


def _axis(rates: Array, windows: Sequence[int], sigma: float) -> tuple[Array, float]:
    """One axis, by the longest window at each sample that agrees with the shorter ones; (n,), and its degrees of freedom."""
    best, low, high = rates, rates - AGREEMENT * sigma, rates + AGREEMENT * sigma
    own = np.ones(len(rates))
    going = np.ones(len(rates), dtype=bool)
    for window in windows:
        estimate, weight = _fitted(rates, window)
        going &= (estimate >= low) & (estimate <= high)
        if not going.any():
            break
        width = AGREEMENT * sigma * weight
        low, high = np.maximum(low, estimate - width), np.minimum(high, estimate + width)
        best = np.where(going, estimate, best)
        # A least-squares fit has its own share in the middle of its window as the square of its sigma there.
        own[going] = weight**2
    return np.asarray(best), float(own.sum())


def _fitted(rates: Array, window: int) -> tuple[Array, float]:
    """Local quadratic of a window at each sample (n,), and its sigma per unit sigma of a sample."""
    block = max(1, window // BLOCKS)
    if block == 1:
        return _filtered(rates, window), _weight(window)
    count = len(rates) // block
    means = rates[: count * block].reshape(count, block).mean(axis=1)
    width = min(window // block // 2 * 2 + 1, count - 1 + count % 2)
    estimate = _between(_filtered(means, width), block, len(rates))
    return estimate, _weight(width) / float(np.sqrt(block))


def _filtered(rates: Array, window: int) -> Array:
    """Local quadratic of an odd window at each sample (n,); at either end, that of the first or the last whole window.

    It is scipy's ``savgol_filter`` to the bit. That one solves for a window's coefficients anew each time, and comes with all
    of scipy.signal and scipy.stats, which take each process half a second to load.
    """
    out = convolve1d(rates, _coefficients(window), mode="constant")
    powers, scale = _powers(window)
    half = window // 2
    for part, own in ((slice(0, window), slice(0, half)), (slice(rates.size - window, None), slice(window - half, window))):
        c = lstsq(powers, rates[part], cond=window * np.finfo(float).eps)[0] / scale
        at = np.arange(own.start, own.stop, dtype=float)
        out[part][own] = ((0.0 * at + c[0]) * at + c[1]) * at + c[2]
    return np.asarray(out)


@lru_cache(maxsize=256)
def _coefficients(window: int) -> Array:
    """(window,) of a local quadratic; all intervals and axes share a few windows."""
    at = np.arange(window // 2, -(window // 2) - 1, -1, dtype=float)
    powers = at ** np.arange(ORDER + 1, dtype=float)[:, None]
    return np.asarray(lstsq(powers, np.eye(ORDER + 1)[0], cond=window * np.finfo(float).eps)[0])


@lru_cache(maxsize=256)
def _powers(window: int) -> tuple[Array, Array]:
    """(window, 3) powers of the samples' numbers, highest first, each of length one, and their lengths before (3,)."""
    powers = np.arange(window, dtype=float)[:, None] ** np.arange(ORDER, -1, -1, dtype=float)
    scale = np.sqrt(np.sum(powers * powers, axis=0))
    return powers / scale, scale


def _between(values: Array, block: int, count: int) -> Array:
    """Values in the middles of blocks, straight lines between them and beyond the first and the last, at each sample (n,)."""
    at = (np.arange(count) - 0.5 * (block - 1)) / block
    out = np.interp(at, np.arange(values.size), values)
    low, high = at < 0, at > values.size - 1
    out[low] = values[0] + at[low] * (values[1] - values[0])
    out[high] = values[-1] + (at[high] - (values.size - 1)) * (values[-1] - values[-2])
    return np.asarray(out)


def _weight(window: int) -> float:
    """Sigma of a local quadratic per unit sigma of a sample."""
    return float(np.linalg.norm(_coefficients(window)))


def _ladder(longest: int) -> list[int]:
    """Odd windows from the shortest to the longest, each about 1.5 times the one before."""
    windows, window = [], float(SHORTEST)
    while window < longest:
        windows.append(int(window) // 2 * 2 + 1)
        window *= 1.5
    return [*[w for w in windows if w < longest], longest - 1 + longest % 2]
