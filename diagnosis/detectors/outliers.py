"""Single samples far outside of their neighbours.

Where the body rests, a reading is compared with the median around it. Where it moves, the samples on either side tell what a
reading should be, with the weights that do it best in this recording: as far as it is stationary they are those of the inverse
of its covariance. A thrust or a torque that sets in, after which the rate goes on along another line, departs from that, too:
a spike explains more of the readings than a step and a bend before it or after it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.ndimage
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.likeness import of_heights, of_places, of_times, some
from diagnosis.detectors.report import (
    AXES,
    IMPOSSIBLE,
    SampleReport,
    SampleTest,
    Symptom,
    circumstances,
    consecutive,
    since_start,
)
from gyrocal.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

AROUND = 41  # samples whose median an outlier's neighbours are compared with
BESIDE = (-3, -2, -1, 1, 2, 3)  # samples from an outlier
OUTLIER = 6.0  # noise sigmas; one sample in 5e8 under M0
RESTING = 0.3  # share of the samples in which the body rests, below which all are looked at as a motion
SIDE = 6  # samples to either side that tell a spike from a step
CLEARLY = 4.0  # squared sigmas by which a spike fits better
NO_MORE = float(scipy.stats.chi2.isf(1e-3, 2 * SIDE))  # squared sigmas that it leaves of the readings around: a jolt rings on
BETWEEN = np.array([1.0, -6.0, 15.0, 0.0, 15.0, -6.0, 1.0]) / 20  # of a quintic through three samples on either side
AS_FAR = 0.75  # of its deviation, that a spike is off the curve through its neighbours
ALIKE = 0.02  # of the steps and bends of a motion, which may pass for spikes: a body that is jolted all the time has hundreds
AS_HIGH = 0.4  # of the usual spike
ALONE = 0.2  # of a spike, that may be left beside it
LEAST_POWER = 1e-3  # of the deviations, at a frequency that the motion fills
FEWEST_FITTED, MOST_FITTED = 300, 200_000  # readings that tell the weights of those around them
NEARBY = 101  # over which the size of their usual error is taken


@dataclass(frozen=True)
class Looked:
    """What one gyro's readings show of outliers; masks and arrays of all samples.

    Attributes
    ----------
    still, moving : outliers while the body rests, and while it moves
    off : how far each reading is off its neighbours, rad/s
    limit : from which on one counts, where the motion adds nothing
    odd : readings in motion that are far off, also in a step
    hidden : how far off an outlier must be to show in the motion there; zero at rest
    """

    still: Mask
    moving: Mask
    off: Array
    limit: float
    odd: Mask
    hidden: Array

    @property
    def places(self) -> Mask:
        """All outliers."""
        return self.still | self.moving


def spikes(report: SampleReport, recording: Recording, quiet: Mask, used: Mask, noise: Array, steps: Array) -> None:
    """Single samples far outside, and the tails of all."""
    looked, asked = _looked(report, recording, quiet, used, noise, steps)
    counts = [int(one.places.sum()) for one in looked]
    n = max(int(asked.sum()), 1)
    chance = n * 2 * float(scipy.stats.norm.sf(OUTLIER)) * 1.2
    expected = [chance + ALIKE * float((one.odd & ~one.moving).sum()) for one in looked]
    chances = [_chance(count, usual) for count, usual in zip(counts, expected, strict=True)]
    for axis, p in enumerate(chances):
        report.tests.append(
            SampleTest(
                "outliers", AXES[axis], counts[axis], expected[axis], p, "outliers",
                f"{counts[axis]} of {n} samples are off by more than {OUTLIER:g} sigmas",
            )
        )  # fmt: skip
    p, clearest = _chance(sum(counts), sum(expected)), int(np.argmin(chances))
    if 3 * chances[clearest] < report.event_p <= p:
        # One gyro of three speaks alone: what the motion of the others passes for is chance.
        p, looked = 3 * chances[clearest], _only(looked, clearest)
        counts = [int(one.places.sum()) for one in looked]
    total = sum(counts)
    if p >= report.event_p or total < 2:
        return
    strongest = int(np.argmax(counts))
    # Two of two on one axis are three times likelier if only that has them.
    alone = counts[strongest] >= 0.95 * total
    sizes = [one.off[one.places] for one in looked]
    together, limit = np.concatenate(sizes), min(one.limit for one in looked)
    beyond = together - limit
    exponential = total > 5 and beyond.std() > 0.5 * beyond.mean()
    # Of outliers of all sizes what exceeds a limit has, for exponential ones, the mean of all; the others are hidden.
    seen = float(beyond.mean() if exponential else together.mean())
    error = seen * np.sqrt(1 / total + 0.1**2) if exponential else np.hypot(together.std(), noise.mean()) / np.sqrt(total)
    high = max(AS_HIGH * seen, float(together.min()))
    shown = sum(int((asked & (one.hidden <= high)).sum()) for one in ([looked[strongest]] if alone else looked))
    fraction = total / max(shown, total) * (float(np.exp(min(limit / seen, 5.0))) if exponential else 1.0)
    report.symptoms.append(
        Symptom(
            "outliers", AXES[strongest] if alone else None, float(np.rad2deg(seen)), "deg/s", float(np.rad2deg(error)),
            {"fraction": float(fraction)}, p, likeness=_likeness(recording, looked, asked),
        )
    )  # fmt: skip
    if any(one.still.any() for one in looked):
        _neighbours(report, [one.still for one in looked], noise)
    for axis, one in enumerate(looked):
        if counts[axis]:
            _taken_out(report, recording, axis, one, seen, fraction)


def _only(looked: list[Looked], axis: int) -> list[Looked]:
    """The same without the outliers of other gyros."""
    none = np.zeros_like(looked[axis].still)
    return [one if number == axis else replace(one, still=none, moving=none) for number, one in enumerate(looked)]


def _chance(count: int, expected: float) -> float:
    """P-value of as many outliers, of a Poisson distribution; one without any."""
    return max(float(scipy.stats.poisson.sf(count - 1, expected)), IMPOSSIBLE) if count else 1.0


def _looked(
    report: SampleReport, recording: Recording, quiet: Mask, used: Mask, noise: Array, steps: Array
) -> tuple[list[Looked], Mask]:
    """What each gyro shows, and which samples were asked."""
    whole = scipy.ndimage.binary_erosion(used & consecutive(recording, used), iterations=SIDE)
    # Beside a sample that was bridged the motion is known less well than the noise says.
    known = ~scipy.ndimage.binary_dilation(report.filled, iterations=len(BETWEEN) // 2)
    resting = quiet & consecutive(recording, quiet) & np.roll(consecutive(recording, quiet), -1) & known
    if resting.sum() < RESTING * used.sum():
        resting = np.zeros_like(resting)
    # A large outlier is no rest, so that what is left is looked at as a motion.
    turning = whole & known & ~resting
    found = []
    for axis in range(3):
        x, level, step = report.rates[:, axis], float(noise[axis]), float(steps[axis])
        still, off, limit = _at_rest(x, resting, level, step)
        moving, beside, most, odd, least = _in_motion(x, turning, level, step)
        off = np.abs(np.where(odd, beside, off))
        found.append(Looked(still, moving, off, limit if resting.any() else most, odd, np.where(resting, 0.0, least)))
    # What two gyros show at once while the body moves is a jolt of it.
    near = sum(scipy.ndimage.binary_dilation(one.places, iterations=SIDE).astype(int) for one in found)
    return [replace(one, moving=one.moving & (near == 1)) for one in found], resting | turning


def _taken_out(report: SampleReport, recording: Recording, axis: int, one: Looked, seen: float, fraction: float) -> None:
    """Bridge the outliers of a gyro, and what stands as far out of a motion; where that hides them, they are noise."""
    t, x = recording.gyro.t_s, report.rates[:, axis]
    bad = one.places | (one.odd & (one.off > AS_HIGH * seen))
    report.rates[bad, axis] = np.interp(t[bad], t[~bad], x[~bad])
    report.filled |= bad
    power = fraction * float(np.mean(one.off[one.places] ** 2)) * recording.gyro.sample_s
    report.density[(one.hidden > AS_HIGH * seen) & ~bad, axis] += power


def _at_rest(x: Array, follows: Mask, noise: float, step: float) -> tuple[Mask, Array, float]:
    """Samples off the median of seven, how far all are off it, and the limit of that."""
    deviation = x - scipy.ndimage.median_filter(x, 7, mode="nearest")
    spread = float(np.median(np.abs(deviation[follows]))) / 0.6745 if follows.any() else noise
    limit = OUTLIER * max(spread, noise) + step
    # A repeated or slow event is no spike: both neighbours must be back.
    neighbours = np.maximum(np.abs(np.roll(deviation, 1)), np.abs(np.roll(deviation, -1)))
    far = follows & (np.abs(deviation) > limit) & (neighbours < 0.5 * np.abs(deviation))
    return _is_single(x, np.where(far, deviation, 0.0), noise), deviation, limit


def _is_single(x: Array, deviation: Array, noise: float) -> Mask:
    """Whether a sample that deviates is alone off the curve through three samples on either side of each.

    It is about as far off its own, and those of the samples beside it show it with the weights that it has in them and nothing
    else. A motion that bends within a few samples may be far off a median or off what one side tells, but not so.
    """
    off = x - scipy.ndimage.convolve1d(x, BETWEEN, mode="nearest")
    half = len(BETWEEN) // 2
    found = (off * deviation > 0) & (np.abs(off) > np.maximum(AS_FAR * np.abs(deviation), OUTLIER * noise))
    spread = noise * float(np.sqrt(1 + BETWEEN @ BETWEEN))
    for k in np.flatnonzero(found).tolist():
        low, high = max(k - 2 * half, 0), min(k + 2 * half + 1, x.size)
        pattern = np.zeros(4 * half + 1)
        pattern[half : 3 * half + 1] = -BETWEEN
        pattern[2 * half] = 1.0
        left = off[low:high] - off[k] * pattern[low - k + 2 * half : high - k + 2 * half]
        found[k] = np.abs(left).max() < max(ALONE * abs(off[k]), OUTLIER * spread)
    return np.asarray(found)


def _in_motion(x: Array, follows: Mask, noise: float, step: float) -> tuple[Mask, Array, float, Mask, Array]:
    """The same off what the readings around tell of it; the limit is that where the motion adds nothing.

    The last two are all that are further off than the samples beside them, and how far off a reading must be at each.
    """
    follows = follows.copy()
    follows[:SIDE] = follows[-SIDE:] = False
    weights = _best_weights(x, follows)
    off = x - scipy.ndimage.convolve1d(x, np.concatenate([weights[::-1], [0.0], weights]), mode="nearest")
    usual = noise * float(np.sqrt(1 + 2 * weights @ weights))
    level = np.maximum(scipy.ndimage.median_filter(np.abs(off), NEARBY, mode="nearest") / 0.6745, usual)
    least = OUTLIER * level + step
    # Beside a spike a reading is off as well, by its share of the spike.
    highest = np.abs(off) >= scipy.ndimage.maximum_filter1d(np.abs(off), 2 * SIDE + 1, mode="nearest")
    far = follows & highest & (np.abs(off) > least)
    single = _is_single(x, np.where(far, off, 0.0), noise)
    known = _Shapes(weights)
    for k in np.flatnonzero(single).tolist():
        odds, left = known.odds(off[k - SIDE : k + SIDE + 1])
        single[k] = odds > CLEARLY * level[k] ** 2 and left < NO_MORE * level[k] ** 2
    return single, off, OUTLIER * usual + step, far, least


def _best_weights(x: Array, follows: Mask) -> Array:
    """(SIDE,) weights of the readings at each distance, on both sides, that leave the least of a reading; their sum is ½.

    White noise wants the mean of many, and a fast motion a curve through few; the readings tell what theirs want.
    """
    places = np.flatnonzero(follows)
    places = places[:: max(1, -(-places.size // MOST_FITTED))]
    if places.size < FEWEST_FITTED:
        half = len(BETWEEN) // 2
        return np.pad(BETWEEN[half + 1 :], (0, SIDE - half))
    sides = np.column_stack([x[places - lag] + x[places + lag] - 2 * x[places] for lag in range(1, SIDE + 1)])
    y, sides = -0.5 * sides[:, 0], sides[:, 1:] - sides[:, :1]
    for _ in range(2):
        others = np.asarray(np.linalg.lstsq(sides, y, rcond=None)[0])
        left = np.abs(y - sides @ others)
        kept = left <= OUTLIER * np.median(left) / 0.6745
        y, sides = y[kept], sides[kept]
    return np.append(0.5 - others.sum(), others)


class _Shapes:
    """Of what readings around a sample are off by, how much a spike explains and how much a step and a bend beside it.

    With K the filter that takes from a reading what those around tell of it, whose usual error is L, the readings x have the
    inverse covariance K/L², and deviations Kx the covariance L² K. So a shape u, which they show as s = Ku, explains
    (sᵀ K⁻¹ Kx)² / sᵀ K⁻¹ s, in squared deviations, where K is cut to the samples that are looked at.
    """

    def __init__(self, weights: Array) -> None:
        K = np.concatenate([-weights[::-1], [1.0], -weights])
        t = np.arange(-2.0 * SIDE, 2 * SIDE + 1)
        after = [t >= late for late in (0, 1)]
        shapes = [t[:, None] == 0.0, *(np.column_stack([one, one * t]) for one in after)]
        seen = [scipy.ndimage.convolve1d(one.astype(float), K, axis=0)[SIDE:-SIDE] for one in shapes]
        values, vectors = np.linalg.eigh(scipy.linalg.toeplitz(np.concatenate([[1.0], -weights, np.zeros(SIDE)])))
        inverse = vectors / np.maximum(values, LEAST_POWER) @ vectors.T
        self.all = inverse
        self.spike, *self.steps = (inverse @ one @ np.linalg.inv(one.T @ inverse @ one) @ one.T @ inverse for one in seen)

    def odds(self, off: Array) -> tuple[float, float]:
        """What a spike in the middle explains more than the better of a step and a bend before or after it; what it leaves."""
        explained = float(off @ self.spike @ off)
        return explained - max(float(off @ step @ off) for step in self.steps), float(off @ self.all @ off) - explained


def _likeness(recording: Recording, looked: list[Looked], asked: Mask) -> float:
    """Of the times of outliers, counted from their interval's start, of what they may go with, and of how high they are."""
    since, given = since_start(recording), circumstances(recording)
    times, heights, places = [], [], []
    for one in looked:
        own = some(np.flatnonzero(one.places))
        times.append(since[one.places])
        heights.append(one.off[one.places] - one.limit)
        if own.size > 1:
            # Of places where the smallest of them would have been seen: none there is chance.
            where = asked & (one.hidden <= np.abs(one.off[own]).min())
            seen = own[where[own]]
            places += [(values[where], values[seen]) for values in given]
    return min(1.0, 3 * min(of_times(np.concatenate(times)), of_heights(np.concatenate(heights)), of_places(places)))


def _neighbours(report: SampleReport, places: list[Mask], noise: Array) -> None:
    """Whether the samples beside outliers are as noisy as all others: what disturbs them too is not a single sample's fault.

    Summed with the signs of the outliers, the readings at some distance are noise of variance m σ² about zero, for m outliers;
    less the median of 41 samples around, (1 + π/82) times that.
    """
    aligned, total = np.zeros(len(BESIDE)), sum(int(place.sum()) for place in places)
    for axis, bad in enumerate(places):
        x = report.rates[:, axis]
        deviation = (x - scipy.ndimage.median_filter(x, AROUND, mode="nearest")) / noise[axis]
        own = np.flatnonzero(bad)
        own = own[(own >= AROUND) & (own < x.size - AROUND)]
        for number, lag in enumerate(BESIDE):
            aligned[number] += float(np.sum(np.sign(deviation[own]) * np.clip(deviation[own + lag], -OUTLIER, OUTLIER)))
    chi2 = float(np.sum(aligned**2) / max(total, 1) / (1 + np.pi / (2 * AROUND)))
    p = max(float(scipy.stats.chi2.sf(chi2, len(BESIDE))), IMPOSSIBLE)
    text = f"the samples beside outliers are off as well, χ² = {chi2:.1f} of {len(BESIDE)}"
    report.tests.append(SampleTest("outlier_neighbours", None, chi2, float(len(BESIDE)), p, "outlier_neighbours", text))
    if p < report.event_p:
        report.symptoms.append(Symptom("outlier_neighbours", None, chi2, "χ²", float(np.sqrt(2 * chi2)), {}, p, text))
