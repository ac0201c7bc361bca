"""Smoothed rates: the gyro's noise taken out, slews left in.

A local quadratic is fitted to the mean rates in a window around each sample (Savitzky and Golay, Analytical Chemistry 36 (1964)
1627). A long window takes out more noise and bends a slew's ramps; each sample therefore
gets the longest of a ladder of windows whose estimate still agrees, within the noise of both, with those of all shorter
ones (Lepski's rule: Goldenshluger and Nemirovski, Mathematical Methods of Statistics 6 (1997) 135). Single outliers, further
off the median of five than ten sigma, are replaced by that median first.
"""

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import savgol_coeffs, savgol_filter

from simulator.effects.base import Array

ORDER = 2  # of the local polynomial in the rate
AGREEMENT = 4.0  # sigma; three axes and tens of thousands of samples
OUTLIER = 10.0  # sigma
SHORTEST = 5  # samples; a quadratic through three is no smoothing


def noise_level(rates: Array, stated: float) -> float:
    """Sigma of one sample, rad/s: the stated one, or that of the second differences if it is larger.

    Second differences of a smooth rate are noise with the standard deviation √6 σ; the median is not moved by slews.
    """
    if len(rates) < SHORTEST:
        return stated
    second = np.abs(np.diff(rates, n=2, axis=0))
    return max(stated, float(np.median(second, axis=0).max() * 1.4826 / np.sqrt(6)))


def smoothed(rates: Array, sample_s: float, smooth_s: float, sigma: float) -> Array:
    """Smoothed rates of one run of samples.

    Parameters
    ----------
    rates : (n, 3) rad/s, evenly sampled
    sample_s : spacing, s
    smooth_s : longest window, s
    sigma : noise of one sample, rad/s

    Returns
    -------
    (n, 3)
    """
    longest = min(int(smooth_s / sample_s), len(rates) - 1 + len(rates) % 2)
    if longest < SHORTEST or sigma <= 0:
        return rates
    rates = _without_outliers(rates, sigma)
    best, low, high = rates, rates - AGREEMENT * sigma, rates + AGREEMENT * sigma
    going = np.ones(len(rates), dtype=bool)
    for window in _ladder(longest):
        estimate = savgol_filter(rates, window, ORDER, axis=0, mode="interp")
        going &= ((estimate >= low) & (estimate <= high)).all(axis=1)
        width = AGREEMENT * sigma * float(np.linalg.norm(savgol_coeffs(window, ORDER)))
        low, high = np.maximum(low, estimate - width), np.minimum(high, estimate + width)
        best = np.where(going[:, None], estimate, best)
    return np.asarray(best)


def _ladder(longest: int) -> list[int]:
    """Odd windows from the shortest to the longest, each about 1.5 times the one before."""
    windows, window = [], float(SHORTEST)
    while window < longest:
        windows.append(int(window) // 2 * 2 + 1)
        window *= 1.5
    return [*[w for w in windows if w < longest], longest - 1 + longest % 2]


def _without_outliers(rates: Array, sigma: float) -> Array:
    median = median_filter(rates, size=(5, 1), mode="nearest")
    return np.where(np.abs(rates - median) > OUTLIER * sigma, median, rates)
