"""Gyros that are clipped or that stop at a level.

A clipped gyro reads the end of its range, and its rate approaches the end: the last reading before a plateau is as near to it
as readings are to one another. A repeated largest reading is sufficient evidence. If a sensor filters or rotates clipped rates,
the largest readings crowd within a narrow band, as those of a steady rate do. Then the references have to show a rate beyond
the band.

A gyro that stops, as by a converter or a supply that drops out, reads one level at any motion. It differs

- from a steady rate: the references contradict the gyro in the stretch, and agree with it before and after;
- from a dead zone: the gyro reads equally small rates elsewhere;
- from repeated samples: the level does not continue the readings before it.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import erf

from gyrocal.arrays import Array, Mask
from gyrocal.innovations import Innovations
from gyrocal.jit_cache import compile_cached
from gyrocal.mask_runs import find_mask_runs
from gyrocal.masking.mask import MaskedStretch
from gyrocal.recording import Recording

GAP_SAMPLES = 1.5  # between two samples: a longer spacing is a gap
SMALLEST_NOISE = 1e-12  # rad/s, of a gyro without noise
# readings at the largest
FEWEST_CLIPPED = 5
FEWEST_PLATEAU = 20  # samples in a run of them on a lattice
FREQUENCY_RATIO = 3  # times as often as any other reading
PLATEAU_P = 1e-8  # chance of a steady rate to stand still that long
OUTSIDE_READINGS = 5  # readings before and after a plateau, whose largest change is the usual change of a reading
MOST_CHANGES_BELOW = 2.0  # usual changes from the plateau to the next reading, if the rate approaches the plateau
CLOSE_SHARES = (0.95, 0.5)  # share of the ends of plateaus that a rate approaches, of a clipped gyro and of one that stops
BAND_WIDTHS = (0.002, 0.005, 0.01, 0.02)  # of the largest reading, in which clipped readings with noise crowd
FEWEST_CROWDED = 10
FEWEST_RUNS = 3  # of the readings in a band
BEYOND_SIGMAS = 5.0  # of the turn beyond a band, median over its runs
MOST_MISSED_BESIDE = 0.5  # of that turn: largest innovations on the steps beside a run
# stretches at a level
FEWEST_SAMPLES = 8
FEWEST_STEPS = 20  # of references, to estimate their scatter
LEVEL_SIGMAS, LEVEL_STEPS = 8.0, 2.5  # range of readings at a level: in sigmas of the white noise, and in steps of a converter
LEAST_MISFIT_SIGMAS = 12.0  # of the summed innovations in the stretch
MOST_MISFIT_AROUND = 0.25  # of the misfit in the stretch: largest misfit before and after it
NEIGHBOUR_STEPS = 5  # steps before and after a stretch that are compared with it
FEWEST_SMALL_RATES = 3  # steps elsewhere with equally small rates
LEAST_SHARED_SHARE = 0.7  # overlap of the stretches of two axes that are the same
EXTRAPOLATED_READINGS = 3  # readings before a stretch that are extrapolated into it
MOST_STOPPED_SHARE = 0.5  # of the time: longer stretches are no faults


class Level(NamedTuple):
    """Samples low to high of one gyro with nearly equal readings, of median value, rad/s."""

    axis: int
    low: int
    high: int
    value: float


# ---- clipped -------------------------------------------------------------------------------------------------------------


def find_plateaus(recording: Recording, innovations: Innovations) -> list[MaskedStretch]:
    """Find gyros with a largest reading that repeats more often than a lattice of readings explains."""
    rates, in_interval = recording.gyro.rates, mark_interval_samples(recording)
    sigma = max(recording.gyro.arw / float(np.sqrt(recording.gyro.sample_s)), SMALLEST_NOISE)
    # A largest reading that telemetry repeats stands still on all axes; of a clipped gyro the others go on.
    is_repeated = np.append(False, (rates[1:] == rates[:-1]).all(axis=1))
    out = []
    for axis, sign in ((axis, sign) for axis in range(3) for sign in (1.0, -1.0)):
        x = sign * rates[:, axis]
        largest = float(x[in_interval].max(initial=0.0))
        is_largest = in_interval & (x >= largest * (1 - 1e-12))
        # The same largest reading in both directions is the end of a range, even if the rate jumps to it.
        symmetric = abs(float(x[in_interval].min(initial=0.0)) + largest) <= 1e-12 * largest
        # A gyro that reads zero throughout is dead, not clipped.
        if largest <= 0 or (is_largest & ~is_repeated).sum() < FEWEST_CLIPPED:
            continue
        if _stands_still(x, is_largest, in_interval & ~is_repeated, sigma) and (symmetric or is_reached(x, is_largest, sigma)):
            out += _list_clipped(recording, axis, is_largest, sign * largest)
    return out


def find_noisy_plateaus(recording: Recording, innovations: Innovations) -> list[MaskedStretch]:
    """Find gyros whose largest readings crowd within a narrow band, while the references show larger rates."""
    in_interval, begin = mark_interval_samples(recording), recording.gyro.t_s
    start, stop = (recording.attitudes.t_s[rows] for rows in (innovations.first, innovations.second))
    low, high = np.searchsorted(begin, start, side="right") - 1, np.searchsorted(begin, stop, side="left")
    beyond = -innovations.values @ np.linalg.inv(recording.gyro.apriori_G).T / innovations.sigma.max(axis=1, keepdims=True)
    out = []
    for axis, sign in ((axis, sign) for axis in range(3) for sign in (1.0, -1.0)):
        x = sign * recording.gyro.rates[:, axis]
        is_crowded = _find_crowd(x, in_interval)
        crowded_before = np.append(0, np.cumsum(is_crowded))
        inside = crowded_before[np.maximum(high, 0)] > crowded_before[np.maximum(low, 0)]
        runs = find_mask_runs(inside)
        if len(runs) < FEWEST_RUNS:
            continue
        total = np.append(0.0, np.cumsum(sign * beyond[:, axis]))
        excess = float(np.median([total[b] - total[a] for a, b in runs]))
        # A steady rate with an error, as after a step of the bias, has it beside the band as well.
        ends = [(max(a - NEIGHBOUR_STEPS, 0), a) for a, _ in runs] + [
            (b, min(b + NEIGHBOUR_STEPS, inside.size)) for _, b in runs
        ]
        missed_beside = float(np.median([abs(total[b] - total[a]) for a, b in ends]))
        if excess > BEYOND_SIGMAS and missed_beside < MOST_MISSED_BESIDE * excess:
            out += _list_clipped(recording, axis, is_crowded, sign * float(np.median(x[is_crowded])))
    return out


def _find_crowd(x: Array, in_interval: Mask) -> Mask:
    """Find samples (n,) in the widest band below the largest reading with `FREQUENCY_RATIO` times those of the next band."""
    largest = float(x[in_interval].max(initial=0.0))
    for width in largest * np.array(BAND_WIDTHS[::-1]):
        in_band = in_interval & (x > largest - width)
        below = in_interval & ~in_band & (x > largest - 2 * width)
        is_crowded = in_band.sum() >= max(FEWEST_CROWDED, FREQUENCY_RATIO * below.sum())
        # A clipped rate comes from far below the band, a steady one with noise stays near it.
        outside = [k for low, high in find_mask_runs(in_band) for k in (low - OUTSIDE_READINGS, high + OUTSIDE_READINGS)]
        ends = [x[k] for k in outside if 0 <= k < x.size]
        # On a lattice as coarse as the band, rounding makes the readings equal.
        is_varied = np.unique(x[in_band]).size >= FEWEST_CLIPPED
        if is_crowded and is_varied and ends and np.median(ends) < largest - FREQUENCY_RATIO * width:
            return np.asarray(in_band)
    return np.zeros_like(in_interval)


def _stands_still(x: Array, is_largest: Mask, others: Mask, sigma: float) -> bool:
    """Whether the largest reading repeats more often than numbers with few digits, or a steady rate on a lattice, explain.

    A noisy reading stays on its lattice point with at most the probability that its noise is less than half a step.
    """
    step = float(np.diff(np.unique(np.abs(x[others | is_largest]))).min(initial=np.inf))
    if step < sigma:
        # Zero and the other end of the range are no usual readings.
        usual = x[others & ~is_largest & (x != 0.0) & (x > x[others].min())]
        counts = np.unique(np.abs(usual), return_counts=True)[1]
        return bool((is_largest & others).sum() >= FREQUENCY_RATIO * counts.max(initial=0))
    longest = max(high - low for low, high in find_mask_runs(is_largest))
    stays = float(erf(0.5 * step / sigma / np.sqrt(2)))
    chance = np.log(is_largest.size) + longest * np.log(stays)
    return bool(longest >= FEWEST_PLATEAU and chance < np.log(PLATEAU_P))


def is_reached(x: Array, is_largest: Mask, sigma: float) -> bool:
    """Whether readings (n,) approach their largest value gradually, as they do under clipping and not under a stop."""
    log_odds = 0.0
    for low, high in find_mask_runs(is_largest):
        for outside in (x[max(low - OUTSIDE_READINGS, 0) : low][::-1], x[high : high + OUTSIDE_READINGS]):
            if outside.size == OUTSIDE_READINGS:
                change = max(float(np.abs(np.diff(outside)).max()), sigma)
                is_close = abs(float(x[low] - outside[0])) <= MOST_CHANGES_BELOW * change
                clipped, stopped = CLOSE_SHARES if is_close else (1 - share for share in CLOSE_SHARES)
                log_odds += np.log(clipped / stopped)
    return log_odds >= 0


def _list_clipped(recording: Recording, axis: int, is_clipped: Mask, level: float) -> list[MaskedStretch]:
    """List the stretches of clipped samples, with one sample before and after, in which the clipping begins and ends."""
    spans = _merge_spans(recording, [(low - 1, high + 1) for low, high in find_mask_runs(is_clipped)])
    return [MaskedStretch("clipped", "xyz"[axis], *span, float(np.rad2deg(level))) for span in spans]


def _merge_spans(recording: Recording, runs: list[tuple[int, int]]) -> list[tuple[float, float]]:
    """Merge runs of samples that overlap or touch; return the begin and end of each, s, without gaps of the stream."""
    t_s, sample_s = recording.gyro.t_s, recording.gyro.sample_s
    is_masked = np.zeros(t_s.size, dtype=bool)
    for low, high in runs:
        is_masked[max(low, 0) : high] = True
    ends = np.append(np.diff(t_s) > GAP_SAMPLES * sample_s, True)
    out = []
    for low, high in find_mask_runs(is_masked):
        edges = [low, *(low + 1 + np.flatnonzero(ends[low : high - 1])), high]
        out += [(float(t_s[a]), float(t_s[b - 1] + sample_s)) for a, b in pairwise(edges)]
    return out


def mark_interval_samples(recording: Recording) -> Mask:
    """Mark the samples (n,) that begin inside an interval."""
    t_s = recording.gyro.t_s
    out = np.zeros(t_s.size, dtype=bool)
    for interval in recording.intervals:
        low, high = np.searchsorted(t_s, [interval.start_s - 1e-6, interval.stop_s - 1e-6])
        out[low:high] = True
    return out


# ---- stopped -------------------------------------------------------------------------------------------------------------


def find_stops(recording: Recording, innovations: Innovations) -> list[MaskedStretch]:
    """Find stretches at a level that the references contradict, of all gyros in common or of one."""
    if len(innovations.values) < FEWEST_STEPS:
        return []
    misses = innovations.values @ np.linalg.inv(recording.gyro.apriori_G).T
    levels = [level for axis in range(3) for level in _find_levels(recording, axis)]
    stops = [level for level in levels if _is_stop(recording, innovations, misses, level)]
    common = [level for level in stops if all(_is_shared(level, levels, axis) for axis in range(3))]
    out = []
    for axis in (None, *range(3)):
        chosen = common if axis is None else [level for level in stops if level not in common and level.axis == axis]
        spans = _merge_spans(recording, [(level.low - 1, level.high + 1) for level in chosen])
        if sum(stop - begin for begin, stop in spans) < MOST_STOPPED_SHARE * float(np.ptp(recording.gyro.t_s)):
            value = float(np.rad2deg(np.median([level.value for level in chosen]))) if chosen else 0.0
            out += [MaskedStretch("stopped", None if axis is None else "xyz"[axis], *span, value) for span in spans]
    return out


def _find_levels(recording: Recording, axis: int) -> list[Level]:
    """Find the stretches of a gyro inside the intervals in which the reading stays within the range of its noise."""
    x, tolerance = recording.gyro.rates[:, axis], _compute_tolerance(recording, axis)
    out = []
    for begin, end in find_mask_runs(mark_interval_samples(recording)):
        for low, high in _find_runs(np.ascontiguousarray(x[begin:end]), tolerance):
            if high - low >= FEWEST_SAMPLES:
                first, stop = begin + int(low), begin + int(high)
                out.append(Level(axis, first, stop, float(np.median(x[first:stop]))))
    return out


def _compute_tolerance(recording: Recording, axis: int) -> float:
    """Compute the range of the readings at a level, rad/s."""
    steps = np.abs(np.diff(recording.gyro.rates[:, axis]))
    step = float(steps[steps > 0].min(initial=np.inf))
    sigma = recording.gyro.arw / np.sqrt(recording.gyro.sample_s)
    return float(max(LEVEL_SIGMAS * sigma, LEVEL_STEPS * step if np.isfinite(step) else 0.0, 1e-12))


def _is_stop(recording: Recording, innovations: Innovations, misses: Array, level: Level) -> bool:
    """Whether the references contradict a level without another cause; misses (k, 3) are innovations about the gyros' axes."""
    gyro, t_s = recording.gyro, recording.attitudes.t_s
    start, stop = t_s[innovations.first], t_s[innovations.second]
    inside = np.flatnonzero((start >= gyro.t_s[level.low]) & (stop <= gyro.t_s[level.high - 1] + gyro.sample_s))
    if not inside.size:
        return False
    axis_misses, sigma = misses[inside, level.axis], float(innovations.sigma[inside].max())
    error = axis_misses / innovations.duration_s[inside]  # of the gyro's rate
    misfit = float(np.abs(np.cumsum(axis_misses)).max())
    # A single false reference contradicts a few steps only.
    if misfit < LEAST_MISFIT_SIGMAS * sigma or np.median(np.abs(error)) < 2 * _compute_tolerance(recording, level.axis):
        return False
    # The gyro agrees with the references before and after, in the same interval, over as many steps; a step is across each end.
    arc = np.cumsum(np.append(0, innovations.first[1:] != innovations.second[:-1]))
    same_arc, places = arc == arc[inside[0]], np.arange(arc.size)
    count = max(inside.size, NEIGHBOUR_STEPS)
    sides = (
        misses[same_arc & (places < inside[0] - 1), level.axis][-count:],
        misses[same_arc & (places > inside[-1] + 1), level.axis][:count],
    )
    if any(not side.size or np.abs(np.cumsum(side)).max() > MOST_MISFIT_AROUND * misfit for side in sides):
        return False
    return not (_is_dead_zone(recording, innovations, misses, level, error) or _is_extrapolated(recording, level))


def _is_dead_zone(recording: Recording, innovations: Innovations, misses: Array, level: Level, error: Array) -> bool:
    """Whether the level is zero and the gyro reads no rate as small as the true one anywhere."""
    tolerance = _compute_tolerance(recording, level.axis)
    if abs(level.value) > tolerance:
        return False
    rate = np.abs(innovations.turned[:, level.axis] / innovations.duration_s)
    fits = np.abs(misses[:, level.axis]) < 4 * innovations.sigma[:, level.axis]
    return bool(np.sum(fits & (rate > tolerance) & (rate < float(np.abs(error).max()))) < FEWEST_SMALL_RATES)


def _is_extrapolated(recording: Recording, level: Level) -> bool:
    """Whether the level continues the readings before it, as that of repeated samples does."""
    raw, before = recording.gyro.rates, level.low - 1
    inner = raw[level.low + 2 : level.high - 2]
    if (inner[1:] != inner[:-1]).any():  # repeats agree exactly
        return False
    while before > 0 and (raw[before] == raw[before - 1]).all():  # a repeat too
        before -= 1
    if before < EXTRAPOLATED_READINGS - 1:
        return False
    last, gap = raw[before - EXTRAPOLATED_READINGS + 1 : before + 1, level.axis], level.low - before
    change, bend = gap * float(last[-1] - last[0]) / (EXTRAPOLATED_READINGS - 1), gap**2 * abs(float(np.diff(last, 2)[-1]))
    within = 1.5 * _compute_tolerance(recording, level.axis) + 2 * abs(change) + 2 * bend
    return bool(abs(float(last[-1]) + change - level.value) < within)


def _is_shared(level: Level, levels: list[Level], axis: int) -> bool:
    """Whether the gyro of an axis, too, is at a level in most of the samples of a level."""
    overlaps = [min(level.high, second.high) - max(level.low, second.low) for second in levels if second.axis == axis]
    return sum(max(overlap, 0) for overlap in overlaps) >= LEAST_SHARED_SHARE * (level.high - level.low)


@compile_cached
def _find_runs(x, tolerance):  # type: ignore[no-untyped-def]
    """Find the first and last + 1 samples (r, 2) of stretches in which all readings lie within a range."""
    out = np.empty((x.size, 2), dtype=np.int64)
    count, i = 0, 0
    while i < x.size:
        low, high, j = x[i], x[i], i + 1
        while j < x.size:
            low, high = min(low, x[j]), max(high, x[j])
            if high - low > tolerance:
                break
            j += 1
        out[count, 0], out[count, 1] = i, j
        count, i = count + 1, j
    return out[:count]
