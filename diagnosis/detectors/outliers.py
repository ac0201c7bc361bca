"""Outliers of the readings: single samples far outside of their neighbours.

The samples on either side predict a reading with the weights that are best in this recording: of a stationary series they are
those of the inverse of its covariance. They are estimated for the samples at rest and for those in motion. At the onset of a
thrust or a torque, the rate deviates from its neighbours as well; of a spike, the spike must explain more of the readings than
a step and a bend before it or after it. Spikes come at random, alone on their gyro and with
heights that have a law; an outlier of several gyros at once in motion is a jolt of the body.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.ndimage
import scipy.special

from diagnosis.arrays import AXES
from diagnosis.detectors.sample_report import IMPOSSIBLE, Findings, SampleTest, Stream, Symptom, mark_consecutive_samples
from gyrocal.arrays import Array, Mask

BETWEEN = np.array([1.0, -6.0, 15.0, 0.0, 15.0, -6.0, 1.0]) / 20  # of a quintic through three samples on either side

LIMIT = 6.0  # noise sigmas of an outlier; one sample in 5e8 under M0
SIDE = 6  # samples to either side that distinguish a spike from a step
CLEARLY = 4.0  # squared sigmas by which a spike fits better
EXPLAINED = 1e-3  # p-value of what it leaves of the readings around, at least: a jolt rings on
AS_FAR = 0.75  # of its deviation, that a spike deviates from the curve through its neighbours
BESIDE = 0.2  # of a spike, that may be left beside it
LEAST_POWER = 1e-3  # of the deviations, at a frequency that the motion fills
# readings to which the weights of those around them are fitted
FEWEST_FITTED = 300
MOST_FITTED = 200_000
NEARBY = 101  # readings over which the median deviation is taken
RESTING = 0.3  # share of the samples in which the body rests, below which all are taken as a motion
# of the steps and bends of a motion, which may pass for spikes: a body that is jolted all the time has hundreds
ALIKE = 0.02
AS_HIGH = 0.4  # of the usual spike
FEW = 5  # outliers, of which heights show no law
MANY = 25  # of which the scatter of heights shows whether they are exponential
ALL_ALIKE = 3.0  # mean smallest heights of exponential outliers, up to which that of some may be one


@dataclass(frozen=True)
class Outliers:
    """Outliers of one gyro; masks and arrays (n,) of all samples."""

    mask: Mask  # outliers
    deviation: Array  # absolute deviation of each reading from the prediction by its neighbours, rad/s
    limit: float  # least deviation of an outlier where the motion adds nothing, rad/s
    is_far: Mask  # readings beyond the threshold, also in a step
    threshold: Array  # least deviation of an outlier that is visible in the motion there, rad/s; zero at rest


@dataclass(frozen=True)
class OutlierFit:
    """Law of the heights of all gyros' outliers."""

    axis: int | None  # gyro that has them alone; None for all
    size: float  # size, sigma: mean height, rad/s
    sigma: float
    visible_mean: float  # mean height of the outliers above the limit, rad/s
    fraction: float  # share of the samples


def find_outliers(stream: Stream, quiet: Mask, noise: Array, steps: Array, event_p: float) -> tuple[Findings, Stream]:
    """Find single samples far outside of their neighbours, and bridge them; noise and lattice steps (3,) in rad/s."""
    by_gyro, judged = _find_of_gyros(stream, quiet, noise, steps)
    counts = [int(gyro.mask.sum()) for gyro in by_gyro]
    n = max(int(judged.sum()), 1)
    chance = n * 2 * float(scipy.special.ndtr(-LIMIT)) * 1.2
    expected = [chance + ALIKE * float((gyro.is_far & ~gyro.mask).sum()) for gyro in by_gyro]
    p_values = [_compute_p_value(count, mean) for count, mean in zip(counts, expected, strict=True)]
    text = f"of {n} samples are off by more than {LIMIT:g} sigmas"
    tests = tuple(
        SampleTest("outliers", AXES[k], counts[k], expected[k], p, "outliers", f"{counts[k]} {text}")
        for k, p in enumerate(p_values)
    )
    p, clearest = _compute_p_value(sum(counts), sum(expected)), int(np.argmin(p_values))
    if 3 * p_values[clearest] < event_p <= p:
        # One gyro of three departs: outliers of the others come from the motion by chance.
        p = 3 * p_values[clearest]
        by_gyro = [gyro if k == clearest else replace(gyro, mask=np.zeros_like(gyro.mask)) for k, gyro in enumerate(by_gyro)]
    if p >= event_p or sum(int(gyro.mask.sum()) for gyro in by_gyro) < 2:
        return Findings(tests), stream
    fit = _fit_heights(by_gyro, judged, noise)
    symptom = Symptom(
        "outliers", None if fit.axis is None else AXES[fit.axis], float(np.rad2deg(fit.size)), "deg/s",
        float(np.rad2deg(fit.sigma)), {"fraction": fit.fraction}, p,
    )  # fmt: skip
    return Findings(tests, (symptom,)), _repair(stream, by_gyro, fit)


def _compute_p_value(count: int, expected: float) -> float:
    """Compute the p-value of `count` outliers under a Poisson distribution; one without any."""
    return max(float(scipy.special.pdtrc(count - 1, expected)), IMPOSSIBLE) if count else 1.0


def _fit_heights(by_gyro: list[Outliers], judged: Mask, noise: Array) -> OutlierFit:
    """Fit the law of the heights: exponential above a limit, or scattered about a mean."""
    counts = [int(gyro.mask.sum()) for gyro in by_gyro]
    total, strongest = sum(counts), int(np.argmax(counts))
    # Two of two on one axis are three times likelier if only that has them.
    alone = counts[strongest] >= 0.95 * total
    heights, limit = np.concatenate([gyro.deviation[gyro.mask] for gyro in by_gyro]), min(gyro.limit for gyro in by_gyro)
    excess = heights - limit
    uneven = excess.std() > 0.5 * excess.mean()
    # The scatter of few heights is uncertain. The smallest of n exponential ones exceeds the limit by an n-th of the mean.
    if total < MANY:
        uneven = uneven or total * excess.min() < ALL_ALIKE * excess.mean()
    exponential = total > FEW and uneven
    # The excess of exponential heights over any limit has the mean of all heights; outliers below the limit are hidden.
    visible_mean = float(excess.mean() if exponential else heights.mean())
    size, error = visible_mean, np.hypot(heights.std(), noise.mean()) / np.sqrt(total)
    if exponential:
        error = visible_mean * np.sqrt(1 / total + 0.1**2)
    elif total <= FEW:  # so few may be all there are, or the highest of many
        size = 0.5 * (visible_mean + float(excess.mean()))
        error = np.hypot(error, max(visible_mean - size, size / np.sqrt(total)))
    detectable = max(AS_HIGH * visible_mean, float(heights.min()))
    counted = [by_gyro[strongest]] if alone else by_gyro
    searched = sum(int((judged & (gyro.threshold <= detectable)).sum()) for gyro in counted)
    fraction = total / max(searched, total) * (float(np.exp(min(limit / visible_mean, 5.0))) if exponential else 1.0)
    return OutlierFit(strongest if alone else None, size, float(error), visible_mean, float(fraction))


def _find_of_gyros(stream: Stream, quiet: Mask, noise: Array, steps: Array) -> tuple[list[Outliers], Mask]:
    """Find the outliers of each gyro; also the mask (n,) of the samples that were searched."""
    used, follows = stream.used, mark_consecutive_samples(stream.recording, quiet)
    surrounded = scipy.ndimage.binary_erosion(used & mark_consecutive_samples(stream.recording, used), iterations=SIDE)
    # Beside a sample that was bridged the motion is known less well than the noise says.
    is_reliable = ~scipy.ndimage.binary_dilation(stream.filled, iterations=len(BETWEEN) // 2)
    resting = quiet & follows & np.roll(follows, -1) & is_reliable
    if resting.sum() < RESTING * used.sum():
        resting = np.zeros_like(resting)
    turning = surrounded & is_reliable & ~resting
    by_gyro, moving = [], []
    for axis in range(3):
        x, level, step = stream.rates[:, axis], float(noise[axis]), float(steps[axis])
        parts = [(mask, find_single_samples(x, mask, level, step)) for mask in (resting, turning) if mask.any()]
        if not parts:
            parts = [(turning, find_single_samples(x, turning, level, step))]
        gyro = parts[-1][1]  # in motion, unless the body only rests
        moving.append(gyro.mask)
        if len(parts) > 1:
            at_rest = parts[0][1]
            gyro = Outliers(
                at_rest.mask | gyro.mask, np.where(resting, at_rest.deviation, gyro.deviation), at_rest.limit, gyro.is_far,
                np.where(resting, 0.0, gyro.threshold),
            )  # fmt: skip
        by_gyro.append(gyro)
    # Outliers of two gyros at once while the body moves are a jolt of it.
    gyros_nearby = sum(scipy.ndimage.binary_dilation(gyro.mask, iterations=SIDE).astype(int) for gyro in by_gyro)
    jolts = [gyro & (gyros_nearby > 1) for gyro in moving]
    return [replace(gyro, mask=gyro.mask & ~jolt) for gyro, jolt in zip(by_gyro, jolts, strict=True)], resting | turning


def _repair(stream: Stream, by_gyro: list[Outliers], fit: OutlierFit) -> Stream:
    """Bridge the outliers and readings that deviate as far; where a motion hides outliers, add their noise instead."""
    t_s, rates, density, filled = stream.recording.gyro.t_s, stream.rates.copy(), stream.density.copy(), stream.filled.copy()
    for axis, outliers in enumerate(by_gyro):
        if not outliers.mask.any():
            continue
        x = rates[:, axis]
        bad = outliers.mask | (outliers.is_far & (outliers.deviation > AS_HIGH * fit.visible_mean))
        rates[bad, axis] = np.interp(t_s[bad], t_s[~bad], x[~bad])
        filled |= bad
        power = fit.fraction * float(np.mean(outliers.deviation[outliers.mask] ** 2)) * stream.recording.gyro.sample_s
        density[(outliers.threshold > AS_HIGH * fit.visible_mean) & ~bad, axis] += power
    return replace(stream, rates=rates, density=density, filled=filled)


def find_single_samples(x: Array, judged: Mask, noise: float, step: float) -> Outliers:
    """Find single samples of readings x (n,), among those judged, off the prediction by their neighbours; all in rad/s."""
    judged = judged.copy()
    judged[:SIDE] = judged[-SIDE:] = False
    weights = _fit_weights(x, judged)
    deviation = x - scipy.ndimage.convolve1d(x, np.concatenate([weights[::-1], [0.0], weights]), mode="nearest")
    white = noise * float(np.sqrt(1 + 2 * weights @ weights))
    local = np.maximum(scipy.ndimage.median_filter(np.abs(deviation), NEARBY, mode="nearest") / 0.6745, white)
    threshold = LIMIT * local + step
    # The neighbours of a spike deviate as well, by its weight in their predictions: only the largest deviation counts.
    highest = np.abs(deviation) >= scipy.ndimage.maximum_filter1d(np.abs(deviation), 2 * SIDE + 1, mode="nearest")
    far = judged & highest & (np.abs(deviation) > threshold)
    single, shapes = _is_single(x, np.where(far, deviation, 0.0), noise), _Shapes(weights)
    most = float(scipy.special.chdtri(2 * SIDE, EXPLAINED))
    for k in np.flatnonzero(single).tolist():
        advantage, unexplained = shapes.compare(deviation[k - SIDE : k + SIDE + 1])
        single[k] = advantage > CLEARLY * local[k] ** 2 and unexplained < most * local[k] ** 2
    return Outliers(single, np.abs(deviation), LIMIT * white + step, far, threshold)


def _is_single(x: Array, deviation: Array, noise: float) -> Mask:
    """Mark the deviating samples (n,) that are spikes by the quintics through three samples on either side of each sample.

    A spike deviates about as far from its own quintic. The samples beside it deviate from their quintics by the weight of the
    spike in these, and by nothing else. A fast and jerky motion may deviate as far, but not in this pattern.
    """
    misfit = x - scipy.ndimage.convolve1d(x, BETWEEN, mode="nearest")
    half, limit = len(BETWEEN) // 2, LIMIT * noise
    is_single = (misfit * deviation > 0) & (np.abs(misfit) > np.maximum(AS_FAR * np.abs(deviation), limit))
    spread = float(np.sqrt(1 + BETWEEN @ BETWEEN))
    pattern = np.zeros(4 * half + 1)
    pattern[half : 3 * half + 1] = -BETWEEN
    pattern[2 * half] = 1.0
    for k in np.flatnonzero(is_single).tolist():
        low, high = max(k - 2 * half, 0), min(k + 2 * half + 1, x.size)
        residual = misfit[low:high] - misfit[k] * pattern[low - k + 2 * half : high - k + 2 * half]
        is_single[k] = np.abs(residual).max() < max(BESIDE * abs(misfit[k]), limit * spread)
    return np.asarray(is_single)


def _fit_weights(x: Array, judged: Mask) -> Array:
    """Fit the weights (SIDE,) of readings at each distance, on both sides, that predict a reading best; their sum is ½.

    Under white noise the mean of many readings is best, in a fast motion a curve through few.
    """
    places = np.flatnonzero(judged)
    places = places[:: max(1, -(-places.size // MOST_FITTED))]
    if places.size < FEWEST_FITTED:
        half = len(BETWEEN) // 2
        return np.pad(BETWEEN[half + 1 :], (0, SIDE - half))
    sides = np.column_stack([x[places - lag] + x[places + lag] - 2 * x[places] for lag in range(1, SIDE + 1)])
    y, sides = -0.5 * sides[:, 0], sides[:, 1:] - sides[:, :1]
    for _ in range(2):
        outer = np.asarray(np.linalg.lstsq(sides, y, rcond=None)[0])
        residuals = np.abs(y - sides @ outer)
        is_inlier = residuals <= LIMIT * np.median(residuals) / 0.6745
        y, sides = y[is_inlier], sides[is_inlier]
    return np.append(0.5 - outer.sum(), outer)


class _Shapes:
    """Quadratic forms of the deviations around a sample: the χ² that a spike, a step and a bend, or all of them explain.

    With K the filter that subtracts from a reading its prediction by those around, whose usual error is L, the readings x
    have the inverse covariance K/L², and the deviations Kx the covariance L² K. A shape u, s = Ku in the deviations, then
    explains (sᵀ K⁻¹ Kx)² / sᵀ K⁻¹ s, in squared deviations, where K is cut to the samples around.
    """

    def __init__(self, weights: Array) -> None:
        K = np.concatenate([-weights[::-1], [1.0], -weights])
        t = np.arange(-2.0 * SIDE, 2 * SIDE + 1)
        steps = [t >= start for start in (0, 1)]  # a step at the sample or just after it
        shapes = [t[:, None] == 0.0, *(np.column_stack([step, step * t]) for step in steps)]
        filtered = [scipy.ndimage.convolve1d(shape.astype(float), K, axis=0)[SIDE:-SIDE] for shape in shapes]
        values, vectors = np.linalg.eigh(scipy.linalg.toeplitz(np.concatenate([[1.0], -weights, np.zeros(SIDE)])))
        inverse = vectors / np.maximum(values, LEAST_POWER) @ vectors.T
        self.all = inverse
        self.spike, *self.steps = (inverse @ s @ np.linalg.inv(s.T @ inverse @ s) @ s.T @ inverse for s in filtered)

    def compare(self, deviations: Array) -> tuple[float, float]:
        """Compute the χ² that a spike explains beyond the better step and bend at or after it, and the χ² that it leaves."""
        by_spike, total = (float(deviations @ form @ deviations) for form in (self.spike, self.all))
        by_step = max(float(deviations @ form @ deviations) for form in self.steps)
        return by_spike - by_step, total - by_spike
