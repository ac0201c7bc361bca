"""Arcs of a recording for the propagation: one arc per interval, an output at every reference attitude.

An arc starts at the interval's first reference attitude and has an output at each later one, also where that falls inside a
gyro sample: the sample is then cut in two steps of the same rate.

A coarser step of f samples can be made in two ways, both counted afresh from every reference attitude, so that no step reaches
across one: *skip* holds the first of every f samples over the whole step, as N section V did, *average* uses their mean.
Skipping leaves the noise of one sample in a step of f samples, so the integrated rate noise has f times the variance;
averaging leaves it as it was.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from gyrocal.arrays import Array, Indices
from gyrocal.calibration.propagation import Arcs
from gyrocal.errors import InputError
from gyrocal.recording import GyroStream, Recording, find_reference_rows

Resampling = Literal["skip", "average"]

TAG_ROUNDING = 1e-6  # of a sample


@dataclass(frozen=True)
class Measurements:
    """The arcs of a recording and the reference attitudes at their ends."""

    arcs: Arcs  # an arc for each interval
    start: Indices  # (m,) row of the reference attitude that output j is propagated from
    row: Indices  # (m,) row of the reference attitude output j is compared with
    elapsed_s: Array  # (m,) time between the two
    noise_gain: float  # variance of the integrated gyro noise relative to that of the full stream
    held_s: float  # time of missing samples over which the last one is held


def prepare_measurements(
    recording: Recording,
    step_s: float | None = None,
    resampling: Resampling = "average",
    max_gap_s: float | None = None,
) -> Measurements:
    """Build the propagation arcs of a recording and match their outputs with the reference attitudes.

    Raises an `InputError` if gyro samples are missing in an interval or step_s is not a multiple of the sample.

    step_s: propagation step, a whole multiple of the sample; the sample itself by default
    resampling: how a coarser step is made, see the module
    max_gap_s: longest gap that is bridged by holding the last sample; half a sample by default
    """
    gyro = recording.gyro
    factor = _count_step_samples(step_s, gyro.sample_s)
    if max_gap_s is not None and not 0 <= max_gap_s < np.inf:
        raise InputError(f"the longest gap must be a finite time of zero or more seconds, not {max_gap_s:g}")
    limit = gyro.sample_s + max(0.5 * gyro.sample_s, max_gap_s or 0.0)
    parts: list[_ArcSteps] = []
    steps, fine_steps, held_s = 0, 0, 0.0
    for number in range(len(recording.intervals)):
        part, part_held_s = _cut_arc(recording, number, factor, limit)
        parts.append(part._replace(fine=fine_steps + part.fine, first=steps + part.first, last=steps + part.last))
        held_s += part_held_s
        steps += len(part.dt)
        fine_steps += len(part.fine_dt)
    joined = _ArcSteps(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
    outputs = joined.first, joined.last, joined.arc
    if resampling == "average" and factor > 1:
        arcs = Arcs(gyro.rates, joined.dt, joined.sample, *outputs, np.append(joined.fine, fine_steps), joined.fine_dt)
    else:
        arcs = Arcs(gyro.rates, joined.dt, joined.sample[joined.fine], *outputs)
    noise_gain = float(factor) if resampling == "skip" else 1.0
    return Measurements(arcs, joined.start, joined.row, joined.elapsed_s, noise_gain, held_s)


class _ArcSteps(NamedTuple):
    """Steps and outputs of arcs; see `gyrocal.calibration.propagation.Arcs` and `Measurements`."""

    fine_dt: Array
    sample: Indices  # gyro sample that each fine step holds
    dt: Array
    fine: Indices  # first fine step of each step
    first: Indices
    last: Indices
    arc: Indices
    start: Indices
    row: Indices
    elapsed_s: Array


def _cut_arc(recording: Recording, number: int, factor: int, max_gap_s: float) -> tuple[_ArcSteps, float]:
    """Cut interval `number` into steps, counted from its own first one; with the time over which samples are held, s."""
    gyro, interval = recording.gyro, recording.intervals[number]
    rows = find_reference_rows(recording.attitudes.t_s, interval)
    times = recording.attitudes.t_s[rows]
    low, tags = find_covering_samples(gyro, interval.name, times, max_gap_s)
    fine_dt, stretch, cuts = cut_at(tags, times)
    fine, outputs = _group_steps(cuts, factor)
    dt, arc = np.add.reduceat(fine_dt, fine), np.full(rows.size - 1, number)
    start, elapsed_s = np.full_like(arc, rows[0]), times[1:] - times[0]
    steps = _ArcSteps(fine_dt, low + stretch, dt, fine, outputs[:-1], outputs[1:], arc, start, rows[1:], elapsed_s)
    return steps, float(np.sum(np.diff(tags)[np.diff(tags) > 1.5 * gyro.sample_s] - gyro.sample_s))


def _count_step_samples(step_s: float | None, sample_s: float) -> int:
    """Count the samples of a step."""
    if step_s is None:
        return 1
    ratio = step_s / sample_s
    if not (np.isfinite(ratio) and 1 <= round(ratio) <= 10**6 and abs(ratio - round(ratio)) < 1e-9 * ratio):
        raise InputError(f"step {step_s:g} s is not a whole multiple of the gyro sample, {sample_s:g} s")
    return round(ratio)


def _group_steps(ends: Indices, factor: int) -> tuple[Indices, Indices]:
    """Group fine steps by `factor`, afresh from each of `ends`: the first fine step of each, and the ends in steps."""
    firsts = [np.arange(low, high, factor) for low, high in pairwise(ends)]
    return np.concatenate(firsts), np.concatenate([[0], np.cumsum([len(part) for part in firsts])])


def find_covering_samples(gyro: GyroStream, name: str, times: Array, max_gap_s: float) -> tuple[int, Array]:
    """Find the gyro samples that hold between the first and the last of some times.

    An `InputError` if they do not cover the times, or have a gap.

    Returns the first sample used, and the tags of all used with the end of the last.

    name: of the interval in an error
    times: (n,) ascending, s
    max_gap_s: longest time from a tag to the next
    """
    t = gyro.t_s
    # The sample that holds times[0] is the last to start at or before it.
    low = int(np.searchsorted(t, times[0] + TAG_ROUNDING * gyro.sample_s, side="right")) - 1
    high = int(np.searchsorted(t, times[-1] - TAG_ROUNDING * gyro.sample_s, side="left"))
    if low < 0 or times[0] - t[low] > max_gap_s or low >= high:
        raise InputError(
            f"interval {name}: no gyro sample covers its first reference attitude at {times[0]} s; "
            f"the gyro stream runs from {t[0]} s to {t[-1] + gyro.sample_s} s"
        )
    following = t[high] if high < t.size else np.inf
    tags = np.append(t[low:high], min(following, max(times[-1], t[high - 1] + gyro.sample_s)))
    gaps = np.flatnonzero(np.diff(tags) > max_gap_s)
    if gaps.size:
        k = gaps[0]
        raise InputError(
            f"interval {name}: no gyro samples between {tags[k] + gyro.sample_s} s and {tags[k + 1]} s "
            f"({gaps.size} such gap(s), the longest {np.diff(tags).max() - gyro.sample_s:g} s); split the interval there; "
            "a calibration alone can hold the last rate so long (max_gap_s; gyrocal calibrate --max-gap)"
        )
    return low, tags


def cut_at(edges: Array, times: Array) -> tuple[Array, Indices, Indices]:
    """Cut stretches of held rate at the wanted times; edges within a microsecond of such a time coincide with it.

    Returns durations of the steps, the stretch each belongs to, and the step counts at the wanted times.

    edges: (k + 1,) start of each stretch and the end of the last, ascending, s
    times: (n,) ascending, the first and the last within the edges, s
    """
    inside = edges[(edges > times[0]) & (edges < times[-1])]
    nearest = np.clip(np.searchsorted(times, inside), 1, len(times) - 1)
    distance = np.minimum(np.abs(inside - times[nearest - 1]), np.abs(inside - times[nearest]))
    cuts = np.union1d(inside[distance > 1e-6], times)
    stretch = np.clip(np.searchsorted(edges, 0.5 * (cuts[:-1] + cuts[1:]), side="right") - 1, 0, len(edges) - 2)
    return np.diff(cuts), stretch, np.searchsorted(cuts, times)
