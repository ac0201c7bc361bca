"""Samples on a straight line between those around them: lost ones that were filled in by the ground.

The second difference of readings with white noise of the standard deviation σ has a density of at most 1/(√(2π) √6 σ), whatever
the motion, and of at most 1/(√(2π) σ) given all before it, since the newest reading is independent of them. Numbers of a format
with the step q that were taken from a line have a second difference of no more than 2q. That of noise is so small on all three
axes at once with at most the probability

    c₁ = ∏_a min(1, 4q_a/(√(2π) √6 σ_a)),    and k times in a row with at most    c^k,    c = ∏_a min(1, 4q_a/(√(2π) σ_a)).

The longest run of samples is compared with the sum of c^k over them, and the number of runs with the Poisson distribution whose
mean is the sum of c₁. The step of floating-point numbers doubles where readings do, so that it is taken by the octave of the
largest of three readings: as the smallest change that is there from one sample to the next, which noise makes larger than
any step. σ is the smaller of what is stated and what the median of the second differences says.

Readings that stand still are straight, too: stale samples, clipped ones and zeros do not count.
"""

from __future__ import annotations

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.report import AXES, IMPOSSIBLE, SampleReport, SampleTest, Symptom, Tell, consecutive, silent
from gyrocal.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

WORTH = 1e-12  # of a reading: smaller changes are rounding
MEDIAN = 0.6745  # of |z| for normal z of variance one
DENSEST = 1 / np.sqrt(2 * np.pi)  # density of normal noise of variance one where it is largest
FEW = 3  # samples on lines, below which a number format that is no power of two may have made them
FEWEST = 100  # second differences, below which nothing is said


def straight_samples(report: SampleReport, recording: Recording, used: Mask, sigma: float, tell: Tell = silent) -> None:
    """Note samples that lie on a line between others."""
    tell("samples on a line", 0.0)
    rates = recording.gyro.rates
    follows = consecutive(recording, used)
    whole = follows[1:-1] & follows[2:]
    change = np.diff(rates, axis=0)
    whole &= (change[1:] != 0.0).all(axis=1) & (change[:-1] != 0.0).all(axis=1)
    runs, longest, p = chance(rates, whole, sigma, tell)
    text = f"{int(runs.sum())} samples lie on straight lines between others, in {runs.size} stretches of up to {longest}"
    report.tests.append(SampleTest("straight_samples", None, float(runs.sum()), 0.0, p, "straight_samples", text))
    if p < report.event_p:
        share = float(runs.sum()) / max(int(used.sum()), 1)
        report.symptoms.append(Symptom("straight_samples", None, share, "of the samples", 0.0, {}, p, text))


def chance(rates: Array, whole: Mask, sigma: float, tell: Tell = silent) -> tuple[NDArray[np.intp], int, float]:
    """Lengths of the straight stretches, the longest, and the p-value that noise makes them.

    Parameters
    ----------
    rates : (n, 3) readings, rad/s
    whole : (n − 2,) second differences that count
    sigma : stated noise of a sample, rad/s
    tell : called with what is looked at and the share done
    """
    none = np.zeros(0, dtype=np.intp)
    if int(whole.sum()) < FEWEST or not sigma > 0:
        return none, 0, 1.0
    straight, next_one, first = whole.copy(), np.ones(whole.size), np.ones(whole.size)
    for axis, x in enumerate(rates.T):
        tell(f"samples of gyro {AXES[axis]} on a line", (axis + 1) / 4)
        second = np.abs(np.diff(x, n=2))
        level = min(sigma, float(np.median(second[whole])) / (MEDIAN * np.sqrt(6)))
        if not level > 0:
            return none, 0, 1.0
        step = steps(x)
        straight &= second <= 2 * step
        next_one *= np.minimum(1.0, 4 * DENSEST * step / level)
        first *= np.minimum(1.0, 4 * DENSEST * step / (np.sqrt(6) * level))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], straight.astype(np.int8), [0]])))
    runs = np.asarray(edges[1::2] - edges[::2], dtype=np.intp)
    if runs.sum() < FEW:
        return runs, int(runs.max(initial=0)), 1.0
    longest = int(runs.max())
    of_longest = min(1.0, float(np.sum(next_one[whole] ** longest)))
    of_number = float(scipy.stats.poisson.sf(runs.size - 1, np.sum(first[whole])))
    return runs, longest, float(np.clip(2 * min(of_longest, of_number), IMPOSSIBLE, 1.0))


def steps(x: Array) -> Array:
    """(n − 2,) step of the numbers around each reading x (n,) but the first and the last, by their octave."""
    change = np.abs(np.diff(x))
    size = np.abs(x)
    octave = np.frexp(np.maximum(np.maximum(size[:-2], size[1:-1]), size[2:]))[1]
    of_change = np.frexp(np.maximum(size[:-1], size[1:]))[1]
    low = int(min(octave.min(), of_change.min()))
    smallest = np.full(int(max(octave.max(), of_change.max())) - low + 1, np.inf)
    there = change > WORTH * size[1:]
    np.minimum.at(smallest, of_change[there] - low, change[there])
    return np.asarray(smallest[octave - low])
