"""Smoothed rates: the gyro's noise taken out, slews left in.

A local quadratic is fitted to the mean rates in a window around each sample (Savitzky and Golay, Analytical Chemistry 36 (1964)
1627). A long window takes out more noise and bends a slew's ramps; each sample of each axis therefore gets the longest of a
ladder of windows w_1 < w_2 < …, up to the whole run, whose estimate still agrees, within the noise of both, with those of all
shorter ones (Lepski's rule: Goldenshluger and Nemirovski, Mathematical Methods of Statistics 6 (1997) 135). From a sample to
the next that window changes, and the estimate with it by as much as the noise that was allowed for: the motion of a body that
sways would have steps of a sample's sigma. The estimates x_r of the windows are therefore faded into each other,

    x = x_0 + Σ_r s_r (x_r − x_{r−1}),    s_r = min(s_{r−1}, d_r / ½w_r, 1),

with x_0 the readings and d_r the distance from the nearest sample at which the window w_r disagrees, so that no sample gets
more of a long window than the rule allows. Windows of many samples are fitted to means over short blocks of them. Single
outliers, further off the median of five than ten sigma, are replaced by that median first.

An axis at rest needs the long windows: a function such as ω|ω| of a rate that is nothing but noise goes with the noise of the
attitude that is propagated with it, and would be taken for an effect.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.linalg import lstsq
from scipy.ndimage import convolve1d, median_filter

from gyrocal.arrays import Array, Mask
from gyrocal.jit_cache import compile_cached

POLYNOMIAL_ORDER = 2  # of the local polynomial in the rate
AGREEMENT_SIGMAS = 4.0  # sigma; tens of thousands of samples
OUTLIER = 10.0  # sigma
WINDOW_BLOCKS = 33  # of a long window; a quadratic bends little over a thirtieth of it
SHARP = 11  # samples; a bend within a window so short may be seen in one of them alone
SHORTEST_WINDOW_SAMPLES = 5  # samples; a quadratic through three is no smoothing


def estimate_sample_sigma(rates: Array, stated: float) -> Array:
    """Estimate sigma (3,) of one sample, rad/s: the stated one, or that of the second differences if it is larger.

    Second differences of a smooth rate are noise with the standard deviation √6 σ; the median is not moved by slews.
    """
    if len(rates) < SHORTEST_WINDOW_SAMPLES:
        return np.full(rates.shape[1], stated)
    second = np.abs(np.diff(rates, n=2, axis=0))
    return np.asarray(np.maximum(stated, np.median(second, axis=0) * 1.4826 / np.sqrt(6)))


def smooth_run(rates: Array, sample_s: float, smooth_s: float, sigma: Array) -> Array:
    """Smooth the rates (n, 3) of one run of samples, rad/s.

    Parameters
    ----------
    rates : (n, 3) rad/s, evenly sampled
    sample_s : spacing, s
    smooth_s : longest window, s; infinite for the whole run, zero for no smoothing
    sigma : (3,) noise of one sample of each axis, rad/s
    """
    if min(smooth_s / sample_s, len(rates)) < SHORTEST_WINDOW_SAMPLES:
        return rates
    cleaned = [replace_outliers(rates[:, axis], level) for axis, level in enumerate(sigma)]
    return np.column_stack([smooth_axis(x, sample_s, smooth_s, level)[0] for x, level in zip(cleaned, sigma, strict=True)])


def smooth_axis(rates: Array, sample_s: float, smooth_s: float, sigma: float) -> tuple[Array, float]:
    """Smooth the rates (n,) of one axis without outliers; with the degrees of freedom, the multiple of σ² in the result.

    These are the sum of the samples' leverages, each on its own estimate; n without smoothing.
    """
    longest = int(min(smooth_s / sample_s, len(rates) - 1 + len(rates) % 2))
    if longest < SHORTEST_WINDOW_SAMPLES or not sigma > 0:
        return rates, float(rates.size)
    return _smooth_with_windows(rates, _list_windows(longest), sigma)


def replace_outliers(rates: Array, sigma: float) -> Array:
    """Replace single outliers in the rates (n,) of one axis by the median of five; without noise return the rates."""
    if not sigma > 0:
        return rates
    median = median_filter(rates, size=5, mode="nearest")
    return np.where(np.abs(rates - median) > OUTLIER * sigma, median, rates)


def _smooth_with_windows(rates: Array, windows: Sequence[int], sigma: float) -> tuple[Array, float]:
    """Smooth one axis with each sample's longest window that agrees with all shorter ones; (n,), and degrees of freedom."""
    width = AGREEMENT_SIGMAS * sigma
    low, high, agrees = rates - width, rates + width, np.ones(rates.size, dtype=bool)
    smoothed = previous = rates
    leverages = previous_leverages = np.ones(rates.size)  # of each sample on its own smoothed value
    fading: Array | None = None  # s_r of the module's formula; None if it is one at all samples
    for window in windows:
        estimate, relative_sigmas = _fit_window(rates, window)
        _tighten_limits(estimate, relative_sigmas, width, agrees, low, high)
        stops = ~agrees if window <= SHARP else _keep_rows_of_three(~agrees)
        window_leverages = relative_sigmas**2  # as in any least-squares fit
        if stops.any():
            ramp = _compute_ramp(stops, 0.5 * window)
            fading = ramp if fading is None else np.minimum(fading, ramp)
        if fading is None:
            smoothed, leverages = estimate, window_leverages
        elif not fading.any():
            break
        else:
            smoothed = smoothed + fading * (estimate - previous)
            leverages = leverages + fading * (window_leverages - previous_leverages)
        previous, previous_leverages = estimate, window_leverages
    return np.asarray(smoothed), float(leverages.sum())


@compile_cached
def _tighten_limits(estimate: Array, weight: Array, width: float, agrees: Mask, low: Array, high: Array) -> None:
    """Clear agreement of samples outside the limits of the earlier windows, and tighten the limits by this one, in place."""
    for k in range(estimate.size):
        agrees[k] &= low[k] <= estimate[k] <= high[k]
        low[k] = max(low[k], estimate[k] - width * weight[k])
        high[k] = min(high[k], estimate[k] + width * weight[k])


def _keep_rows_of_three(marked: Mask) -> Mask:
    """Keep marks that are three in a row or more: noise alone marks single samples, motion all over its bend."""
    core = marked[:-2] & marked[1:-1] & marked[2:]
    out = np.zeros(marked.size, dtype=bool)
    if core.any():
        for shift in range(3):
            out[shift : shift + core.size] |= core
    return out


@compile_cached
def _compute_ramp(stops: Mask, length: float) -> Array:
    """Compute the distance of each sample from the nearest one that stops, over a length; one at most."""
    out = np.empty(stops.size)
    distance = length
    for k in range(stops.size):
        distance = 0.0 if stops[k] else distance + 1.0
        out[k] = min(distance / length, 1.0)
    distance = length
    for k in range(stops.size - 1, -1, -1):
        distance = 0.0 if stops[k] else distance + 1.0
        out[k] = min(distance / length, out[k])
    return out


def _fit_window(rates: Array, window: int) -> tuple[Array, Array]:
    """Fit a local quadratic of a window to each sample (n,); with its sigma per unit sigma of a sample (n,)."""
    block = max(1, window // WINDOW_BLOCKS)
    if block == 1:
        return _filter_window(rates, window), _compute_sample_sigmas(window, len(rates))
    count = len(rates) // block
    means = rates[: count * block].reshape(count, block).mean(axis=1)
    width = min(window // block // 2 * 2 + 1, count - 1 + count % 2)
    estimate = _interpolate_blocks(_filter_window(means, width), block, len(rates))
    return estimate, _compute_sample_sigmas(width, len(rates), block) / float(np.sqrt(block))


def _filter_window(rates: Array, window: int) -> Array:
    """Fit a local quadratic of an odd window to each sample (n,); at either end, that of the first or the last whole window.

    It is scipy's ``savgol_filter`` to the bit. That one solves for a window's coefficients anew each time, and comes with all
    of scipy.signal and scipy.stats, which take each process half a second to load.
    """
    out = convolve1d(rates, _compute_coefficients(window), mode="constant")
    powers, scale = _compute_powers(window)
    half = window // 2
    for part, target in ((slice(0, window), slice(0, half)), (slice(rates.size - window, None), slice(window - half, window))):
        c = lstsq(powers, rates[part], cond=window * np.finfo(float).eps)[0] / scale
        position = np.arange(target.start, target.stop, dtype=float)
        out[part][target] = ((0.0 * position + c[0]) * position + c[1]) * position + c[2]
    return np.asarray(out)


@lru_cache(maxsize=256)
def _compute_coefficients(window: int) -> Array:
    """Compute the filter (window,) of a local quadratic; all intervals and axes share a few windows."""
    position = np.arange(window // 2, -(window // 2) - 1, -1, dtype=float)
    powers = position ** np.arange(POLYNOMIAL_ORDER + 1, dtype=float)[:, None]
    return np.asarray(lstsq(powers, np.eye(POLYNOMIAL_ORDER + 1)[0], cond=window * np.finfo(float).eps)[0])


@lru_cache(maxsize=256)
def _compute_powers(window: int) -> tuple[Array, Array]:
    """Compute powers (window, 3) of the sample numbers, highest first, scaled to length one, and their lengths (3,)."""
    powers = np.arange(window, dtype=float)[:, None] ** np.arange(POLYNOMIAL_ORDER, -1, -1, dtype=float)
    scale = np.sqrt(np.sum(powers * powers, axis=0))
    return powers / scale, scale


@compile_cached
def _interpolate_blocks(values: Array, block: int, count: int) -> Array:
    """Interpolate values in the middles of blocks by straight lines to each sample (n,), beyond the first and last too."""
    out = np.empty(count)
    for k in range(count):
        position = (k - 0.5 * (block - 1)) / block
        first = min(max(int(position), 0), values.size - 2)
        out[k] = values[first] + (position - first) * (values[first + 1] - values[first])
    return out


def _compute_sample_sigmas(window: int, count: int, block: int = 1) -> Array:
    """Compute sigma (count,) of the quadratic of so many blocks at each sample, per unit sigma of a block.

    At either end it is twice that of the middle.
    """
    middle, ends = _compute_window_sigmas(window)
    out = np.full(count, middle)
    position = (np.arange(ends.size * block) - 0.5 * (block - 1)) / block
    beginning = np.interp(position, np.arange(ends.size + 1), np.append(ends, middle)) if block > 1 else ends
    out[: beginning.size], out[count - beginning.size :] = beginning, beginning[::-1]
    return out


@lru_cache(maxsize=256)
def _compute_window_sigmas(window: int) -> tuple[float, Array]:
    """Compute sigma of a window's quadratic in its middle, and before that from its first sample on (window // 2,)."""
    basis = np.linalg.qr(_compute_powers(window)[0])[0]
    return float(np.linalg.norm(_compute_coefficients(window))), np.asarray(np.linalg.norm(basis, axis=1)[: window // 2])


def _list_windows(longest: int) -> list[int]:
    """List odd windows from the shortest to the longest, each about 1.5 times the one before."""
    windows, window = [], float(SHORTEST_WINDOW_SAMPLES)
    while window < longest:
        windows.append(int(window) // 2 * 2 + 1)
        window *= 1.5
    return [*[w for w in windows if w < longest], longest - 1 + longest % 2]
