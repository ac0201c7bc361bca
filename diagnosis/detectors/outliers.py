"""Outliers of the readings: single samples far outside of their neighbours.

The samples on either side tell what a reading should be, with the weights that do it best in this recording: as far as it is
stationary they are those of the inverse of its covariance. They are estimated for the samples at rest and for those in motion.
A thrust or a torque that sets in, after which the rate goes on along another line, departs from its neighbours as well: a spike
explains more of the readings than a step and a bend before it or after it. Spikes come at random, alone on their gyro and with
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
SIDE = 6  # samples to either side that tell a spike from a step
CLEARLY = 4.0  # squared sigmas by which a spike fits better
EXPLAINED = 1e-3  # p-value of what it leaves of the readings around, at least: a jolt rings on
AS_FAR = 0.75  # of its deviation, that a spike is off the curve through its neighbours
BESIDE = 0.2  # of a spike, that may be left beside it
LEAST_POWER = 1e-3  # of the deviations, at a frequency that the motion fills
# readings that tell the weights of those around them
FEWEST_FITTED = 300
MOST_FITTED = 200_000
NEARBY = 101  # readings over which the size of their usual error is taken
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

    places: Mask  # outliers
    off: Array  # how far each reading is off its neighbours, rad/s
    limit: float  # from which on one counts, where the motion adds nothing
    odd: Mask  # readings that are far off, also in a step
    hidden: Array  # how far off an outlier must be to be visible in the motion there; zero at rest


@dataclass(frozen=True)
class OutlierFit:
    """Outliers of all gyros together."""

    axis: int | None  # gyro that has them alone; None for all
    size: float  # size, sigma: mean height, rad/s
    sigma: float
    seen: float  # mean height of those above the limit, rad/s
    fraction: float  # share of the samples


def find_outliers(stream: Stream, quiet: Mask, noise: Array, steps: Array, event_p: float) -> tuple[Findings, Stream]:
    """Find single samples far outside of their neighbours, and bridge them; noise and coarse lattices (3,) in rad/s."""
    found, judged = _find_of_gyros(stream, quiet, noise, steps)
    counts = [int(one.places.sum()) for one in found]
    n = max(int(judged.sum()), 1)
    chance = n * 2 * float(scipy.special.ndtr(-LIMIT)) * 1.2
    expected = [chance + ALIKE * float((one.odd & ~one.places).sum()) for one in found]
    p_values = [_compute_p_value(count, usual) for count, usual in zip(counts, expected, strict=True)]
    text = f"of {n} samples are off by more than {LIMIT:g} sigmas"
    tests = tuple(
        SampleTest("outliers", AXES[k], counts[k], expected[k], p, "outliers", f"{counts[k]} {text}")
        for k, p in enumerate(p_values)
    )
    p, clearest = _compute_p_value(sum(counts), sum(expected)), int(np.argmin(p_values))
    if 3 * p_values[clearest] < event_p <= p:
        # Outliers of one gyro of three: those of the others are the chance that the motion makes.
        p = 3 * p_values[clearest]
        found = [one if k == clearest else replace(one, places=np.zeros_like(one.places)) for k, one in enumerate(found)]
    if p >= event_p or sum(int(one.places.sum()) for one in found) < 2:
        return Findings(tests), stream
    fit = _fit_heights(found, judged, noise)
    symptom = Symptom(
        "outliers", None if fit.axis is None else AXES[fit.axis], float(np.rad2deg(fit.size)), "deg/s",
        float(np.rad2deg(fit.sigma)), {"fraction": fit.fraction}, p,
    )  # fmt: skip
    return Findings(tests, (symptom,)), _repair(stream, found, fit)


def _compute_p_value(count: int, expected: float) -> float:
    """Compute the p-value of as many outliers, of a Poisson distribution; one without any."""
    return max(float(scipy.special.pdtrc(count - 1, expected)), IMPOSSIBLE) if count else 1.0


def _fit_heights(found: list[Outliers], judged: Mask, noise: Array) -> OutlierFit:
    """Fit the law of the heights: exponential above a limit, or scattered about a mean."""
    counts = [int(one.places.sum()) for one in found]
    total, strongest = sum(counts), int(np.argmax(counts))
    # Two of two on one axis are three times likelier if only that has them.
    alone = counts[strongest] >= 0.95 * total
    together, limit = np.concatenate([one.off[one.places] for one in found]), min(one.limit for one in found)
    beyond = together - limit
    uneven = beyond.std() > 0.5 * beyond.mean()
    # The scatter of few says little. Of n exponential ones the smallest is beyond the limit by an n-th of the mean.
    if total < MANY:
        uneven = uneven or total * beyond.min() < ALL_ALIKE * beyond.mean()
    exponential = total > FEW and uneven
    # Of outliers of all sizes what exceeds a limit has, for exponential ones, the mean of all; the others are hidden.
    seen = float(beyond.mean() if exponential else together.mean())
    size, error = seen, np.hypot(together.std(), noise.mean()) / np.sqrt(total)
    if exponential:
        error = seen * np.sqrt(1 / total + 0.1**2)
    elif total <= FEW:  # so few may be all there are, or the highest of many
        size = 0.5 * (seen + float(beyond.mean()))
        error = np.hypot(error, max(seen - size, size / np.sqrt(total)))
    high = max(AS_HIGH * seen, float(together.min()))
    shown = sum(int((judged & (one.hidden <= high)).sum()) for one in ([found[strongest]] if alone else found))
    fraction = total / max(shown, total) * (float(np.exp(min(limit / seen, 5.0))) if exponential else 1.0)
    return OutlierFit(strongest if alone else None, size, float(error), seen, float(fraction))


def _find_of_gyros(stream: Stream, quiet: Mask, noise: Array, steps: Array) -> tuple[list[Outliers], Mask]:
    """Find the outliers of each gyro; also the samples that were judged."""
    used, follows = stream.used, mark_consecutive_samples(stream.recording, quiet)
    whole = scipy.ndimage.binary_erosion(used & mark_consecutive_samples(stream.recording, used), iterations=SIDE)
    # Beside a sample that was bridged the motion is known less well than the noise says.
    known = ~scipy.ndimage.binary_dilation(stream.filled, iterations=len(BETWEEN) // 2)
    resting = quiet & follows & np.roll(follows, -1) & known
    if resting.sum() < RESTING * used.sum():
        resting = np.zeros_like(resting)
    turning = whole & known & ~resting
    found, moving = [], []
    for axis in range(3):
        x, level, step = stream.rates[:, axis], float(noise[axis]), float(steps[axis])
        parts = [(mask, find_single_samples(x, mask, level, step)) for mask in (resting, turning) if mask.any()]
        if not parts:
            parts = [(turning, find_single_samples(x, turning, level, step))]
        one = parts[-1][1]
        moving.append(one.places)
        if len(parts) > 1:
            rest = parts[0][1]
            one = Outliers(
                rest.places | one.places, np.where(resting, rest.off, one.off), rest.limit, one.odd,
                np.where(resting, 0.0, one.hidden),
            )  # fmt: skip
        found.append(one)
    # Outliers of two gyros at once while the body moves are a jolt of it.
    near = sum(scipy.ndimage.binary_dilation(one.places, iterations=SIDE).astype(int) for one in found)
    jolts = [one & (near > 1) for one in moving]
    return [replace(one, places=one.places & ~jolt) for one, jolt in zip(found, jolts, strict=True)], resting | turning


def _repair(stream: Stream, found: list[Outliers], fit: OutlierFit) -> Stream:
    """Bridge the outliers, and what stands as far out of a motion; where that hides them, they are noise."""
    t_s, rates, density, filled = stream.recording.gyro.t_s, stream.rates.copy(), stream.density.copy(), stream.filled.copy()
    for axis, one in enumerate(found):
        if not one.places.any():
            continue
        x = rates[:, axis]
        bad = one.places | (one.odd & (one.off > AS_HIGH * fit.seen))
        rates[bad, axis] = np.interp(t_s[bad], t_s[~bad], x[~bad])
        filled |= bad
        power = fit.fraction * float(np.mean(one.off[one.places] ** 2)) * stream.recording.gyro.sample_s
        density[(one.hidden > AS_HIGH * fit.seen) & ~bad, axis] += power
    return replace(stream, rates=rates, density=density, filled=filled)


def find_single_samples(x: Array, judged: Mask, noise: float, step: float) -> Outliers:
    """Find single samples of readings x (n,) off what their neighbours tell, among those judged; noise and lattice in rad/s."""
    judged = judged.copy()
    judged[:SIDE] = judged[-SIDE:] = False
    weights = _fit_weights(x, judged)
    off = x - scipy.ndimage.convolve1d(x, np.concatenate([weights[::-1], [0.0], weights]), mode="nearest")
    usual = noise * float(np.sqrt(1 + 2 * weights @ weights))
    level = np.maximum(scipy.ndimage.median_filter(np.abs(off), NEARBY, mode="nearest") / 0.6745, usual)
    least = LIMIT * level + step
    # Beside a spike a reading is off as well, by its share of the spike.
    highest = np.abs(off) >= scipy.ndimage.maximum_filter1d(np.abs(off), 2 * SIDE + 1, mode="nearest")
    far = judged & highest & (np.abs(off) > least)
    single, known = _is_single(x, np.where(far, off, 0.0), noise), _Shapes(weights)
    most = float(scipy.special.chdtri(2 * SIDE, EXPLAINED))
    for k in np.flatnonzero(single).tolist():
        odds, left = known.compare(off[k - SIDE : k + SIDE + 1])
        single[k] = odds > CLEARLY * level[k] ** 2 and left < most * level[k] ** 2
    return Outliers(single, np.abs(off), LIMIT * usual + step, far, least)


def _is_single(x: Array, deviation: Array, noise: float) -> Mask:
    """Tell whether a sample that deviates is alone off the quintic through three samples on either side of each.

    A spike is about as far off its own quintic. Those of the samples beside it show the spike with the weights that it has in
    them, and nothing else. A fast and jerky motion may be as far off its quintics, but not in this pattern.
    """
    off = x - scipy.ndimage.convolve1d(x, BETWEEN, mode="nearest")
    half, limit = len(BETWEEN) // 2, LIMIT * noise
    found = (off * deviation > 0) & (np.abs(off) > np.maximum(AS_FAR * np.abs(deviation), limit))
    spread = float(np.sqrt(1 + BETWEEN @ BETWEEN))
    pattern = np.zeros(4 * half + 1)
    pattern[half : 3 * half + 1] = -BETWEEN
    pattern[2 * half] = 1.0
    for k in np.flatnonzero(found).tolist():
        low, high = max(k - 2 * half, 0), min(k + 2 * half + 1, x.size)
        left = off[low:high] - off[k] * pattern[low - k + 2 * half : high - k + 2 * half]
        found[k] = np.abs(left).max() < max(BESIDE * abs(off[k]), limit * spread)
    return np.asarray(found)


def _fit_weights(x: Array, judged: Mask) -> Array:
    """Fit the (`side`,) weights of readings at each distance, on both sides, that predict a reading best; their sum is ½.

    White noise wants the mean of many, and a fast motion a curve through few; the readings tell what theirs want.
    """
    places = np.flatnonzero(judged)
    places = places[:: max(1, -(-places.size // MOST_FITTED))]
    if places.size < FEWEST_FITTED:
        half = len(BETWEEN) // 2
        return np.pad(BETWEEN[half + 1 :], (0, SIDE - half))
    sides = np.column_stack([x[places - lag] + x[places + lag] - 2 * x[places] for lag in range(1, SIDE + 1)])
    y, sides = -0.5 * sides[:, 0], sides[:, 1:] - sides[:, :1]
    for _ in range(2):
        others = np.asarray(np.linalg.lstsq(sides, y, rcond=None)[0])
        left = np.abs(y - sides @ others)
        kept = left <= LIMIT * np.median(left) / 0.6745
        y, sides = y[kept], sides[kept]
    return np.append(0.5 - others.sum(), others)


class _Shapes:
    """Deviations around a sample: how much of them a spike explains, and how much a step and a bend beside it.

    With K the filter that takes from a reading what those around tell of it, whose usual error is L, the readings x have the
    inverse covariance K/L², and deviations Kx the covariance L² K. So a shape u, which they show as s = Ku, explains
    (sᵀ K⁻¹ Kx)² / sᵀ K⁻¹ s, in squared deviations, where K is cut to the samples that are looked at.
    """

    def __init__(self, weights: Array) -> None:
        K = np.concatenate([-weights[::-1], [1.0], -weights])
        t = np.arange(-2.0 * SIDE, 2 * SIDE + 1)
        after = [t >= late for late in (0, 1)]  # a step at the sample or just after it
        shapes = [t[:, None] == 0.0, *(np.column_stack([one, one * t]) for one in after)]
        seen = [scipy.ndimage.convolve1d(one.astype(float), K, axis=0)[SIDE:-SIDE] for one in shapes]
        values, vectors = np.linalg.eigh(scipy.linalg.toeplitz(np.concatenate([[1.0], -weights, np.zeros(SIDE)])))
        inverse = vectors / np.maximum(values, LEAST_POWER) @ vectors.T
        self.all = inverse
        self.spike, *self.steps = (inverse @ one @ np.linalg.inv(one.T @ inverse @ one) @ one.T @ inverse for one in seen)

    def compare(self, off: Array) -> tuple[float, float]:
        """Compute what a spike explains beyond the better of a step and a bend before or after it, and what it leaves."""
        explained = float(off @ self.spike @ off)
        return explained - max(float(off @ step @ off) for step in self.steps), float(off @ self.all @ off) - explained
