"""Outliers of the readings: what single samples far outside of their neighbours amount to.

Which they are is told by `diagnosis.detectors.single_samples`. Spikes come at random, alone on their gyro and of heights that
have a law; what several gyros show at once is a jolt of the body.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.ndimage
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.likeness import of_heights, of_places, of_signs, of_times, some
from diagnosis.detectors.report import (
    AXES,
    IMPOSSIBLE,
    SampleReport,
    SampleTest,
    Symptom,
    Tell,
    circumstances,
    consecutive,
    silent,
    since_start,
)
from diagnosis.detectors.single_samples import BETWEEN, OUTLIER, SIDE, at_rest, in_motion
from gyrocal.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

AROUND = 41  # samples whose median an outlier's neighbours are compared with
BESIDE = (-3, -2, -1, 1, 2, 3)  # samples from an outlier
FEWEST_OTHERS = 100  # samples that tell how far off those are anywhere
OF_NOISE = 1 + np.pi / (2 * AROUND)  # variance of white noise of unit variance off that median
RESTING = 0.3  # share of the samples in which the body rests, below which all are looked at as a motion
ALIKE = 0.02  # of the steps and bends of a motion, which may pass for spikes: a body that is jolted all the time has hundreds
AS_HIGH = 0.4  # of the usual spike
FEW = 5  # outliers, of which heights show no law
MANY = 25  # of which the scatter of heights shows whether they are exponential
ALL_ALIKE = 3.0  # mean smallest heights of exponential outliers, up to which that of some may be one


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
    up : whether each reading is above its neighbours
    """

    still: Mask
    moving: Mask
    off: Array
    limit: float
    odd: Mask
    hidden: Array
    up: Mask

    @property
    def places(self) -> Mask:
        """All outliers."""
        return self.still | self.moving


def spikes(
    report: SampleReport,
    recording: Recording,
    quiet: Mask,
    used: Mask,
    noise: Array,
    steps: Array,
    tell: Tell = silent,
) -> None:
    """Single samples far outside, and the tails of all."""
    looked, asked = _looked(report, recording, quiet, used, noise, steps, tell)
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
    uneven = beyond.std() > 0.5 * beyond.mean()
    if total < MANY:  # whose scatter says little; of n exponential ones the smallest is beyond the limit by an n-th of the mean
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
    shown = sum(int((asked & (one.hidden <= high)).sum()) for one in ([looked[strongest]] if alone else looked))
    fraction = total / max(shown, total) * (float(np.exp(min(limit / seen, 5.0))) if exponential else 1.0)
    report.symptoms.append(
        Symptom(
            "outliers", AXES[strongest] if alone else None, float(np.rad2deg(size)), "deg/s", float(np.rad2deg(error)),
            {"fraction": float(fraction)}, p, likeness=_likeness(recording, looked, asked),
        )
    )  # fmt: skip
    if any(one.still.any() for one in looked):
        _neighbours(report, [one.still for one in looked], quiet, noise)
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
    report: SampleReport, recording: Recording, quiet: Mask, used: Mask, noise: Array, steps: Array, tell: Tell
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
        tell(f"outliers of gyro {AXES[axis]} at rest", axis / 3)
        still, off, limit = at_rest(x, resting, level, step)
        tell(f"outliers of gyro {AXES[axis]} in motion", (axis + 0.5) / 3)
        moving, beside, most, odd, least = in_motion(x, turning, level, step)
        off = np.where(odd, beside, off)
        hidden = np.where(resting, 0.0, least)
        found.append(Looked(still, moving, np.abs(off), limit if resting.any() else most, odd, hidden, off > 0))
    # What two gyros show at once while the body moves is a jolt of it.
    tell("outliers that are jolts of the body", 0.95)
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


def _likeness(recording: Recording, looked: list[Looked], asked: Mask) -> float:
    """Of the times of outliers, counted from their interval's start, of what they and their signs go with, and of heights."""
    since, given = since_start(recording), circumstances(recording)
    times, heights, places, signs = [], [], [], [1.0]
    for one in looked:
        own = some(np.flatnonzero(one.places))
        times.append(since[one.places])
        heights.append(one.off[one.places] - one.limit)
        signs.append(of_signs(one.up[own], [values[own] for values in given]))
        if own.size > 1:
            # Of places where the smallest of them would have been seen: none there is chance.
            where = asked & (one.hidden <= np.abs(one.off[own]).min())
            seen = own[where[own]]
            places += [(values[where], values[seen]) for values in given]
    of_sign = min(1.0, len(looked) * min(signs))
    found = of_times(np.concatenate(times)), of_heights(np.concatenate(heights)), of_places(places), of_sign
    return min(1.0, len(found) * min(found))


def _neighbours(report: SampleReport, places: list[Mask], quiet: Mask, noise: Array) -> None:
    """Whether the samples beside outliers are as all others are: what disturbs them too is not a single sample's fault.

    Readings at some distances from m outliers, less the median of 41 samples around, are summed with the outliers' signs. As
    these have nothing to do with what is beside them, the sums have m times the covariance C of deviations at such distances
    anywhere, that of the noise and of what a body sways by in so few samples. So Sᵀ C⁻¹ S/m is χ².
    """
    aligned, C = np.zeros(len(BESIDE)), np.zeros((len(BESIDE), len(BESIDE)))
    for axis, bad in enumerate(places):
        x = report.rates[:, axis]
        deviation = (x - scipy.ndimage.median_filter(x, AROUND, mode="nearest")) / noise[axis]
        clipped = np.clip(deviation, -OUTLIER, OUTLIER)
        inside = np.zeros(x.size, dtype=bool)
        inside[AROUND : x.size - AROUND] = True
        own = np.flatnonzero(bad & inside)
        signs = np.sign(deviation[own])
        aligned += np.array([signs @ clipped[own + lag] for lag in BESIDE])
        others = some(np.flatnonzero(quiet & inside & ~scipy.ndimage.binary_dilation(bad, iterations=AROUND)))
        around = np.array([clipped[others + lag] for lag in BESIDE])
        C += own.size * (around @ around.T / others.size if others.size > FEWEST_OTHERS else OF_NOISE * np.eye(len(BESIDE)))
    chi2 = float(aligned @ np.linalg.solve(C, aligned)) if aligned.any() else 0.0
    p = max(float(scipy.stats.chi2.sf(chi2, len(BESIDE))), IMPOSSIBLE)
    text = f"the samples beside outliers are off as well, χ² = {chi2:.1f} of {len(BESIDE)}"
    report.tests.append(SampleTest("outlier_neighbours", None, chi2, float(len(BESIDE)), p, "outlier_neighbours", text))
    if p < report.event_p:
        report.symptoms.append(Symptom("outlier_neighbours", None, chi2, "χ²", float(np.sqrt(2 * chi2)), {}, p, text))
