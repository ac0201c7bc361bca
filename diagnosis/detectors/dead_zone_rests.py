"""A dead zone seen at low frequency: slow readings that are exactly zero, for longer than a body's motion would allow.

A dead zone acts on the rate; the white noise behind it goes on, so that no sample reads exactly zero and the noise level is as
ever. Where the true rate stays inside, means of the reading over short windows are zero within their noise σ, all of them. A
run of n such windows has the mean m with the sigma σ/√n. Under M0 the rate is a level of the usual size s₀ of this axis' slow
readings, which runs share but for the part s₁ that the body's rate leaks into them, and the log odds of runs with the means m
are

    log N(m; 0, σ²/n) − log N(m; 0, σ²/n + s₀² 1 1ᵀ + s₁² I),

the latter averaged over that usual size and those of the biases, since a body may rest, when a good gyro reads next to nothing:
their root mean square and their median, which a step of one of them does not raise.

A motion that only passes through zero makes no run, since its windows scatter by more than their noise. Where there is no run
there is no candidate. Whether rates are missing there is for the attitude to say (`diagnosis.model.dead_zone`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage
import scipy.special
from numpy.typing import NDArray

from diagnosis.detectors.sample_report import Zone
from gyrocal.mask_runs import find_mask_runs
from gyrocal.recording import Recording
from simulator.effects.recording_view import find_interval_slices

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Parts = NDArray[np.int16]  # of a million samples it is megabytes less than usual numbers are

# least samples and longest time of a window
WINDOW_SAMPLES = 6
LONGEST_WINDOW_S = 60.0
SLOW_WINDOW_S = 20.0  # of the means that show how large slow rates usually are
RESOLVED = 6.0  # sigmas of a window's mean in the usual slow rate, which make it as long as needed
SHORTEST_WINDOWS = 4  # of a run
SLOW = 3.0  # usual rates, up to which a reading is slow
MOSTLY = 0.5  # share of a slow part that reads zero, for it to count as evidence
ZERO = 3.5  # sigmas of a window's mean up to which it may be zero
CONSISTENT = 1e-3  # p-value of a run's windows being zero, at least
NONZERO = 6.0  # sigmas from which a window's mean is a rate
LEAK = 0.2  # of the usual slow rate, what misalignments leak of the body's rate
TELLING = 1.5  # times `nonzero`, from which on the smallest rate that is read says something of the zone
EDGE_SHARE = 0.02  # quantile of the nonzero means that stands for the smallest rate that is read
EDGE = 0.1  # relative error of a half width from means on the edge
MOST_ODDS = 60.0  # log odds that are credited
# samples, and the share of them that must read exactly zero in a stretch of a zone
ZERO_WINDOW = 41
ZERO_SHARE = 0.05
MOST_PARTS = 40  # parts with a rate of their own, the longest ones; others have this number


@dataclass(frozen=True)
class DeadZoneEvidence:
    """What one gyro shows of a dead zone."""

    axis: int  # which gyro
    # (n,) slow part in which each sample may miss a rate, counted from 0, `MOST_PARTS` where that has no rate of its own; −1
    # elsewhere
    part: Parts
    log_odds: float  # in favour of a dead zone, before the attitude is looked at
    alive: float  # smallest steady rate that is read, rad/s, an upper limit; infinite if there is none
    crossed: bool  # whether the motion crosses the edge, so that `alive` is the half width
    usual: float  # usual size of the slow raw rates of this axis, rad/s
    edge: float = EDGE  # relative error of `alive` where that is the half width
    passed: bool = False  # whether the motion was seen to pass through the zone


def find_dead_zone_evidence(
    recording: Recording, rates: Array, noise: Array, usual: float, biases: Array, zones: Mapping[int, Zone]
) -> list[DeadZoneEvidence]:
    """Gyros whose slow readings are zero in runs.

    Parameters
    ----------
    recording : for the intervals
    rates : (n, 3) raw rates, repaired, rad/s
    noise : (3,) white noise of a sample, rad/s
    usual : usual size of slow raw rates, rad/s
    biases : (3,) sizes of the gyros' biases, which are what they read at rest, rad/s
    zones : of gyros whose motion was seen to pass through one
    """
    if usual <= 0:
        return []
    sizes = (usual, float(np.sqrt(np.mean(biases**2))), float(np.median(biases)))
    noisy = [axis for axis in range(3) if noise[axis] > 0]
    found = {axis: _search_axis(recording, rates[:, axis], float(noise[axis]), axis, sizes) for axis in noisy}
    passed = {axis: convert_zone(axis, found) for axis, found in zones.items()}
    return [one for axis in noisy if (one := _combine_evidence(found[axis], passed.get(axis))) is not None]


def _combine_evidence(rest: DeadZoneEvidence | None, passed: DeadZoneEvidence | None) -> DeadZoneEvidence | None:
    """Combine the evidence of rests and of passes; both support the zone whose edge was passed."""
    if rest is None or passed is None:
        return rest or passed
    return replace(passed, log_odds=passed.log_odds + max(rest.log_odds, 0.0))


def convert_zone(axis: int, found: Zone) -> DeadZoneEvidence:
    """Convert a dead zone that the motion passes through to the evidence of one gyro."""
    part, size = label_runs(found.dead), found.half_width
    odds = min(found.log_odds, MOST_ODDS)
    return DeadZoneEvidence(axis, part, odds, size, True, size, found.sigma / size, passed=True)


def label_runs(mask: Mask) -> Parts:
    """Number the runs of a mask (n,) from the longest down, up to `MOST_PARTS`; −1 elsewhere."""
    part = np.full(mask.size, -1, dtype=np.int16)
    for number, (low, high) in enumerate(sorted(find_mask_runs(mask), key=lambda run: run[0] - run[1])):
        part[low:high] = min(number, MOST_PARTS)
    return part


def find_zero_sample_evidence(recording: Recording, axis: int, smallest: float, usual: float) -> DeadZoneEvidence | None:
    """The slow parts of a gyro whose samples read exactly zero in its zone, as one whose noise comes before it does.

    Parameters
    ----------
    recording : as it was recorded
    axis : which gyro
    smallest : smallest rate that is read, rad/s
    usual : usual size of slow raw rates, rad/s
    """
    zero = recording.gyro.rates[:, axis] == 0.0
    often = scipy.ndimage.uniform_filter1d(zero.astype(float), ZERO_WINDOW, mode="nearest") > ZERO_SHARE
    if not often.any():
        return None
    # Every zero misses its rate; the longest stretches of them have one of their own, the others share one.
    numbers = label_runs(often)
    part = np.where(zero, np.where(numbers >= 0, numbers, MOST_PARTS), -1).astype(np.int16)
    return DeadZoneEvidence(axis, part, MOST_ODDS, smallest, True, max(usual, smallest))


def estimate_half_width(one: DeadZoneEvidence, missing: Array) -> tuple[float, float]:
    """Half width and its sigma, deg/s, between the largest rate that is missing and the smallest that is read.

    Parameters
    ----------
    one : what the samples show
    missing : (k,) rates that are missing in the runs, deg/s
    """
    low, high = float(np.abs(missing).max()), float(np.rad2deg(one.alive))
    if one.crossed:
        return high, one.edge * high
    if not np.isfinite(high):
        return 1.3 * low, 0.4 * low
    if high > low:
        high = min(high, 4 * low)
        return 0.5 * (low + high), max((high - low) / np.sqrt(12), EDGE * low)
    return low, EDGE * low


def estimate_slow_rate(recording: Recording, rates: Array, bias: Array) -> float:
    """Usual size of slow raw rates, rad/s: that of the biases, or the slower half of what the middle one of the gyros reads."""
    count = max(1, round(SLOW_WINDOW_S / recording.gyro.sample_s))
    windows = np.column_stack(
        [np.concatenate([part for _, part in _average_interval_windows(recording, rates[:, axis], count)]) for axis in range(3)]
    )
    slow = np.sort(np.abs(windows), axis=0)[: max(1, len(windows) // 2)]
    read = float(np.median(np.sqrt(np.mean(slow**2, axis=0)))) if len(windows) else 0.0
    return max(float(np.sqrt(np.mean(bias**2))), read)


def _search_axis(recording: Recording, x: Array, noise: float, axis: int, sizes: Sequence[float]) -> DeadZoneEvidence | None:
    usual = sizes[0]
    longest = max(WINDOW_SAMPLES, round(LONGEST_WINDOW_S / recording.gyro.sample_s))
    count = max(WINDOW_SAMPLES, min(int((RESOLVED * noise / usual) ** 2), longest))
    sigma = noise / np.sqrt(count)
    zero, slow, others = np.zeros(x.size, dtype=bool), np.zeros(x.size, dtype=bool), []
    for low, windows in _average_interval_windows(recording, x, count):
        still = np.zeros(windows.size, dtype=bool)
        for a, b in find_mask_runs(np.abs(windows) < ZERO * sigma):
            still[a:b] = b - a >= SHORTEST_WINDOWS and _is_zero(windows[a:b] / sigma)
        here, limit = slice(low, low + windows.size * count), max(NONZERO * sigma, SLOW * usual)
        zero[here] = np.repeat(still, count)
        slow[here] = np.repeat(np.abs(windows) < limit, count)
        others.append(windows[~still])
    rests = np.zeros(x.size, dtype=bool)
    for own in find_interval_slices(recording):
        for low, high in find_mask_runs(slow[own]):
            rests[own.start + low : own.start + high] = high - low >= SHORTEST_WINDOWS * count
    means, sigmas = [], []
    for low, high in find_mask_runs(rests):
        read = x[low:high][zero[low:high]]
        if read.size > MOSTLY * (high - low):
            means.append(float(read.mean()))
            sigmas.append(noise / np.sqrt(read.size))
    if not means:
        return None
    rates = np.abs(np.concatenate(others))
    rates = np.sort(rates[rates > NONZERO * sigma])
    alive = float(rates[int(EDGE_SHARE * rates.size)]) if rates.size else np.inf
    if alive < TELLING * NONZERO * sigma:  # the noise, not the zone, says which rates pass for zero
        alive = np.inf
    odds = min(_log_odds(np.array(means), np.array(sigmas), sizes), MOST_ODDS)
    return DeadZoneEvidence(axis, label_runs(rests), odds, alive, False, usual)


def _average_interval_windows(recording: Recording, x: Array, count: int) -> list[tuple[int, Array]]:
    """First sample and means over windows of each interval."""
    t = recording.gyro.t_s
    out = []
    for interval in recording.intervals:
        low, high = np.searchsorted(t, [interval.start_s - 1e-6, interval.stop_s - 1e-6])
        out.append((int(low), x[low:high][: (high - low) // count * count].reshape(-1, count).mean(axis=1)))
    return out


def _is_zero(z: Array) -> bool:
    """Whether the means of a run, in their sigmas, are zero: their squares, and those of the means of its quarters."""
    quarters = np.array([part.mean() * np.sqrt(part.size) for part in np.array_split(z, 4)])
    p = min(float(scipy.special.chdtrc(z.size, np.sum(z**2))), float(scipy.special.chdtrc(4, np.sum(quarters**2))))
    return p > CONSISTENT


def _log_odds(means: Array, sigmas: Array, sizes: Sequence[float]) -> float:
    own = np.diag(sigmas**2)
    others = [own + size**2 + (LEAK * size) ** 2 * np.eye(means.size) for size in sizes]
    read = scipy.special.logsumexp([_compute_log_density(means, other) for other in others]) - np.log(len(others))
    return _compute_log_density(means, own) - float(read)


def _compute_log_density(means: Array, covariance: Array) -> float:
    """Compute the log density of normal variables of a covariance, but for a constant of their number."""
    factor = np.linalg.cholesky(covariance)
    white = scipy.linalg.solve_triangular(factor, means, lower=True, check_finite=False)
    return float(-0.5 * white @ white - np.log(np.diag(factor)).sum())
