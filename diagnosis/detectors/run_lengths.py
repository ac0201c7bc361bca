"""Whether repeated samples behave like missed telemetry: their runs begin at random and last a geometric time.

The p-value under that model weighs the listed cause against something unlisted (`diagnosis.model.symptoms`). For a period q of
times counted in samples, the resultant R² = |Σ exp(2πi k/q)|²/m of m random times has an exponential distribution of mean one;
all periods up to `LONGEST` are tried. The lengths are compared with a geometric distribution of their own mean by the largest
distance of the distributions (Lilliefors), whose distribution comes from draws.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

LONGEST = 64  # samples, of a period
FEWEST = 8  # runs, below which nothing is said
MOST = 2000  # runs that are compared
DRAWS = 2000
SINGLE = 1.05  # mean length, below which nearly all runs are of one sample


def compute_p_of_runs(starts: Indices, lengths: Indices, seed: int = 0) -> float:
    """Compute the p-value of runs of repeats that begin at random and last a geometric time.

    Parameters
    ----------
    starts : (m,) first sample of each run, counted from its interval's first
    lengths : (m,) samples
    """
    if starts.size < FEWEST:
        return 1.0
    regular = compute_p_of_times(starts)
    if float(lengths.mean()) < SINGLE:
        return regular
    return min(1.0, 2 * min(regular, compute_p_of_lengths(lengths[:MOST], seed)))


def compute_p_of_times(times: Indices) -> float:
    """Compute the p-value of the strongest period of random times (m,), in samples."""
    periods = np.arange(2, LONGEST + 1)
    angle = 2 * np.pi * (times[None, :MOST] % periods[:, None]) / periods[:, None]
    resultant = np.abs(np.exp(1j * angle).sum(axis=1)) ** 2 / angle.shape[1]
    resultant[0] *= 0.5  # of period 2 it is real: χ² with one degree of freedom
    return min(1.0, periods.size * float(np.exp(-resultant.max())))


def compute_p_of_lengths(lengths: Indices, seed: int = 0) -> float:
    """Compute the p-value of lengths (m,) that are geometric, against draws of the same mean."""
    rng = np.random.default_rng(seed)
    draws = max(200, min(DRAWS, int(2e6 / lengths.size)))
    own = float(_measure_distance(lengths[None])[0])
    others = _measure_distance(rng.geometric(1 / float(lengths.mean()), (draws, lengths.size)))
    return (1 + int(np.sum(others >= own))) / (1 + draws)


def _measure_distance(lengths: Indices) -> Array:
    """(d,) largest distance of the distribution of some lengths (d, m) to the geometric one of their mean."""
    x = np.sort(lengths, axis=1)
    expected = 1 - (1 - 1 / x.mean(axis=1, keepdims=True)) ** x
    upper = np.arange(1, x.shape[1] + 1) / x.shape[1]
    # Of equal values, only the last shows the empirical distribution.
    last = np.append(np.diff(x, axis=1) > 0, np.ones((len(x), 1), dtype=bool), axis=1)
    return np.asarray(np.max(np.where(last, np.abs(upper - expected), 0.0), axis=1))
