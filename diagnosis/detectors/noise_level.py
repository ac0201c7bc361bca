"""Noise of one gyro: its level, and whether an excess is white noise or readout noise of the angle.

Of the short blocks (`diagnosis.detectors.noise_blocks`), the largest share of the calmest is taken in which no motion shows:
whose powers are those of noise, and scatter as such, as they do not where the motion has jerks. Blocks that pass zero, where a
dead zone jumps, count if they show the same level. Where a motion shows in all shares, but the spectrum is level beside a weak
one, all that it adds counts as an uncertainty of the level. Two templates test whether the noise is as stated, white noise of
another level and readout noise beside white noise as stated, and the smaller p-value counts twice.

An excess of either kind has one number, and the smaller χ² says which it is; the ratio of their likelihoods is the odds. Where
neither fits, both together may. IEEE Std 952, annex C.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.special
from numpy.typing import NDArray
from scipy.special import expit

from diagnosis.detectors.noise_blocks import (
    MOVING,
    OF_MOTION,
    ORDER,
    READ_OUT,
    SAMPLES,
    SHOWING,
    WHITE_COSINES,
    cut_blocks,
    estimate_powers,
    find_zero_crossings,
    fit_white_noise,
    has_spike,
    is_even,
    rank_calm_blocks,
    smooth_errors,
)
from gyrocal.calibration.estimated_noise import compute_chi2_p, compute_smaller_chi2_p

Array = NDArray[np.float64]

CALM_SHARES = (1.0, 0.9, 0.75, 0.5, 0.35, 0.25)  # of the blocks that are tried, the calmest ones
FEWEST_BLOCKS = 12  # below which nothing is said
SAME = 2.0  # sigmas between blocks that pass zero and the rest, up to which they show one level
FITS = 1e-3  # p-value from which on noise is explained
UNDECIDED = 8.0  # difference of χ² up to which the worse of white and readout noise is possible, too
CLEAR = 4.0  # sigmas of white and of readout noise, where both are needed


@dataclass(frozen=True)
class Readout:
    """Readout noise of an axis."""

    reading: float  # reading, sigma: standard deviation of a reading over a sample's length, rad/s
    sigma: float
    white: float  # white, white_sigma: variance of the white noise beside it, (rad/s)²; its sigma is zero where it is as stated
    white_sigma: float
    probability: float  # that the excess is readout noise and not white

    @property
    def is_as_stated(self) -> bool:
        """Whether the white noise is."""
        return self.white_sigma == 0.0


@dataclass(frozen=True)
class NoiseLevel:
    """Noise of one axis."""

    variance: float  # variance, sigma: of a sample, (rad/s)², and the standard error of that
    sigma: float
    p_value: float  # under white noise as stated, that it has another level or rises as readout noise
    readout: Readout | None  # readout noise, if that explains it
    powers: Array  # (k,) mean squares over the blocks, (rad/s)²
    blocks: int  # number of blocks
    still: bool  # whether no motion shows in them


def fit_noise_level(x: Array, arcs: list[tuple[int, int]], expected: float, noise_degrees: float = np.inf) -> NoiseLevel | None:
    """Fit the noise in the largest share of the calmest blocks that shows no motion.

    Where a motion shows in all shares, it is that of the share that tells the level best beside it; None where no share does.

    Parameters
    ----------
    x : (n,) readings, rad/s
    arcs : runs of samples
    expected : variance of a sample's noise as stated, (rad/s)²
    noise_degrees : its degrees of freedom, if it was estimated
    """
    samples = cut_blocks([x[low:high] for low, high in arcs])
    blocks = np.diff(samples, ORDER, axis=1) @ WHITE_COSINES.T
    # Spikes that are too small to be repaired beside the motion are no level.
    single = ~has_spike(blocks)
    samples, blocks = samples[single], blocks[single]
    through = find_zero_crossings(samples, float(np.sqrt(expected)))
    if not _has_same_level(blocks[through], blocks[~through]):
        blocks = blocks[~through]
    order = rank_calm_blocks(blocks)
    moving: list[NoiseLevel] = []
    for share in CALM_SHARES:
        chosen = np.sort(order[: int(share * order.size)])
        if chosen.size < FEWEST_BLOCKS:
            break
        found = _fit_blocks(blocks[chosen, :SHOWING], expected, noise_degrees)
        if found is not None and found.still:
            return found
        moving += [found] if found is not None else []
    return min(moving, key=lambda one: one.sigma, default=None)


def _has_same_level(some: Array, rest: Array) -> bool:
    """Whether blocks that pass zero show the level of the rest, as those with the jumps of a dead zone do not."""
    levels: list[tuple[float, float]] = []
    for blocks in (some, rest):
        chosen = rank_calm_blocks(blocks)
        if chosen.size < FEWEST_BLOCKS:
            return rest.size < some.size
        fit = fit_white_noise(estimate_powers(blocks[chosen, :SHOWING]), chosen.size)
        levels.append((fit.white, fit.sigma))
    (one, error), (other, other_error) = levels
    return bool(abs(one - other) < SAME * np.hypot(error, other_error))


def _fit_blocks(blocks: Array, expected: float, noise_degrees: float) -> NoiseLevel | None:
    """Fit the noise of some blocks; None where they show more than noise and a weak motion."""
    powers, count = estimate_powers(blocks), len(blocks)
    if not powers.all():  # readings that stand still on a lattice in most of the blocks
        return None
    fit = fit_white_noise(powers / expected, count)
    readout = fit_readout(powers, smooth_errors(powers, count), expected)
    explained = fit.fits or (fit.still and readout is not None and readout.probability >= 0.5)
    half = SAMPLES // 2
    if not explained or fit.white <= 0 or not is_even(blocks[:, :half] / np.sqrt(powers[:half])):
        return None
    variance = expected * fit.white
    sigma = expected * (fit.sigma if fit.still else float(np.hypot(fit.sigma, fit.motion)))
    p = compute_p_of_level(variance, sigma, expected, noise_degrees)
    if not fit.still:
        return NoiseLevel(variance, sigma, p, None, powers, count, still=False)
    free = SHOWING * count
    rising = float(scipy.special.chdtrc(free, free + fit.rise * np.sqrt(2 * free)))
    return NoiseLevel(variance, sigma, min(1.0, 2 * min(p, rising)), readout, powers, count, still=True)


def compute_p_of_level(variance: float, sigma: float, expected: float, noise_degrees: float = np.inf) -> float:
    """Compute the p-value of a variance that is as stated: χ² with as many degrees of freedom as its sigma says."""
    free = 2 * (variance / sigma) ** 2
    chi2 = free * variance / expected
    smaller = compute_smaller_chi2_p(chi2, free, noise_degrees)
    return float(min(1.0, 2 * min(compute_chi2_p(chi2, free, noise_degrees), smaller)))


def fit_readout(powers: Array, errors: Array, expected: float) -> Readout | None:
    """Fit readout noise, beside any motion, if that explains the powers better than white noise does, or nearly as well.

    Parameters
    ----------
    powers, errors : (k,) of the blocks, and their standard errors, (rad/s)²
    expected : variance of white noise as stated, (rad/s)²
    """
    even, fits, free = np.ones(powers.size), FITS, powers.size - 2
    _, _, white_chi2 = _fit_parts(powers / errors, errors, [even])
    square, error, chi2 = _fit_parts((powers - expected) / errors, errors, [READ_OUT])
    both, sigmas, both_chi2 = _fit_parts(powers / errors, errors, [READ_OUT, even])
    needed = (np.abs(both - [0.0, expected]) > CLEAR * sigmas).all() and (both > 0).all()
    if needed and scipy.special.chdtrc(free, white_chi2) < fits < scipy.special.chdtrc(free - 1, both_chi2):
        return _make_readout(both[0], sigmas[0], both[1], sigmas[1], float(expit(0.5 * (white_chi2 - both_chi2))))
    if square[0] > 0 and chi2 < white_chi2 + UNDECIDED and scipy.special.chdtrc(free, chi2) > fits:
        return _make_readout(square[0], error[0], expected, 0.0, float(expit(0.5 * (white_chi2 - chi2))))
    return None


def _make_readout(square: float, error: float, white: float, white_sigma: float, probability: float) -> Readout:
    size = float(np.sqrt(square))
    return Readout(size, 0.5 * float(error) / size, float(white), float(white_sigma), probability)


def _fit_parts(seen: Array, errors: Array, parts: list[Array]) -> tuple[Array, Array, float]:
    """Fit parts (k,) of a spectrum, and a motion if one shows, to powers in their errors; sizes, sigmas, and χ² of the rest."""
    for columns in ([*parts, OF_MOTION], parts):
        design = np.column_stack(columns) / errors[:, None]
        covariance = np.linalg.inv(design.T @ design)
        found, sigmas = covariance @ design.T @ seen, np.sqrt(np.diag(covariance))
        if found[-1] > MOVING * sigmas[-1]:
            break
    return found[: len(parts)], sigmas[: len(parts)], float(np.sum((seen - design @ found) ** 2))
