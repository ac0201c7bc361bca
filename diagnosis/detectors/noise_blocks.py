"""Short blocks of samples in which a smooth motion leaves nothing of itself in the upper half of the spectrum.

Differences of the sixth order leave little of a motion that is slow beside the sampling, before any window could spread it
over all frequencies. Their cosines from a quarter of the sampling rate on, whitened with their covariance under white noise,
tell it from readout noise, whose power rises with the frequency, and from a motion with jerks, which is not in all blocks
alike. A motion has the more power the slower it is, and jerks, too: cosines below a quarter of the sampling rate, whitened
together with those above, say which blocks are the calmest. Under white noise they are independent of those above, whose
power that choice leaves alone.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.fft
import scipy.linalg
import scipy.stats
from numpy.typing import NDArray

Array = NDArray[np.float64]

ORDER = 6  # of the differences
BLOCK = 32  # samples whose spectrum is looked at
SLOWEST = 6  # cosine, below which differences leave too little of white noise
BAND = 4  # cosines of it in a band
MEDIAN, MEDIAN_SPREAD = 0.839, 0.90  # of χ² with as many degrees of freedom, over these; relative variance of that of many
QUANTILES = (0.3, 0.85)  # of the blocks' powers; the few that are far out do not count
EVEN = 3.0  # sigmas between the levels that they show, at most


def blocks_of(parts: list[Array]) -> Array:
    """(b, BLOCK/2) coefficients of the upper half of the spectrum of short blocks, from the highest frequency down.

    Those of white noise of variance σ² are independent and N(0, σ²): the cosines of differences of the sixth order, which
    leave nothing of a smooth motion for the ends of a block to spread over all frequencies, are whitened with their own
    covariance.
    """
    differences = [np.diff(part, ORDER) for part in parts if part.size >= BLOCK + ORDER]
    whole = [one[: one.size // BLOCK * BLOCK].reshape(-1, BLOCK) for one in differences]
    return np.concatenate([np.empty((0, BLOCK)), *whole]) @ _WHITE[: BLOCK // 2].T


def calmest(parts: list[Array]) -> list[Array]:
    """The samples of the half of the blocks with the least slow power, (BLOCK + ORDER,) each."""
    found = [
        np.lib.stride_tricks.sliding_window_view(part, BLOCK + ORDER)[::BLOCK] for part in parts if part.size >= BLOCK + ORDER
    ]
    samples = np.concatenate([np.empty((0, BLOCK + ORDER)), *found])
    slow = np.sum((np.diff(samples, ORDER, axis=1) @ _WHITE[BLOCK // 2 :].T) ** 2, axis=1)
    return list(samples[np.sort(np.argsort(slow, kind="stable")[: len(samples) // 2])])


def _covariance(order: int) -> Array:
    """(BLOCK, BLOCK) of differences of white noise of unit variance."""
    kernel = np.array([(-1.0) ** k * math.comb(order, k) for k in range(order + 1)])
    lags = np.correlate(kernel, kernel, "full")[order:]
    return np.asarray(scipy.linalg.toeplitz(np.append(lags, np.zeros(BLOCK - lags.size))))


def _white_cosines() -> Array:
    """(BLOCK − SLOWEST, BLOCK) from differences to coefficients, downward, that are independent under white noise."""
    cosines = scipy.fft.dct(np.eye(BLOCK), axis=0, norm="ortho")[SLOWEST:][::-1]
    factor = np.linalg.cholesky(cosines @ _covariance(ORDER) @ cosines.T)
    return np.asarray(scipy.linalg.solve_triangular(factor, cosines, lower=True))


_WHITE = _white_cosines()
# Power of each of readings of the angle with unit variance, whose differences the rates are.
READ_OUT = np.diag(_WHITE @ _covariance(ORDER + 1) @ _WHITE.T)[: BLOCK // 2].copy()


def bands_of(blocks: Array) -> Array:
    """Power in bands of the upper half of the spectrum, from the highest down, as medians over the blocks.

    Of χ² with four degrees of freedom over four, whose median is 0.839 with the relative variance 0.90 over their number.
    """
    return np.asarray(np.median((blocks**2).reshape(len(blocks), -1, BAND).mean(axis=2), axis=0) / MEDIAN)


def is_even(blocks: Array) -> bool:
    """Whether the blocks' powers scatter as those of white noise, and not as with jerks of a motion in some of them.

    Two quantiles of χ² show one level then. The covariance of the quantiles p < q of n values with the density f is
    p (1 − q)/(n f_p f_q).
    """
    power, dof = np.sum(blocks**2, axis=1), blocks.shape[1]
    of_white = scipy.stats.chi2(dof)
    at = of_white.ppf(QUANTILES)
    low, high = np.quantile(power, QUANTILES) / at
    (p, q), (a, b) = QUANTILES, 1 / (at * of_white.pdf(at))
    error = np.sqrt((p * (1 - p) * a**2 + q * (1 - q) * b**2 - 2 * p * (1 - q) * a * b) / len(power))
    return bool(high < (1 + EVEN * error) * low)
