"""From a recording to the arcs the propagation runs over: one arc per interval, an output at every reference attitude.

An arc starts at the interval's first reference attitude and has an output at each later one, also where that falls inside a
gyro sample: the sample is then cut in two steps of the same rate.

A coarser step of f samples can be made in two ways, both counted from the interval's first sample: *skip* holds the first of
every f samples over the whole step, as N section V did, *average* uses their mean. Skipping leaves the noise of one sample
in a step of f samples, so the integrated rate noise has f times the variance; averaging leaves it as it was.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.propagation import Arcs
from gyrocal.recording import GyroStream, Interval, Recording, reference_rows

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Resampling = Literal["skip", "average"]

TAG_ROUNDING = 1e-6  # of a sample


@dataclass(frozen=True)
class Measurements:
    """The arcs of a recording and the reference attitudes at their ends.

    Attributes
    ----------
    arcs : an arc for each interval
    start : (m,) row of the reference attitude that output j is propagated from
    row : (m,) row of the reference attitude output j is compared with
    elapsed_s : (m,) time between the two
    noise_gain : variance of the integrated gyro noise relative to that of the full stream
    """

    arcs: Arcs
    start: Indices
    row: Indices
    elapsed_s: Array
    noise_gain: float


def measurements(
    recording: Recording,
    step_s: float | None = None,
    resampling: Resampling = "skip",
    max_gap_s: float | None = None,
) -> Measurements:
    """Arcs and references of a recording.

    Parameters
    ----------
    recording : the recording
    step_s : propagation step, a whole multiple of the sample; the sample itself by default
    resampling : how a coarser step is made
    max_gap_s : longest stretch without a new sample that the last one may be held over; 1.5 samples by default

    Raises
    ------
    InputError
        The gyro stream does not cover an interval, has a gap in it, or step_s is not a multiple of the sample.
    """
    gyro = recording.gyro
    factor = 1 if step_s is None else round(step_s / gyro.sample_s)
    if step_s is not None and (factor < 1 or abs(step_s - factor * gyro.sample_s) > 1e-9 * gyro.sample_s):
        raise InputError(f"step {step_s:g} s is not a whole multiple of the gyro sample, {gyro.sample_s:g} s")
    limit = 1.5 * gyro.sample_s if max_gap_s is None else max_gap_s
    span_s = np.zeros(gyro.t_s.size)
    parts: list[tuple[NDArray[Any], ...]] = []
    offset = 0
    for number, interval in enumerate(recording.intervals):
        rows = reference_rows(recording.attitudes.t_s, interval)
        times = recording.attitudes.t_s[rows]
        low, tags = _covering_samples(gyro, interval, times, limit)
        span_s[low : low + len(tags) - 1] = np.diff(tags)
        dt, group, ends = _cut_at(np.append(tags[:-1:factor], tags[-1]), times)
        sample = low + factor * group
        count = np.minimum(factor, low + len(tags) - 1 - sample) if resampling == "average" else np.ones_like(sample)
        outputs = np.full(rows.size - 1, number)
        first, last = offset + ends[:-1], offset + ends[1:]
        parts.append((dt, sample, count, first, last, outputs, np.full_like(outputs, rows[0]), rows[1:], times[1:] - times[0]))
        offset += len(dt)
    dt, sample, count, first, last, arc, start, row, elapsed = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Measurements(
        arcs=Arcs(gyro.rates, dt, sample, first, last, arc, count, span_s),
        start=start,
        row=row,
        elapsed_s=elapsed,
        noise_gain=float(factor) if resampling == "skip" else 1.0,
    )


def _covering_samples(gyro: GyroStream, interval: Interval, times: Array, max_gap_s: float) -> tuple[int, Array]:
    """First sample used between times[0] and times[-1], and the tags of all used with the end of the last."""
    t = gyro.t_s
    # The sample that holds times[0] is the last to start at or before it.
    low = int(np.searchsorted(t, times[0] + TAG_ROUNDING * gyro.sample_s, side="right")) - 1
    high = int(np.searchsorted(t, times[-1] - TAG_ROUNDING * gyro.sample_s, side="left"))
    if low < 0 or times[0] - t[low] > max_gap_s or low >= high:
        raise InputError(f"interval {interval.name}: no gyro sample covers its first reference attitude at {times[0]} s")
    following = t[high] if high < t.size else np.inf
    tags = np.append(t[low:high], min(following, max(times[-1], t[high - 1] + gyro.sample_s)))
    gaps = np.flatnonzero(np.diff(tags) > max_gap_s)
    if gaps.size:
        k = gaps[0]
        raise InputError(
            f"interval {interval.name}: no gyro samples between {tags[k] + gyro.sample_s} s and {tags[k + 1]} s "
            f"({gaps.size} such gap(s)); split the interval there, or allow holding the last rate with max_gap_s"
        )
    return low, tags


def _cut_at(edges: Array, times: Array) -> tuple[Array, Indices, Indices]:
    """Cut stretches of held rate at the wanted times; edges within a microsecond of one of them are that time.

    Returns
    -------
    Durations of the steps, the stretch each belongs to, and the step counts at the wanted times.
    """
    inside = edges[(edges > times[0]) & (edges < times[-1])]
    nearest = np.clip(np.searchsorted(times, inside), 1, len(times) - 1)
    apart = np.minimum(np.abs(inside - times[nearest - 1]), np.abs(inside - times[nearest]))
    cuts = np.union1d(inside[apart > 1e-6], times)
    stretch = np.clip(np.searchsorted(edges, 0.5 * (cuts[:-1] + cuts[1:]), side="right") - 1, 0, len(edges) - 2)
    return np.diff(cuts), stretch, np.searchsorted(cuts, times)
