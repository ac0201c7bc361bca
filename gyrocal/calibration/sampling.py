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
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

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
    factor = _factor(step_s, gyro.sample_s)
    if max_gap_s is not None and not 0 <= max_gap_s < np.inf:
        raise InputError(f"the longest gap must be a finite time of zero or more seconds, not {max_gap_s:g}")
    limit = gyro.sample_s + max(0.5 * gyro.sample_s, max_gap_s or 0.0)
    parts: list[tuple[NDArray[Any], ...]] = []
    steps, fine_steps, held_s = 0, 0, 0.0
    for number, interval in enumerate(recording.intervals):
        rows = find_reference_rows(recording.attitudes.t_s, interval)
        times = recording.attitudes.t_s[rows]
        low, tags = find_covering_samples(gyro, interval.name, times, limit)
        fine_dt, stretch, cuts = cut_at(tags, times)
        fine, outputs = _group_steps(cuts, factor)
        dt = np.add.reduceat(fine_dt, fine)
        arc = np.full(rows.size - 1, number)
        references = np.full_like(arc, rows[0]), rows[1:], times[1:] - times[0]
        ends = steps + outputs[:-1], steps + outputs[1:]
        parts.append((fine_dt, low + stretch, dt, fine_steps + fine, *ends, arc, *references))
        held_s += float(np.sum(np.diff(tags)[np.diff(tags) > 1.5 * gyro.sample_s] - gyro.sample_s))
        steps += len(dt)
        fine_steps += len(fine_dt)
    fine_dt, sample, dt, fine, first, last, arc, start, row, elapsed = (np.concatenate(p) for p in zip(*parts, strict=True))
    averaged = resampling == "average" and factor > 1
    return Measurements(
        arcs=Arcs(gyro.rates, dt, sample, first, last, arc, np.append(fine, fine_steps), fine_dt)
        if averaged
        else Arcs(gyro.rates, dt, sample[fine], first, last, arc),
        start=start,
        row=row,
        elapsed_s=elapsed,
        noise_gain=float(factor) if resampling == "skip" else 1.0,
        held_s=held_s,
    )


def _factor(step_s: float | None, sample_s: float) -> int:
    """Samples in a step."""
    if step_s is None:
        return 1
    ratio = step_s / sample_s
    if not (np.isfinite(ratio) and 1 <= round(ratio) <= 10**6 and abs(ratio - round(ratio)) < 1e-9 * ratio):
        raise InputError(f"step {step_s:g} s is not a whole multiple of the gyro sample, {sample_s:g} s")
    return round(ratio)


def _group_steps(ends: Indices, factor: int) -> tuple[Indices, Indices]:
    """First fine step of every step of `factor` fine ones, counted afresh from each of `ends`; and those ends in steps."""
    firsts = [np.arange(low, high, factor) for low, high in pairwise(ends)]
    return np.concatenate(firsts), np.concatenate([[0], np.cumsum([len(part) for part in firsts])])


def find_covering_samples(gyro: GyroStream, name: str, times: Array, max_gap_s: float) -> tuple[int, Array]:
    """Gyro samples that hold between the first and the last of some times.

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
    """Cut stretches of held rate at the wanted times; edges within a microsecond of one of them are that time.

    Returns durations of the steps, the stretch each belongs to, and the step counts at the wanted times.

    edges: (k + 1,) start of each stretch and the end of the last, ascending, s
    times: (n,) ascending, the first and the last within the edges, s
    """
    inside = edges[(edges > times[0]) & (edges < times[-1])]
    nearest = np.clip(np.searchsorted(times, inside), 1, len(times) - 1)
    apart = np.minimum(np.abs(inside - times[nearest - 1]), np.abs(inside - times[nearest]))
    cuts = np.union1d(inside[apart > 1e-6], times)
    stretch = np.clip(np.searchsorted(edges, 0.5 * (cuts[:-1] + cuts[1:]), side="right") - 1, 0, len(edges) - 2)
    return np.diff(cuts), stretch, np.searchsorted(cuts, times)
