"""Samples that come a second time: a packet that was stored, or sent, in place of another.

Two samples hardly ever read the same on all axes at once. With noise of the standard deviation σ, and a number format of the
step q, two readings of one axis are the same with a probability of at most q/(σ √(2π)), whatever the motion, and all three axes
of k samples in a row with at most

    c^k,    c = ∏_a min(1, q_a/(σ_a √(2π))).

Of n samples there are less than n²/2 pairs where that may begin. The step is not more than the first percentile of the changes
from one sample to the next, which noise alone makes larger.

Samples that repeat the one before are stale, and zeros and largest readings come again by themselves: none of these counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.detectors.report import IMPOSSIBLE, SampleReport, SampleTest, Symptom, consecutive
from gyrocal.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FEWEST = 3  # samples in a row
MIXED = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xC2B2AE3D27D4EB4F), np.uint64(0x165667B19E3779F9))  # odd, of many bits


@dataclass(frozen=True)
class Copies:
    """What comes again.

    Attributes
    ----------
    count : stretches that do
    longest : samples of the longest of them
    samples : of all
    later : how many samples later the longest comes again
    """

    count: int
    longest: int
    samples: int
    later: int


def copied_samples(report: SampleReport, recording: Recording, used: Mask, sigma: float) -> None:
    """Note stretches of samples that come a second time."""
    rates = recording.gyro.rates
    found = copies(rates, _telling(rates, used), consecutive(recording, used))
    p = chance(rates[used], found.longest, sigma)
    share = found.samples / max(int(used.sum()), 1)
    text = f"{found.count} stretches of up to {found.longest} samples come again, the longest {found.later} samples later"
    report.tests.append(SampleTest("copied_samples", None, float(found.samples), 0.0, p, "copied_samples", text))
    if p < report.event_p:
        report.symptoms.append(Symptom("copied_samples", None, share, "of the samples", 0.0, {}, p, text))


def _telling(rates: Array, used: Mask) -> Mask:
    """Samples that do not read what readings often are: zero, the largest, the smallest, or all the same as before."""
    low, high = rates[used].min(axis=0, initial=np.inf), rates[used].max(axis=0, initial=-np.inf)
    out = used & ~((rates == 0.0) | (rates == low) | (rates == high)).any(axis=1)
    out[1:] &= (rates[1:] != rates[:-1]).any(axis=1)
    return np.asarray(out)


def copies(rates: Array, telling: Mask, follows: Mask) -> Copies:
    """Stretches of at least `FEWEST` samples that come again.

    Parameters
    ----------
    rates : (n, 3)
    telling : (n,) samples that count
    follows : (n,) samples that follow the one before without a gap
    """
    place = np.flatnonzero(telling)
    key = np.zeros(place.size, dtype=np.uint64)
    for axis, factor in enumerate(MIXED):
        key = (key ^ (key >> np.uint64(29))) * MIXED[0] + np.ascontiguousarray(rates[place, axis]).view(np.uint64) * factor
    order = np.argsort(key, kind="stable")
    alike = key[order[1:]] == key[order[:-1]]
    first, second = place[order[:-1][alike]], place[order[1:][alike]]
    alike = (rates[first] == rates[second]).all(axis=1)
    at = np.argsort(first[alike])
    first, second = first[alike][at], second[alike][at]
    if not first.size:
        return Copies(0, 0, 0, 0)
    goes_on = (np.diff(first) == 1) & (np.diff(second) == 1) & follows[first[1:]] & follows[second[1:]]
    begin = np.flatnonzero(np.concatenate([[True], ~goes_on]))
    length = np.diff(np.append(begin, first.size))
    begin, length = begin[length >= FEWEST], length[length >= FEWEST]
    if not length.size:
        return Copies(0, 0, 0, 0)
    top = int(np.argmax(length))
    later = int(second[begin[top]] - first[begin[top]])
    return Copies(int(length.size), int(length[top]), int(length.sum()), later)


def chance(rates: Array, longest: int, sigma: float) -> float:
    """P-value of so many samples in a row that come again somewhere among these rates (n, 3) with noise sigma, rad/s."""
    if longest < FEWEST or not sigma > 0:
        return 1.0
    change = np.abs(np.diff(rates, axis=0))
    log_c = 0.0
    for axis in range(3):
        own = change[change[:, axis] > 0, axis]
        step = float(np.quantile(own, 0.01)) if own.size else np.inf
        log_c += min(0.0, float(np.log(step / sigma / np.sqrt(2 * np.pi))))
    return float(np.clip(np.exp(min(0.0, 2 * np.log(len(rates)) - np.log(2) + longest * log_c)), IMPOSSIBLE, 1.0))
