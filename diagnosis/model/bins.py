"""Rate errors that follow something, bin by bin, as columns: what the unlisted rivals are made of.

Some errors follow the step or the bin in progress at a reference. An interval ends with a reference, behind its last step. The
next step is of another interval, in which the body may turn about another axis, or rest: what is in progress at that reference
is the last step of its own interval.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.sparse

from diagnosis.arrays import AXES
from diagnosis.model.linear import CandidateColumns, build_rival
from diagnosis.model.recording_model import RecordingModel
from gyrocal.arrays import Array, Indices

LONGEST = 8.0  # s, of a bin; the slews of most spacecraft take minutes
MOST = 6000  # bins about, of a recording whose motion may be faster


@dataclass(frozen=True)
class Bins:
    """Short times over which smooth regressors are taken as constant."""

    turned: Array  # (n, 3, 3) Aᵀ dt summed
    t_s: Array
    rates: Array  # (n, 3)
    acceleration: Array  # (n, 3)
    since_s: Array  # since the interval's start
    dt: Array
    interval: Indices
    ends: list[Indices]  # of each block: bins done at each reference


def build_bins(model: RecordingModel, bin_s: float | None = None) -> Bins:
    """Build bins that end at every reference, of about `bin_s`, by default as short as a few thousand bins allow."""
    bin_s = min(LONGEST, float(model.dt.sum()) / MOST) if bin_s is None else bin_s
    first: list[Indices] = []
    ends: list[Indices] = []
    interval = []
    step = max(1, round(bin_s / float(np.median(model.dt))))
    count = 0
    for number, block in enumerate(model.blocks):
        length = block.steps.stop - block.steps.start
        inner = np.union1d(np.arange(0, length, step), block.ends[block.ends < length])
        first.append(inner + block.steps.start)
        ends.append(np.searchsorted(inner, block.ends))
        interval.append(np.full(inner.size, number))
        count += inner.size
    starts = np.concatenate(first)
    dt = np.add.reduceat(model.dt, starts)
    mean = np.add.reduceat(model.rates * model.dt[:, None], starts, axis=0) / dt[:, None]
    t = np.add.reduceat(model.t_s * model.dt, starts) / dt
    belongs = np.concatenate(interval)
    begin = np.array([model.t_s[block.steps.start] for block in model.blocks])
    acceleration = np.empty_like(mean)
    for number in range(len(model.blocks)):
        inside = belongs == number
        acceleration[inside] = np.gradient(mean[inside], t[inside], axis=0) if inside.sum() > 1 else 0.0
    return Bins(
        turned=np.add.reduceat(model.to_inertial * model.dt[:, None, None], starts, axis=0),
        t_s=t,
        rates=mean,
        acceleration=acceleration,
        since_s=t - begin[belongs],
        dt=dt,
        interval=belongs,
        ends=ends,
    )


def observe_rate_errors(model: RecordingModel, bins: Bins, axis: int, values: Array) -> Array:
    """Observe rate errors (bins, k) about one axis as whitened columns (N, k)."""
    out = np.empty((model.size, values.shape[1]))
    for number, block in enumerate(model.blocks):
        interval_values, (ends, place) = values[bins.interval == number], np.unique(bins.ends[number], return_inverse=True)
        turned = bins.turned[bins.interval == number, :, axis][: ends[-1]].T.copy()
        sums = [scipy.sparse.csr_array((along, np.arange(ends[-1]), ends)) @ interval_values[: ends[-1]] for along in turned]
        total = np.concatenate([np.zeros((1, 3, values.shape[1])), np.cumsum(np.stack(sums, axis=1), axis=0)])
        out[block.rows] = block.average_references(total[place]).reshape(-1, values.shape[1])
    return model.whiten(out)


def normalise_columns(values: Array) -> Array:
    """Scale columns to a root mean square of one, so that amplitudes compare."""
    size = np.sqrt(np.mean(values**2, axis=0))
    return values / np.where(size > 0, size, 1.0)


def observe_reference_errors(model: RecordingModel, axis: int, values: Array) -> Array:
    """Observe errors of the references (m, k) about one axis as whitened columns (N, k)."""
    error = np.zeros((len(values), 3, values.shape[1]))
    error[:, axis] = values
    return model.whiten(model.observe_reference_error(error))


def build_families(name: str, options: list[Array], observe: Callable[[int, Array], Array]) -> Iterator[CandidateColumns]:
    """Build one family for each axis from errors (n, k) alike for all axes; none without options."""
    if not options:
        return
    widths = np.cumsum([0] + [option.shape[1] for option in options])
    together = normalise_columns(np.hstack(options))
    for axis in range(3):
        columns = observe(axis, together)
        yield build_rival(name, AXES[axis], [columns[:, a:b] for a, b in pairwise(widths)])


def find_steps(model: RecordingModel, t_s: Array, interval: Indices) -> Indices:
    """Find the step in progress (k,) at some times (k,), s since the epoch, each within an interval (k,)."""
    first, stop = np.array([(block.steps.start, block.steps.stop) for block in model.blocks], dtype=np.intp).T
    return _find_in_progress(model.t_s, first, stop, t_s, interval)


def find_reference_steps(model: RecordingModel) -> Indices:
    """Find the step in progress (m,) at each reference."""
    return find_steps(model, model.references.t_s, model.interval_of_reference)


def find_reference_bins(model: RecordingModel, bins: Bins) -> Indices:
    """Find the bin in progress (m,) at each reference."""
    numbers = np.arange(len(model.blocks))
    first, stop = (np.searchsorted(bins.interval, numbers, side) for side in ("left", "right"))
    return _find_in_progress(bins.t_s, first, stop, model.references.t_s, model.interval_of_reference)


def _find_in_progress(middle_s: Array, first: Indices, stop: Indices, t_s: Array, interval: Indices) -> Indices:
    """Find the first step or bin whose middle is behind each time, among those of its interval."""
    return np.asarray(np.clip(np.searchsorted(middle_s, t_s), first[interval], stop[interval] - 1))
