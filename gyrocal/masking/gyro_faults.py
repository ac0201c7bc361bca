"""Gyros that are clipped or that stop at a level.

A clipped gyro stands at the end of its range, and its rate runs up to the end: the last reading before a plateau is as near to
it as readings are to one another. Readings that are exactly the largest show it by themselves. Where a sensor filters or turns
what was clipped, the largest readings crowd within a narrow band, as those of a steady rate do. There the references have to
turn beyond the band.

A gyro that stops shows one level whatever the motion: a converter or a supply that drops out. It differs

- from a steady rate by the references, which the gyro's turn does not fit there and fits before and after;
- from a dead zone in that the gyro reads rates as small elsewhere;
- from repeated samples in that the level does not go on from the reading before.
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

GAP_SAMPLES = 1.5  # without a sample
SMALLEST_NOISE = 1e-12  # rad/s, of a gyro that shows none
# readings at the largest
FEWEST_CLIPPED = 5
FEWEST_PLATEAU = 20  # samples in a run of them on a lattice
OFTEN = 3  # times as often as any other reading
PLATEAU_P = 1e-8  # chance of a steady rate to stand still that long
OUTSIDE = 5  # readings before and after a plateau, whose largest change is what a reading changes by there
REACHED = 2.0  # of those changes, up to which the rate runs up to the plateau
CLOSE = (0.95, 0.5)  # share of the ends of plateaus at which it does, of a gyro that is clipped and of one that stops
BANDS = (0.002, 0.005, 0.01, 0.02)  # of the largest reading, in which clipped readings with noise crowd
FEWEST_CROWDED = 10
FEWEST_RUNS = 3  # of the readings in a band
BEYOND_SIGMAS = 5.0  # of the turn beyond a band, median over its runs
BESIDE = 0.5  # of that turn, below which the gyro is off on the steps beside a run
# stretches at a level
FEWEST_SAMPLES = 8
FEWEST_STEPS = 20  # of references, to know their scatter
LEVEL_SIGMAS, LEVEL_STEPS = 8.0, 2.5  # range of readings at a level: of the white noise, and in steps of a converter
MISFIT = 12.0  # sigmas of the turn that the stretch misses
FITTING = 0.25  # of the misfit in the stretch, below which that before and after it lies
NEIGHBOUR_STEPS = 5  # steps before and after that are looked at
READ = 3  # steps elsewhere that show rates as small
SHARED = 0.7  # of the stretch of another axis, which is then the same
GOES_ON = 3  # readings before a stretch that say how it would go on
MOST_LOST = 0.5  # of the samples, above which they are no exceptions


class Level(NamedTuple):
    """Samples low to high of one gyro that read about the same, rad/s."""

    axis: int
    low: int
    high: int
    value: float


# ---- clipped -------------------------------------------------------------------------------------------------------------


def find_plateaus(recording: Recording, seen: Innovations) -> list[MaskedStretch]:
    """Find gyros whose largest reading stands still where no lattice makes it."""
    rates, used = recording.gyro.rates, mark_interval_samples(recording)
    sigma = max(recording.gyro.arw / float(np.sqrt(recording.gyro.sample_s)), SMALLEST_NOISE)
    # A largest reading that telemetry repeats stands still on all axes; of a clipped gyro the others go on.
    held = np.append(False, (rates[1:] == rates[:-1]).all(axis=1))
    out = []
    for axis, sign in ((axis, sign) for axis in range(3) for sign in (1.0, -1.0)):
        x = sign * rates[:, axis]
        largest = float(x[used].max(initial=0.0))
        at = used & (x >= largest * (1 - 1e-12))
        # The same largest reading in both directions is the end of a range, however the rate gets there.
        symmetric = abs(float(x[used].min(initial=0.0)) + largest) <= 1e-12 * largest
        # A gyro that reads zero throughout is dead, not clipped.
        often = largest > 0 and (at & ~held).sum() >= FEWEST_CLIPPED and _stands_still(x, at, used & ~held, sigma)
        if often and (symmetric or is_reached(x, at, sigma)):
            out += _list_clipped(recording, axis, at, sign * largest)
    return out


def find_noisy_plateaus(recording: Recording, seen: Innovations) -> list[MaskedStretch]:
    """Find gyros whose largest readings crowd within a narrow band beyond which the references turn."""
    used, begin = mark_interval_samples(recording), recording.gyro.t_s
    start, stop = (recording.attitudes.t_s[rows] for rows in (seen.first, seen.second))
    low, high = np.searchsorted(begin, start, side="right") - 1, np.searchsorted(begin, stop, side="left")
    beyond = -seen.values @ np.linalg.inv(recording.gyro.apriori_G).T / seen.sigma.max(axis=1, keepdims=True)
    out = []
    for axis, sign in ((axis, sign) for axis in range(3) for sign in (1.0, -1.0)):
        x = sign * recording.gyro.rates[:, axis]
        at = _find_crowd(x, used)
        counted = np.append(0, np.cumsum(at))
        inside = counted[np.maximum(high, 0)] > counted[np.maximum(low, 0)]
        runs = find_mask_runs(inside)
        if len(runs) < FEWEST_RUNS:
            continue
        total = np.append(0.0, np.cumsum(sign * beyond[:, axis]))
        turned = float(np.median([total[b] - total[a] for a, b in runs]))
        # A steady rate that is off, as after a step of the bias, is off beside the band as well.
        ends = [(max(a - NEIGHBOUR_STEPS, 0), a) for a, _ in runs] + [
            (b, min(b + NEIGHBOUR_STEPS, inside.size)) for _, b in runs
        ]
        missed = float(np.median([abs(total[b] - total[a]) for a, b in ends]))
        if turned > BEYOND_SIGMAS and missed < BESIDE * turned:
            out += _list_clipped(recording, axis, at, sign * float(np.median(x[at])))
    return out


def _find_crowd(x: Array, used: Mask) -> Mask:
    """Samples (n,) in the widest band below the largest reading that holds `OFTEN` times as many as the band below it."""
    largest = float(x[used].max(initial=0.0))
    for width in largest * np.array(BANDS[::-1]):
        at = used & (x > largest - width)
        crowd = at.sum() >= max(FEWEST_CROWDED, OFTEN * (used & ~at & (x > largest - 2 * width)).sum())
        # A clipped rate runs through the readings below the band, where a steady one with noise stays.
        ends = [x[k] for low, high in find_mask_runs(at) for k in (low - OUTSIDE, high + OUTSIDE) if 0 <= k < x.size]
        # Readings on a lattice that is as coarse as the band are there for being rounded.
        differ = np.unique(x[at]).size >= FEWEST_CLIPPED
        if crowd and differ and ends and np.median(ends) < largest - OFTEN * width:
            return np.asarray(at)
    return np.zeros_like(used)


def _stands_still(x: Array, at: Mask, others: Mask, sigma: float) -> bool:
    """Whether the largest reading is there more often than numbers with few digits, or a steady rate on a lattice, make it.

    A noisy reading stays on its lattice point at best with the probability that noise is less than half a step.
    """
    step = float(np.diff(np.unique(np.abs(x[others | at]))).min(initial=np.inf))
    if step < sigma:
        # Neither a reading of zero nor the other end of the range is one of the others.
        usual = x[others & ~at & (x != 0.0) & (x > x[others].min())]
        counts = np.unique(np.abs(usual), return_counts=True)[1]
        return bool((at & others).sum() >= OFTEN * counts.max(initial=0))
    longest = max(high - low for low, high in find_mask_runs(at))
    stays = float(erf(0.5 * step / sigma / np.sqrt(2)))
    chance = np.log(at.size) + longest * np.log(stays)
    return bool(longest >= FEWEST_PLATEAU and chance < np.log(PLATEAU_P))


def is_reached(x: Array, at: Mask, sigma: float) -> bool:
    """Whether readings (n,) run up to their largest, where they are `at`, as they do under clipping and not under a stop."""
    log_odds = 0.0
    for low, high in find_mask_runs(at):
        for outside in (x[max(low - OUTSIDE, 0) : low][::-1], x[high : high + OUTSIDE]):
            if outside.size == OUTSIDE:
                change = max(float(np.abs(np.diff(outside)).max()), sigma)
                close = abs(float(x[low] - outside[0])) <= REACHED * change
                log_odds += np.log(CLOSE[0] / CLOSE[1]) if close else np.log((1 - CLOSE[0]) / (1 - CLOSE[1]))
    return log_odds >= 0


def _list_clipped(recording: Recording, axis: int, at: Mask, level: float) -> list[MaskedStretch]:
    """List the stretches of clipped samples, with one sample before and after, in which the clipping begins and ends."""
    spans = _merge_spans(recording, [(low - 1, high + 1) for low, high in find_mask_runs(at)])
    return [MaskedStretch("clipped", "xyz"[axis], *span, float(np.rad2deg(level))) for span in spans]


def _merge_spans(recording: Recording, runs: list[tuple[int, int]]) -> list[tuple[float, float]]:
    """Begin and end, s, of runs of samples that overlap or touch, without gaps of the stream."""
    t_s, sample_s = recording.gyro.t_s, recording.gyro.sample_s
    lost = np.zeros(t_s.size, dtype=bool)
    for low, high in runs:
        lost[max(low, 0) : high] = True
    ends = np.append(np.diff(t_s) > GAP_SAMPLES * sample_s, True)
    out = []
    for low, high in find_mask_runs(lost):
        edges = [low, *(low + 1 + np.flatnonzero(ends[low : high - 1])), high]
        out += [(float(t_s[a]), float(t_s[b - 1] + sample_s)) for a, b in pairwise(edges)]
    return out


def mark_interval_samples(recording: Recording) -> Mask:
    """Samples (n,) that begin inside an interval."""
    t_s = recording.gyro.t_s
    out = np.zeros(t_s.size, dtype=bool)
    for interval in recording.intervals:
        low, high = np.searchsorted(t_s, [interval.start_s - 1e-6, interval.stop_s - 1e-6])
        out[low:high] = True
    return out


# ---- stopped -------------------------------------------------------------------------------------------------------------


def find_stops(recording: Recording, seen: Innovations) -> list[MaskedStretch]:
    """Find stretches at a level that the references contradict, of all gyros together or of one."""
    if len(seen.values) < FEWEST_STEPS:
        return []
    missed = seen.values @ np.linalg.inv(recording.gyro.apriori_G).T
    levels = [one for axis in range(3) for one in _find_levels(recording, axis)]
    stops = [one for one in levels if _is_stop(recording, seen, missed, one)]
    common = [one for one in stops if all(_is_shared(one, levels, axis) for axis in range(3))]
    out = []
    for axis in (None, *range(3)):
        own = common if axis is None else [one for one in stops if one not in common and one.axis == axis]
        spans = _merge_spans(recording, [(one.low - 1, one.high + 1) for one in own])
        if sum(stop - begin for begin, stop in spans) < MOST_LOST * float(np.ptp(recording.gyro.t_s)):
            level = float(np.rad2deg(np.median([one.value for one in own]))) if own else 0.0
            out += [MaskedStretch("stopped", None if axis is None else "xyz"[axis], *span, level) for span in spans]
    return out


def _find_levels(recording: Recording, axis: int) -> list[Level]:
    """Find the stretches of a gyro in which the reading stays within the range of its noise, inside the intervals."""
    x, tolerance = recording.gyro.rates[:, axis], _compute_tolerance(recording, axis)
    out = []
    for begin, end in find_mask_runs(mark_interval_samples(recording)):
        for low, high in _find_runs(np.ascontiguousarray(x[begin:end]), tolerance):
            if high - low >= FEWEST_SAMPLES:
                first, stop = begin + int(low), begin + int(high)
                out.append(Level(axis, first, stop, float(np.median(x[first:stop]))))
    return out


def _compute_tolerance(recording: Recording, axis: int) -> float:
    """Range of the readings at a level, rad/s."""
    steps = np.abs(np.diff(recording.gyro.rates[:, axis]))
    step = float(steps[steps > 0].min(initial=np.inf))
    sigma = recording.gyro.arw / np.sqrt(recording.gyro.sample_s)
    return float(max(LEVEL_SIGMAS * sigma, LEVEL_STEPS * step if np.isfinite(step) else 0.0, 1e-12))


def _is_stop(recording: Recording, seen: Innovations, missed: Array, one: Level) -> bool:
    """Whether the references contradict a level, and nothing else makes it; missed (k, 3) are innovations about the gyros."""
    gyro, t_s = recording.gyro, recording.attitudes.t_s
    start, stop = t_s[seen.first], t_s[seen.second]
    inside = np.flatnonzero((start >= gyro.t_s[one.low]) & (stop <= gyro.t_s[one.high - 1] + gyro.sample_s))
    if not inside.size:
        return False
    own, sigma = missed[inside, one.axis], float(seen.sigma[inside].max())
    error = own / seen.duration_s[inside]  # of the rate that the gyro shows
    turned = float(np.abs(np.cumsum(own)).max())
    # A reference that is false for a moment contradicts a few steps only.
    if turned < MISFIT * sigma or np.median(np.abs(error)) < 2 * _compute_tolerance(recording, one.axis):
        return False
    # It works before and after, in the same interval, over as many steps; a step lies across each end.
    joins = np.cumsum(np.append(0, seen.first[1:] != seen.second[:-1]))
    alike, places = joins == joins[inside[0]], np.arange(joins.size)
    count = max(inside.size, NEIGHBOUR_STEPS)
    sides = (
        missed[alike & (places < inside[0] - 1), one.axis][-count:],
        missed[alike & (places > inside[-1] + 1), one.axis][:count],
    )
    if any(not side.size or np.abs(np.cumsum(side)).max() > FITTING * turned for side in sides):
        return False
    return not (_is_dead_zone(recording, seen, missed, one, error) or _is_extrapolated(recording, one))


def _is_dead_zone(recording: Recording, seen: Innovations, missed: Array, one: Level, error: Array) -> bool:
    """Whether the level is zero and no rate as small as the true one is read anywhere."""
    tolerance = _compute_tolerance(recording, one.axis)
    if abs(one.value) > tolerance:
        return False
    rate = np.abs(seen.turned[:, one.axis] / seen.duration_s)
    fits = np.abs(missed[:, one.axis]) < 4 * seen.sigma[:, one.axis]
    return bool(np.sum(fits & (rate > tolerance) & (rate < float(np.abs(error).max()))) < READ)


def _is_extrapolated(recording: Recording, one: Level) -> bool:
    """Whether the level is where the readings before would go, as that of repeated samples is."""
    raw, place = recording.gyro.rates, one.low - 1
    inner = raw[one.low + 2 : one.high - 2]
    if (inner[1:] != inner[:-1]).any():  # repeats agree exactly
        return False
    while place > 0 and (raw[place] == raw[place - 1]).all():  # itself a repeat
        place -= 1
    if place < GOES_ON - 1:
        return False
    last, gap = raw[place - GOES_ON + 1 : place + 1, one.axis], one.low - place
    change, bend = gap * float(last[-1] - last[0]) / (GOES_ON - 1), gap**2 * abs(float(np.diff(last, 2)[-1]))
    within = 1.5 * _compute_tolerance(recording, one.axis) + 2 * abs(change) + 2 * bend
    return bool(abs(float(last[-1]) + change - one.value) < within)


def _is_shared(one: Level, levels: list[Level], axis: int) -> bool:
    """Whether a gyro is at a level in most of a stretch."""
    shared = sum(max(min(one.high, level.high) - max(one.low, level.low), 0) for level in levels if level.axis == axis)
    return shared >= SHARED * (one.high - one.low)


@compile_cached
def _find_runs(x, tolerance):  # type: ignore[no-untyped-def]
    """First and last + 1 of stretches (r, 2) in which all readings lie within a range."""
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
