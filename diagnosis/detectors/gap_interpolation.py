"""Lines in place of samples that were not measured, and the noise density that covers the errors of these lines.

A run of n such samples gets the line between its neighbours. Its angle holds each neighbour with the weight n/2, beside the
neighbour's own angle, so that white noise σ gives n + 2 samples the variance 2 σ²Δt² (1 + n/2)². That is the density of white
noise times 1 + n/2.

The motion adds M² to this variance. The same line over n good samples in a row misses the angle that they turn by

    e = Δt (n/2 (r_before + r_after) − Σ r),    E e² = M² + σ²Δt² (n²/2 + n),

so that the nearest good samples show M², which is spread evenly over the run.
"""

from __future__ import annotations

import numpy as np

from gyrocal.arrays import Array, Indices, Mask
from gyrocal.mask_runs import find_mask_runs

FEWEST_PLACES = 12  # runs of n good samples, below which they show no M²
MOST_PLACES = 64  # nearest of these runs, which are averaged


def fill_gaps(t_s: Array, rates: Array, bad: Mask, sample_s: float, sigma: float = 0.0) -> tuple[Array, Array, Array]:
    """Fill the bad samples (n,) of rates (n, 3), rad/s, that start at `t_s` and have white noise `sigma`, with lines.

    Returns the rates, the factor (n,) by which the noise density of a sample grows, and what the motion adds to it, (n, 3)
    rad²/s.
    """
    filled = np.column_stack([np.where(bad, np.interp(t_s, t_s[~bad], x[~bad]), x) for x in rates.T])
    factor, density = np.ones(len(rates)), np.zeros(rates.shape)
    connected = ~bad & np.append(True, np.diff(t_s) < 1.5 * sample_s)
    runs = find_mask_runs(bad)
    for count in {high - low for low, high in runs}:
        starts, squares = _measure_misses(rates, connected, count)
        for low in [low for low, high in runs if high - low == count]:
            factor[max(low - 1, 0) : low + count + 1] = 1 + count / 2
            if starts.size >= FEWEST_PLACES:
                begin = np.clip(np.searchsorted(starts, low) - MOST_PLACES // 2, 0, max(starts.size - MOST_PLACES, 0))
                excess = squares[begin : begin + MOST_PLACES].mean(axis=0) - sigma**2 * (count**2 / 2 + count)
                density[low : low + count] = np.maximum(excess, 0.0) * sample_s / count
    return filled, factor, density


def _measure_misses(rates: Array, connected: Mask, count: int) -> tuple[Indices, Array]:
    """Measure e²/Δt² (p, 3), (rad/s)², of lines over `count` good samples, and the indices (p,) of the first of these."""
    kernel = np.concatenate([[count / 2], -np.ones(count), [count / 2]])
    if kernel.size > len(rates):
        return np.zeros(0, dtype=np.intp), np.zeros((0, 3))
    is_usable = np.convolve(connected, np.ones(kernel.size), "valid") > kernel.size - 0.5
    angle_errors = np.column_stack([np.convolve(x, kernel, "valid") for x in rates.T])
    return np.flatnonzero(is_usable) + 1, angle_errors[is_usable] ** 2
