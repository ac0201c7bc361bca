"""From a recording to the arcs the propagation runs over: one arc per interval, an output at every reference attitude.

An arc starts at the interval's first reference attitude and has an output at each later one, also where that falls inside a
gyro sample: the sample is then cut in two steps of the same rate.

A coarser step of f samples can be made in two ways, both counted from the interval's first sample: *skip* holds the first of
every f samples over the whole step, as N section V did, *average* uses their mean. Skipping leaves the noise of one sample
in a step of f samples, so the integrated rate noise has f times the variance; averaging leaves it as it was.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.propagation import Arcs
from gyrocal.recording import GyroStream, Interval, Recording, reference_rows

Array = NDArray[np.float64]
Resampling = Literal["skip", "average"]


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
    start: NDArray[np.intp]
    row: NDArray[np.intp]
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
    raw, dt, sample, first, last, arc, start, row, elapsed = ([] for _ in range(9))
    offset = 0
    for number, interval in enumerate(recording.intervals):
        rows = reference_rows(recording.attitudes.t_s, interval)
        times = recording.attitudes.t_s[rows]
        rates, steps, index, ends = _interval_steps(gyro, interval, times, factor, resampling, limit)
        raw.append(rates)
        dt.append(steps)
        sample.append(index)
        first.append(offset + ends[:-1])
        last.append(offset + ends[1:])
        arc.append(np.full(rows.size - 1, number))
        start.append(np.full(rows.size - 1, rows[0]))
        row.append(rows[1:])
        elapsed.append(times[1:] - times[0])
        offset += len(steps)
    arcs = Arcs(*(np.concatenate(part) for part in (raw, dt, sample, first, last, arc)))
    return Measurements(
        arcs=arcs,
        start=np.concatenate(start),
        row=np.concatenate(row),
        elapsed_s=np.concatenate(elapsed),
        noise_gain=float(factor) if resampling == "skip" else 1.0,
    )


def _interval_steps(
    gyro: GyroStream, interval: Interval, times: Array, factor: int, resampling: Resampling, max_gap_s: float
) -> tuple[Array, Array, NDArray[np.intp], NDArray[np.intp]]:
    """Raw rates, durations and sample indices of the steps between times[0] and times[-1], and the step counts at times."""
    t = gyro.t_s
    # The sample that holds times[0] is the last to start at or before it; 1e-6 of a sample is rounding of the tags.
    low = int(np.searchsorted(t, times[0] + 1e-6 * gyro.sample_s, side="right")) - 1
    high = int(np.searchsorted(t, times[-1] - 1e-6 * gyro.sample_s, side="left"))
    if low < 0 or times[0] - t[low] > max_gap_s or low >= high:
        raise InputError(f"interval {interval.name}: no gyro sample covers its first reference attitude at {times[0]} s")
    tags = np.append(t[low:high], min(t[high] if high < t.size else np.inf, max(times[-1], t[high - 1] + gyro.sample_s)))
    gaps = np.flatnonzero(np.diff(tags) > max_gap_s)
    if gaps.size:
        k = gaps[0]
        raise InputError(
            f"interval {interval.name}: no gyro samples between {tags[k] + gyro.sample_s} s and {tags[k + 1]} s "
            f"({gaps.size} such gap(s)); split the interval there, or allow holding the last rate with max_gap_s"
        )
    edges = np.append(tags[:-1:factor], tags[-1])
    rates = gyro.rates[low:high:factor]
    if resampling == "average" and factor > 1:
        starts = np.arange(0, high - low, factor)
        spans = np.diff(tags)
        weighted = np.add.reduceat(gyro.rates[low:high] * spans[:, None], starts, axis=0)
        rates = weighted / np.add.reduceat(spans, starts)[:, None]
    return _cut_at(edges, rates, low + factor * np.arange(len(rates)), times)


def _cut_at(
    edges: Array, rates: Array, index: NDArray[np.intp], times: Array
) -> tuple[Array, Array, NDArray[np.intp], NDArray[np.intp]]:
    """Cut held rates at the wanted times; edges within a microsecond of one of them are that time."""
    inside = edges[(edges > times[0]) & (edges < times[-1])]
    nearest = np.clip(np.searchsorted(times, inside), 1, len(times) - 1)
    apart = np.minimum(np.abs(inside - times[nearest - 1]), np.abs(inside - times[nearest]))
    cuts = np.union1d(inside[apart > 1e-6], times)
    holder = np.clip(np.searchsorted(edges, 0.5 * (cuts[:-1] + cuts[1:]), side="right") - 1, 0, len(rates) - 1)
    return rates[holder], np.diff(cuts), index[holder], np.searchsorted(cuts, times)
