"""Whether too much noise of the samples is white, or readout noise of the angle.

White noise of variance w and readout noise of the angle, whose differences over a sample have the variance 2 q², leave in the
differences of order d of means over m samples, times m and over C(2d, d),

    C_m = w + a q²/m,    a = C(2d + 2, d + 1)/C(2d, d),

since the mean of m differences of readings is the difference of two readings over m. Too much white noise is the same at all
m; readout noise falls as 1/m to a level that is as stated. Both have one number, and the smaller χ² says which it is; the ratio
of their likelihoods is the odds. Where neither fits, both together may. IEEE Std 952, annex C.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.stats
from numpy.typing import NDArray
from scipy.special import expit

Array = NDArray[np.float64]

AVERAGES = (1, 2, 4, 8)  # samples in a mean
FITS = 1e-3  # p-value from which on noise is explained
UNDECIDED = 8.0  # difference of χ², up to which the worse of the two is possible, too
CLEAR = 5.0  # sigmas of either part, where both are needed


@dataclass(frozen=True)
class Readout:
    """Readout noise of an axis.

    Attributes
    ----------
    reading, sigma : standard deviation of a reading over a sample's length, rad/s
    white, white_sigma : variance of the white noise beside it, (rad/s)²
    as_stated : whether that is as stated
    probability : that the excess is readout noise and not white
    """

    reading: float
    sigma: float
    white: float
    white_sigma: float
    as_stated: bool
    probability: float


def readout(powers: Array, errors: Array, share: Array, expected: float, beside: Array | None = None) -> Readout | None:
    """Readout noise, if that explains the powers better than white noise does, or nearly as well.

    Parameters
    ----------
    powers, errors : (k,) as C_m, and their standard errors, (rad/s)²
    share : (k,) of q² that each has, as a/m
    expected : w as stated
    beside : (k,) share of something else of any size, such as the rest of a motion
    """
    if len(powers) < 3 or expected <= 0:
        return None
    seen, even, rise = powers / errors, 1 / errors, share / errors
    if beside is not None:
        # What is at right angles to it, it does not touch.
        free_of = scipy.linalg.null_space((beside / errors)[None]).T
        seen, even, rise = free_of @ seen, free_of @ even, free_of @ rise
    white_chi2 = _left(seen, even * float(seen @ even) / float(even @ even))
    square = float((seen - expected * even) @ rise) / float(rise @ rise)
    chi2 = _left(seen, expected * even + square * rise)
    free = len(seen) - 1
    if square > 0 and chi2 < white_chi2 + UNDECIDED and scipy.stats.chi2.sf(chi2, free) > FITS:
        error = float(1 / np.sqrt(rise @ rise))
        return Readout(
            float(np.sqrt(square)), 0.5 * error / float(np.sqrt(square)), expected, 0.0, True,
            float(expit(0.5 * (white_chi2 - chi2))),
        )  # fmt: skip
    design = np.column_stack([even, rise])
    covariance = np.linalg.inv(design.T @ design)
    white, square = (float(value) for value in covariance @ design.T @ seen)
    chi2 = _left(seen, white * even + square * rise)
    clear = square > CLEAR * np.sqrt(covariance[1, 1]) and white > CLEAR * np.sqrt(covariance[0, 0])
    if not clear or scipy.stats.chi2.sf(white_chi2, free) > FITS or scipy.stats.chi2.sf(chi2, free - 1) < FITS:
        return None
    error = float(np.sqrt(covariance[1, 1]))
    return Readout(
        float(np.sqrt(square)), 0.5 * error / float(np.sqrt(square)), white, float(np.sqrt(covariance[0, 0])), False,
        float(expit(0.5 * (white_chi2 - chi2))),
    )  # fmt: skip


def _left(seen: Array, explained: Array) -> float:
    """χ² of what is not explained."""
    return float(np.sum((seen - explained) ** 2))
