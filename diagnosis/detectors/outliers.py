"""Single samples far outside of their neighbours.

Where the body rests, a reading is compared with the median around it. Where it moves all the time, parabolas through the
samples before and through those after each tell what a reading should be: a spike is far from both, to the same side, and a
torque that sets in, after which the rate goes on along another line, is not far from either.
"""

from __future__ import annotations

import numpy as np
import scipy.ndimage
import scipy.signal
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.likeness import of_heights, of_times
from diagnosis.detectors.report import AXES, IMPOSSIBLE, SampleReport, SampleTest, Symptom, consecutive, inside
from gyrocal.recording import Recording
from simulator.effects.recorded import interval_slices

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PARABOLA = 9  # samples of the local parabola
AROUND = 41  # samples whose median an outlier's neighbours are compared with
BESIDE = (-3, -2, -1, 1, 2, 3)  # samples from an outlier
OUTLIER = 6.0  # noise sigmas; one sample in 5e8 under M0
RESTING = 0.3  # share of the samples in which the body rests, below which all are looked at
SIDE = 6  # samples to one side that tell what a reading should be
BETWEEN = np.array([1.0, -6.0, 15.0, 0.0, 15.0, -6.0, 1.0]) / 20  # of a quintic through three samples on either side
AS_FAR = 0.75  # of its deviation, that a spike is off the curve through its neighbours
ALONE = 0.2  # of a spike, that may be left beside it
NEARBY = 101  # over which the size of their usual error is taken


def spikes(report: SampleReport, recording: Recording, quiet: Mask, used: Mask, noise: Array, steps: Array) -> None:
    """Single samples far outside, and the tails of all."""
    follows = quiet & consecutive(recording, quiet) & np.roll(consecutive(recording, quiet), -1)
    moving = follows.sum() < RESTING * used.sum()
    if moving:
        follows = scipy.ndimage.binary_erosion(used & consecutive(recording, used), iterations=SIDE)
    # Beside a sample that was bridged the motion is known less well than the noise says.
    follows &= ~scipy.ndimage.binary_dilation(report.filled, iterations=len(BETWEEN) // 2)
    n = max(int(follows.sum()), 1)
    look = _in_motion if moving else _at_rest
    found = [look(report.rates[:, axis], follows, float(noise[axis]), float(steps[axis])) for axis in range(3)]
    places, limits = [one[0] for one in found], [one[2] for one in found]
    if moving:  # what two gyros show at once is a jolt of the body
        near = sum(scipy.ndimage.binary_dilation(place, iterations=SIDE).astype(int) for place in places)
        places = [place & (near == 1) for place in places]
    counts = [int(place.sum()) for place in places]
    sizes = [np.abs(deviation[place]) for place, (_, deviation, _) in zip(places, found, strict=True)]
    expected = 2 * scipy.stats.norm.sf(OUTLIER) * 1.2
    for axis in range(3):
        p = max(float(scipy.stats.poisson.sf(counts[axis] - 1, n * expected)), IMPOSSIBLE)
        report.tests.append(
            SampleTest(
                "outliers", AXES[axis], counts[axis], n * expected, p if counts[axis] else 1.0, "outliers",
                f"{counts[axis]} of {n} {'' if moving else 'quiet '}samples are off by more than {OUTLIER:g} sigmas",
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
    if not moving:
        _neighbours(report, places, total, noise)
    # Outside the quiet parts a spike must stand out of the motion as well before it is taken out.
    t = recording.gyro.t_s
    for axis in range(3):
        x = report.rates[:, axis]
        deviation = x - scipy.ndimage.median_filter(x, 7, mode="nearest")
        jump = np.abs(deviation) > max(0.4 * seen, 8 * noise[axis])
        bad = places[axis] | (jump & inside(recording) & ~quiet & (np.abs(_highpass(x)) > 8 * noise[axis]))
        good = ~bad
        report.rates[bad, axis] = np.interp(t[bad], t[good], x[good])
        report.filled |= bad


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


def _in_motion(x: Array, follows: Mask, noise: float, step: float) -> tuple[Mask, Array, float]:
    """The same off what the samples before and those after tell; the limit is that where the motion adds nothing."""
    weights = np.linalg.pinv(np.vander(np.arange(1.0, SIDE + 1), 3))[-1]  # of a parabola at zero
    usual = noise * float(np.sqrt(1 + weights @ weights))
    padded = np.pad(x, SIDE, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, SIDE)
    sides = np.array([x - windows[: x.size] @ weights[::-1], x - windows[SIDE + 1 :] @ weights])
    local = scipy.ndimage.median_filter(np.abs(sides), (1, NEARBY), mode="nearest") / 0.6745
    nearer = np.where(sides[0] * sides[1] > 0, np.abs(sides).min(axis=0), 0.0)
    far = follows & (nearer > OUTLIER * np.maximum(local.max(axis=0), usual) + step)
    deviation = np.sign(sides[0]) * nearer
    return _is_single(x, np.where(far, deviation, 0.0), noise), deviation, OUTLIER * usual + step


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


def _highpass(x: Array) -> Array:
    """Reading minus the local parabola through its neighbours but not itself, scaled to the noise of a sample."""
    kernel = scipy.signal.savgol_coeffs(PARABOLA, 2)
    own = kernel[PARABOLA // 2]
    residual = x - scipy.ndimage.convolve1d(x, kernel, axis=0, mode="nearest")
    return np.asarray(residual / np.sqrt(1 - own))
