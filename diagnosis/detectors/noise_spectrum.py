"""Fit the spectrum of one gyro's noise: the level of white noise, and readout noise of the angle, beside any motion.

`diagnosis.detectors.sample_noise` decides by this fit how large the noise of a sample is.

Of short blocks of samples, the largest share of the calmest is taken in which no motion shows: whose powers are those of noise,
and scatter as such, as they do not where the motion has jerks. Blocks that pass zero, where a
dead zone jumps, count if they show the same level. Where a motion shows in all shares, but the spectrum is level beside a weak
one, all that it adds counts as an uncertainty of the level. Two templates test whether the noise is as stated, white noise of
another level and readout noise beside white noise as stated, and the smaller p-value counts twice.

An excess of either kind has one number, and the smaller χ² says which it is; the ratio of their likelihoods is the odds. Where
neither fits, both together may. IEEE Std 952, annex C.

In most of the spectrum of a block a smooth motion leaves next to nothing of itself: differences of the sixth order leave little
of a motion that is slow beside the sampling, before any window could spread it over all frequencies. Their cosines, whitened
from the highest frequency down with their covariance under white noise of variance w, are then independent and N(0, w). What is
left of a motion has the more power the slower it is: the slowest cosines say which blocks are the calmest, each in terms of
what is usual for it, and under white noise that choice leaves the power of those above alone. Their mean squares P_k say how
much noise there is, and of which kind,

    P_k = w + q² R_k + m M_k,

with R_k of readings of the angle with unit variance, whose differences the rates are, which rises with the frequency, and M_k
of a motion whose second derivative is white noise, as jerks make it, which falls. Where its part m is free, a rest of the
motion that is too weak to be seen is not taken for noise; w is then known by a quarter worse.

P_k is the mean of the squares below c = 3.5², in units of P_k/κ: jerks are rare and large. Under white noise, with F_n and f_n
the distribution and the density of χ² with n degrees of freedom at c, κ = F₃/F₁, and P_k over b blocks has the relative
variance V/b,

    V = (3 F₅ − F₃²/F₁)/(F₃ − (c − κ) c f₁)² = 2.09,

beside 2/b of all squares (Huber, Robust statistics, 1981, section 3.2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.fft
import scipy.linalg
import scipy.special
from scipy.special import expit

from gyrocal.arrays import Array, Indices, Mask
from gyrocal.calibration.estimated_noise import compute_chi2_p, compute_smaller_chi2_p

CALM_SHARES = (1.0, 0.9, 0.75, 0.5, 0.35, 0.25)  # of the blocks that are tried, the calmest ones
FEWEST_BLOCKS = 12  # below which nothing is said
SAME = 2.0  # sigmas between blocks that pass zero and the rest, up to which they show one level
UNDECIDED = 8.0  # difference of χ² up to which the worse of white and readout noise is possible, too
CLEAR = 4.0  # sigmas of white and of readout noise, where both are needed

SAMPLES = 32  # of a block, whose spectrum is looked at
ORDER = 6  # of the differences
SLOWEST = 2  # cosine, below which differences leave too little of white noise
SHOWING = 26  # cosines from the highest down that show the noise; those below, how calm a block is
UNREST = 4.0  # times the usual slow power, from which on a block never counts: one in a hundred of white noise
# sigmas of the least and of the largest reading of a block that passes zero
AT_ZERO = 2.0
FROM_ZERO = 4.0
SPIKE = 4.5  # sigmas of a sample that is far off
CUT = 12.25  # of a square in terms of its mean, from which on it does not count
ROUNDS = 8  # of finding that mean
QUANTILES = (0.3, 0.85)  # of the blocks' powers; the few that are far out do not count
EVEN = 3.0  # sigmas between the levels that they show, at most
MOVING = 2.0  # sigmas of a motion's power, up to which blocks show none
BAND = 9  # cosines, a third of those that show the noise, that a motion in one band may have
FITS = 1e-3  # p-value from which on powers are explained

HIDDEN_TONE_FREQUENCY = 1 / SAMPLES  # cycles a sample, up to which a tone leaves nothing in the blocks
MEDIAN_SQUARE = float(scipy.special.chdtri(1, 0.5))  # of white noise of unit variance


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
        """Whether the white noise is as stated."""
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


def fit_noise_spectrum(
    x: Array, arcs: list[tuple[int, int]], expected: float, noise_degrees: float = np.inf
) -> NoiseLevel | None:
    """Fit the noise of readings x (n,), rad/s, in the largest share of the calmest blocks of some runs that shows no motion.

    Where a motion shows in all shares, the fit with the smallest sigma of the level is returned; None where no share has a fit.
    The variance of a sample is stated as `expected`, (rad/s)², with `noise_degrees` of freedom if it was estimated.
    """
    samples = cut_blocks([x[low:high] for low, high in arcs])
    blocks = np.diff(samples, ORDER, axis=1) @ WHITE_COSINES.T
    # Spikes that are too small to be found beside the motion would raise the level.
    spikeless = ~has_spike(blocks)
    samples, blocks = samples[spikeless], blocks[spikeless]
    crosses_zero = find_zero_crossings(samples, float(np.sqrt(expected)))
    if not _has_same_level(blocks[crosses_zero], blocks[~crosses_zero]):
        blocks = blocks[~crosses_zero]
    order = rank_calm_blocks(blocks)
    moving: list[NoiseLevel] = []
    for share in CALM_SHARES:
        chosen = np.sort(order[: int(share * order.size)])
        if chosen.size < FEWEST_BLOCKS:
            break
        level = _fit_blocks(blocks[chosen, :SHOWING], expected, noise_degrees)
        if level is not None and level.still:
            return level
        moving += [level] if level is not None else []
    return min(moving, key=lambda fit: fit.sigma, default=None)


def _has_same_level(crossing: Array, remaining: Array) -> bool:
    """Check whether blocks that pass zero show the level of the others; with the jumps of a dead zone they do not."""
    levels: list[tuple[float, float]] = []
    for blocks in (crossing, remaining):
        chosen = rank_calm_blocks(blocks)
        if chosen.size < FEWEST_BLOCKS:
            return remaining.size < crossing.size
        fit = fit_white_noise(estimate_powers(blocks[chosen, :SHOWING]), chosen.size)
        levels.append((fit.white, fit.sigma))
    (crossing_level, crossing_sigma), (remaining_level, remaining_sigma) = levels
    return bool(abs(crossing_level - remaining_level) < SAME * np.hypot(crossing_sigma, remaining_sigma))


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
    dof = 2 * (variance / sigma) ** 2  # of χ², as many as the sigma says
    chi2 = dof * variance / expected
    smaller = compute_smaller_chi2_p(chi2, dof, noise_degrees)
    p = float(min(1.0, 2 * min(compute_chi2_p(chi2, dof, noise_degrees), smaller)))
    if not fit.still:
        return NoiseLevel(variance, sigma, p, None, powers, count, still=False)
    squares = SHOWING * count
    rising = float(scipy.special.chdtrc(squares, squares + fit.rise * np.sqrt(2 * squares)))
    return NoiseLevel(variance, sigma, min(1.0, 2 * min(p, rising)), readout, powers, count, still=True)


def fit_readout(powers: Array, errors: Array, expected: float) -> Readout | None:
    """Fit readout noise, beside any motion, if that explains powers (k,), (rad/s)², nearly as well as white noise or better."""
    white, dof = np.ones(powers.size), powers.size - 2
    _, _, white_chi2 = _fit_parts(powers / errors, errors, [white])
    reading_variance, error, chi2 = _fit_parts((powers - expected) / errors, errors, [READ_OUT])
    both, sigmas, both_chi2 = _fit_parts(powers / errors, errors, [READ_OUT, white])
    needed = (np.abs(both - [0.0, expected]) > CLEAR * sigmas).all() and (both > 0).all()
    if needed and scipy.special.chdtrc(dof, white_chi2) < FITS < scipy.special.chdtrc(dof - 1, both_chi2):
        return _make_readout(both[0], sigmas[0], both[1], sigmas[1], float(expit(0.5 * (white_chi2 - both_chi2))))
    if reading_variance[0] > 0 and chi2 < white_chi2 + UNDECIDED and scipy.special.chdtrc(dof, chi2) > FITS:
        return _make_readout(reading_variance[0], error[0], expected, 0.0, float(expit(0.5 * (white_chi2 - chi2))))
    return None


def _make_readout(reading_variance: float, error: float, white: float, white_sigma: float, probability: float) -> Readout:
    size = float(np.sqrt(reading_variance))
    return Readout(size, 0.5 * float(error) / size, float(white), float(white_sigma), probability)


def _fit_parts(powers: Array, errors: Array, parts: list[Array]) -> tuple[Array, Array, float]:
    """Fit parts (k,) of a spectrum, and a motion if one shows, to powers in units of their errors; sizes, sigmas and χ²."""
    for columns in ([*parts, OF_MOTION], parts):
        design = np.column_stack(columns) / errors[:, None]
        covariance = np.linalg.inv(design.T @ design)
        sizes, sigmas = covariance @ design.T @ powers, np.sqrt(np.diag(covariance))
        if sizes[-1] > MOVING * sigmas[-1]:
            break
    return sizes[: len(parts)], sigmas[: len(parts)], float(np.sum((powers - design @ sizes) ** 2))


def cut_blocks(runs: list[Array]) -> Array:
    """Cut runs of samples into blocks (b, SAMPLES + ORDER); the differences of a block are SAMPLES many."""
    windows, length = np.lib.stride_tricks.sliding_window_view, SAMPLES + ORDER
    blocks = [windows(run, length)[::SAMPLES] for run in runs if run.size >= length]
    return np.concatenate([np.empty((0, length)), *blocks])


def find_zero_crossings(samples: Array, sigma: float) -> Mask:
    """Mark the blocks (b,) whose readings move through zero or set out from there, where a dead zone makes jumps."""
    smooth = samples - np.diff(samples, ORDER, axis=1) @ WHITE_COSINES[:SHOWING].T @ BACK
    reaches_zero = (smooth.min(axis=1) < AT_ZERO * sigma) & (smooth.max(axis=1) > -AT_ZERO * sigma)
    return np.asarray(reaches_zero & (np.abs(smooth).max(axis=1) > FROM_ZERO * sigma))


def has_spike(blocks: Array) -> Mask:
    """Mark the blocks (b,) in which one sample is far off its neighbours, as no motion makes it: of white noise one in 4000."""
    power = np.median(blocks[:, : SAMPLES // 2] ** 2) / MEDIAN_SQUARE if len(blocks) else 0.0
    limit = SPIKE * np.sqrt(power * np.sum(BACK**2, axis=0))
    return np.asarray((np.abs(blocks[:, :SHOWING] @ BACK) > limit).any(axis=1))


def rank_calm_blocks(blocks: Array) -> Indices:
    """Rank the blocks by their slow power, the calmest first; indices without the blocks that are far from calm."""
    slow = blocks[:, SHOWING:] ** 2
    if not len(slow):
        return np.zeros(0, dtype=np.intp)
    unrest = np.sum(slow / np.maximum(np.median(slow, axis=0), 1e-300), axis=1)
    order = np.argsort(unrest, kind="stable")
    return order[unrest[order] < UNREST * np.median(unrest)]


def estimate_powers(blocks: Array) -> Array:
    """Estimate the mean squares P_k (k,) over the blocks without far outliers; zero where most squares are zero."""
    squares = blocks**2
    power = np.median(squares, axis=0) / MEDIAN_SQUARE
    previous: Mask | None = None
    for _ in range(ROUNDS):
        is_inlier = squares < CUT * power
        if previous is not None and np.array_equal(is_inlier, previous):
            break
        previous = is_inlier
        power = np.sum(squares * is_inlier, axis=0) / np.maximum(is_inlier.sum(axis=0), 1) / _KAPPA
    return np.asarray(power)


@dataclass(frozen=True)
class WhiteNoiseFit:
    """White noise in the mean squares of blocks."""

    white: float  # white, sigma: variance w of a sample and its standard error, in units of the powers
    sigma: float
    fits: bool  # whether that explains the powers
    still: bool  # whether no motion shows in them
    motion: float  # mean power of the motion over them, no less than zero, in units of the powers
    rise: float  # readout noise beside white noise of variance one, in its sigmas


def fit_white_noise(powers: Array, blocks: int) -> WhiteNoiseFit:
    """Fit white noise and a weak motion to the mean powers (k,) of `blocks` blocks, in units of the stated variance."""
    variance = SPREAD / blocks
    white, motion = _LEVEL @ (_DESIGN.T @ powers)
    residuals = powers - _DESIGN @ np.array([white, motion])
    fits = white > 0 and scipy.special.chdtrc(SHOWING - 2, float(residuals @ residuals) / (variance * white**2)) > FITS
    still = motion < MOVING * white * float(np.sqrt(_LEVEL[1, 1] * variance))
    rise = float(_RISE @ (powers - 1) / np.sqrt(_RISE @ _RISE * variance))
    error, mean_motion = float(white * np.sqrt(_LEVEL[0, 0] * variance)), max(float(motion * OF_MOTION.mean()), 0.0)
    return WhiteNoiseFit(float(white), error, bool(fits), bool(still), mean_motion, rise)


def compute_broadband_share(powers: Array, expected: float) -> float:
    """Compute the ratio of the mean excess of powers (k,) outside their strongest third to that of all, beside the expected.

    The ratio is one for white noise and 0.77 for readout noise. A body that shakes with its wheels or its appendages has its
    excess in one band; the ratio is then below 0.2, which the ends of the blocks spread.
    """
    above = powers / expected - 1
    inside = np.convolve(above, np.ones(BAND), "valid")
    return float((above.sum() - inside.max()) / (above.size - BAND) / above.mean())


def smooth_errors(powers: Array, blocks: int) -> Array:
    """Estimate the standard errors (k,) of the powers, from powers smoothed by white noise, readout noise and motion."""
    design = np.column_stack([np.ones(SHOWING), READ_OUT, OF_MOTION])
    smooth = design @ np.linalg.lstsq(design, powers, rcond=None)[0]
    return np.asarray(np.maximum(smooth, 0.2 * powers.mean()) * np.sqrt(SPREAD / blocks))


def is_even(blocks: Array) -> bool:
    """Check whether the blocks' powers scatter as those of white noise; jerks of a motion in some of them scatter more.

    The noise levels from the two quantiles of the powers must agree within `EVEN` standard errors. The covariance of the
    quantiles p < q of n values with the density f is p (1 − q)/(n f_p f_q).
    """
    power, dof = np.sum(blocks**2, axis=1), blocks.shape[1]
    chi2_quantiles = scipy.special.chdtri(dof, 1 - np.array(QUANTILES))
    low, high = np.quantile(power, QUANTILES) / chi2_quantiles
    p, q = QUANTILES
    slope_p, slope_q = 1 / (chi2_quantiles * _compute_chi2_density(chi2_quantiles, dof))  # of log level by probability
    variance = p * (1 - p) * slope_p**2 + q * (1 - q) * slope_q**2 - 2 * p * (1 - q) * slope_p * slope_q
    return bool(high < (1 + EVEN * np.sqrt(variance / len(power))) * low)


def _build_difference_covariance(order: int) -> Array:
    """Build the covariance (SAMPLES, SAMPLES) of differences of white noise of unit variance."""
    kernel = np.array([(-1.0) ** k * math.comb(order, k) for k in range(order + 1)])
    lags = np.correlate(kernel, kernel, "full")[order:]
    return np.asarray(scipy.linalg.toeplitz(np.append(lags, np.zeros(SAMPLES - lags.size))))


def _build_white_cosines() -> Array:
    """Build the matrix (SAMPLES − SLOWEST, SAMPLES) from differences to coefficients that are independent under white noise.

    The coefficients run from the highest frequency down.
    """
    cosines = scipy.fft.dct(np.eye(SAMPLES), axis=0, norm="ortho")[SLOWEST:][::-1]
    factor = np.linalg.cholesky(cosines @ _build_difference_covariance(ORDER) @ cosines.T)
    return np.asarray(scipy.linalg.solve_triangular(factor, cosines, lower=True))


def _compute_process_power(order: int) -> Array:
    """Compute the powers (SHOWING,) of a process whose differences of order ORDER are white noise's of the given order."""
    return np.diag(WHITE_COSINES @ _build_difference_covariance(order) @ WHITE_COSINES.T)[:SHOWING].copy()


def _compute_chi2_density(x: Array | float, dof: int) -> Array:
    """Compute the density of χ² with some degrees of freedom."""
    half = 0.5 * dof
    return np.asarray(np.exp((half - 1) * np.log(x) - 0.5 * np.asarray(x) - half * np.log(2) - scipy.special.gammaln(half)))


def _compute_truncation_factors() -> tuple[float, float]:
    """Compute κ and V of the mean of the squares below CUT."""
    f1, f3, f5 = (float(scipy.special.chdtr(n, CUT)) for n in (1, 3, 5))
    kappa = f3 / f1
    slope = f3 - (CUT - kappa) * CUT * float(_compute_chi2_density(CUT, 1))
    return kappa, (3 * f5 - f3**2 / f1) / slope**2


WHITE_COSINES = _build_white_cosines()
BACK = WHITE_COSINES[:SHOWING] @ np.diff(
    np.eye(SAMPLES + ORDER), ORDER, axis=0
)  # (showing, samples + order) from samples to cosines
READ_OUT = _compute_process_power(ORDER + 1)  # R_k
OF_MOTION = _compute_process_power(ORDER - 2)  # M_k
_KAPPA, SPREAD = _compute_truncation_factors()
_DESIGN = np.column_stack([np.ones(SHOWING), OF_MOTION])
_LEVEL = np.linalg.inv(_DESIGN.T @ _DESIGN)
_RISE = np.linalg.pinv(np.column_stack([READ_OUT, OF_MOTION]))[0]  # q² from powers less than what is stated
