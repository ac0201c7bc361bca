"""Single samples far outside of their neighbours.

Where the body rests, a reading is compared with the median around it. Where it moves, parabolas through the
samples before and through those after each tell what a reading should be: a spike is far from both, to the same side, and a
torque that sets in, after which the rate goes on along another line, is not far from either.
"""

from __future__ import annotations

import numpy as np
import scipy.ndimage
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.likeness import of_heights, of_times
from diagnosis.detectors.report import AXES, IMPOSSIBLE, SampleReport, SampleTest, Symptom, consecutive
from gyrocal.recording import Recording
from simulator.effects.recorded import interval_slices

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

AROUND = 41  # samples whose median an outlier's neighbours are compared with
BESIDE = (-3, -2, -1, 1, 2, 3)  # samples from an outlier
OUTLIER = 6.0  # noise sigmas; one sample in 5e8 under M0
RESTING = 0.3  # share of the samples in which the body rests, below which all are looked at as a motion
SIDE = 6  # samples to one side that tell what a reading should be
BETWEEN = np.array([1.0, -6.0, 15.0, 0.0, 15.0, -6.0, 1.0]) / 20  # of a quintic through three samples on either side
AS_FAR = 0.75  # of its deviation, that a spike is off the curve through its neighbours
AS_HIGH = 0.4  # of the usual spike
ALONE = 0.2  # of a spike, that may be left beside it
NEARBY = 101  # over which the size of their usual error is taken


def spikes(report: SampleReport, recording: Recording, quiet: Mask, used: Mask, noise: Array, steps: Array) -> None:
    """Single samples far outside, and the tails of all."""
    whole = scipy.ndimage.binary_erosion(used & consecutive(recording, used), iterations=SIDE)
    # Beside a sample that was bridged the motion is known less well than the noise says.
    known = ~scipy.ndimage.binary_dilation(report.filled, iterations=len(BETWEEN) // 2)
    resting = quiet & consecutive(recording, quiet) & np.roll(consecutive(recording, quiet), -1) & known
    if resting.sum() < RESTING * used.sum():
        resting[:] = False
    # A large outlier is no rest, so that what is left is looked at as a motion.
    moving = whole & known & ~resting
    n = max(int(resting.sum() + moving.sum()), 1)
    places, sizes, limits, settled, odd, hiding = [], [], [], [], [], []
    for axis in range(3):
        x, level, step = report.rates[:, axis], float(noise[axis]), float(steps[axis])
        still, off, limit = _at_rest(x, resting, level, step)
        jumps, beside, most, far, local = _in_motion(x, moving, level, step)
        odd.append(np.where(far, np.abs(beside), 0.0))
        hiding.append(np.where(resting, 0.0, local))
        settled.append(still)
        places.append(still | jumps)
        sizes.append(np.abs(np.where(jumps, beside, off)))
        limits.append(limit if resting.any() else most)
    # What two gyros show at once while the body moves is a jolt of it.
    near = sum(scipy.ndimage.binary_dilation(place, iterations=SIDE).astype(int) for place in places)
    places = [still | (place & (near == 1)) for still, place in zip(settled, places, strict=True)]
    counts = [int(place.sum()) for place in places]
    sizes = [size[place] for place, size in zip(places, sizes, strict=True)]
    expected = 2 * scipy.stats.norm.sf(OUTLIER) * 1.2
    for axis in range(3):
        p = max(float(scipy.stats.poisson.sf(counts[axis] - 1, n * expected)), IMPOSSIBLE)
        report.tests.append(
            SampleTest(
                "outliers", AXES[axis], counts[axis], n * expected, p if counts[axis] else 1.0, "outliers",
                f"{counts[axis]} of {n} samples are off by more than {OUTLIER:g} sigmas",
            )
        )  # fmt: skip
    total = sum(counts)
    p = max(float(scipy.stats.poisson.sf(total - 1, 3 * n * expected)), IMPOSSIBLE) if total else 1.0
    if p >= report.event_p or total < 2:
        return
    strongest = int(np.argmax(counts))
    # Two of two on one axis are three times likelier if only that has them.
    alone = counts[strongest] >= 0.95 * total
    together = np.concatenate(sizes)
    beyond = together - min(limits)
    axes = 1 if alone else 3
    fraction = total / (axes * n)
    if total > 5 and beyond.std() > 0.5 * beyond.mean():
        # Outliers of all sizes: what exceeds a limit has, for exponential ones, the mean of all; the others are hidden.
        seen = float(beyond.mean())
        fraction *= float(np.exp(min(min(limits) / seen, 5.0)))
        error = seen * np.sqrt(1 / total + 0.1**2)
    else:
        seen = float(together.mean())
        error = float(np.hypot(together.std(), noise.mean()) / np.sqrt(total))
    report.symptoms.append(
        Symptom(
            "outliers", AXES[strongest] if alone else None, float(np.rad2deg(seen)), "deg/s", float(np.rad2deg(error)),
            {"fraction": float(fraction)}, p, likeness=_likeness(recording, places, sizes, limits),
        )
    )  # fmt: skip
    if any(still.any() for still in settled):
        _neighbours(report, settled, sum(int(still.sum()) for still in settled), noise)
    # Of a gyro that has some, what stands as far out of a motion is taken out as well, though that bends.
    t = recording.gyro.t_s
    for axis in range(3):
        bad = places[axis] | (odd[axis] > (AS_HIGH * seen if counts[axis] else np.inf))
        good = ~bad
        report.rates[bad, axis] = np.interp(t[bad], t[good], report.rates[good, axis])
        report.filled |= bad
        if counts[axis]:  # where the motion hides one, they are noise
            power = fraction * float(np.mean(sizes[axis] ** 2)) * recording.gyro.sample_s
            report.density[(hiding[axis] > AS_HIGH * seen) & ~bad, axis] += power


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
    """The same off what the samples before and those after tell; the limit is that where the motion adds nothing.

    The last two are all that are far off, also beside others, and how far off that is at each.
    """
    weights = np.linalg.pinv(np.vander(np.arange(1.0, SIDE + 1), 3))[-1]  # of a parabola at zero
    usual = noise * float(np.sqrt(1 + weights @ weights))
    padded = np.pad(x, SIDE, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, SIDE)
    sides = np.array([x - windows[: x.size] @ weights[::-1], x - windows[SIDE + 1 :] @ weights])
    local = scipy.ndimage.median_filter(np.abs(sides), (1, NEARBY), mode="nearest") / 0.6745
    nearer = np.where(sides[0] * sides[1] > 0, np.abs(sides).min(axis=0), 0.0)
    least = OUTLIER * np.maximum(local.max(axis=0), usual) + step
    far = follows & (nearer > least)
    deviation = np.sign(sides[0]) * nearer
    return _is_single(x, np.where(far, deviation, 0.0), noise), deviation, OUTLIER * usual + step, far, least


def _likeness(recording: Recording, places: list[Mask], sizes: list[Array], limits: list[float]) -> float:
    """Of the times of outliers, counted from their interval's start, and of how far they exceed their limit."""
    starts = np.array([part.start for part in interval_slices(recording)])
    times, heights = [], []
    for axis, bad in enumerate(places):
        own = np.flatnonzero(bad)
        times.append(own - starts[np.clip(np.searchsorted(starts, own, side="right") - 1, 0, None)])
        heights.append(sizes[axis] - limits[axis])
    return min(1.0, 2 * min(of_times(np.concatenate(times)), of_heights(np.concatenate(heights))))


def _neighbours(report: SampleReport, places: list[Mask], total: int, noise: Array) -> None:
    """Whether the samples beside outliers are as noisy as all others: what disturbs them too is not a single sample's fault.

    Summed with the signs of the outliers, the readings at some distance are noise of variance m σ² about zero, for m outliers;
    less the median of 41 samples around, (1 + π/82) times that.
    """
    aligned = np.zeros(len(BESIDE))
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
