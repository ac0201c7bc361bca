"""Rate errors that follow something, bin by bin, as columns: what the unlisted rivals are made of."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from diagnosis.model.recording_model import RecordingModel

Array = NDArray[np.float64]

AXES = "xyz"

LONGEST = 8.0  # s, of a bin; the slews of most spacecraft take minutes
MOST = 6000  # bins about, of a recording whose motion may be faster


@dataclass(frozen=True)
class Family:
    """A kind of discrepancy."""

    name: str  # what it is, in words
    axis: str | None  # body axis it acts about; None for all
    columns: list[Array]  # per option, (N, k) whitened columns of unit size
    weights: Array | None = None  # prior share of each option; None for equal ones


@dataclass(frozen=True)
class Bins:
    """Short times over which smooth regressors are taken as constant."""

    turned: Array  # (n, 3, 3) Aᵀ dt summed
    t_s: Array
    rates: Array  # (n, 3)
    acceleration: Array  # (n, 3)
    since_s: Array  # since the interval's start
    dt: Array
    interval: NDArray[np.intp]
    ends: list[NDArray[np.intp]]  # of each block: bins done at each reference


def build_bins(model: RecordingModel, bin_s: float | None = None) -> Bins:
    """Bins of about `bin_s`, by default as short as a few thousand allow, that end at every reference."""
    bin_s = min(LONGEST, float(model.dt.sum()) / MOST) if bin_s is None else bin_s
    first: list[NDArray[np.intp]] = []
    ends: list[NDArray[np.intp]] = []
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
    """(N, k) whitened columns of rate errors about one axis, (bins, k)."""
    out = np.empty((model.size, values.shape[1]))
    for number, block in enumerate(model.blocks):
        own, (ends, place) = values[bins.interval == number], np.unique(bins.ends[number], return_inverse=True)
        turned = bins.turned[bins.interval == number, :, axis][: ends[-1]].T.copy()
        sums = [scipy.sparse.csr_array((along, np.arange(ends[-1]), ends)) @ own[: ends[-1]] for along in turned]
        total = np.concatenate([np.zeros((1, 3, values.shape[1])), np.cumsum(np.stack(sums, axis=1), axis=0)])
        out[block.rows] = block.average_references(total[place]).reshape(-1, values.shape[1])
    return model.whiten(out)


def normalise_columns(values: Array) -> Array:
    """Columns scaled to a root mean square of one, so that amplitudes compare."""
    size = np.sqrt(np.mean(values**2, axis=0))
    return values / np.where(size > 0, size, 1.0)


def build_rate_families(model: RecordingModel, bins: Bins, name: str, options: list[Array]) -> Iterator[Family]:
    """Build one family for each axis from rate errors (bins, k) that do not depend on the axis; none without options."""
    return _build_families(name, options, lambda axis, values: observe_rate_errors(model, bins, axis, values))


def build_reference_families(model: RecordingModel, name: str, options: list[Array]) -> Iterator[Family]:
    """Build one family for each axis from errors of the references (m, k) alike for all axes; none without options."""

    def observe(axis: int, values: Array) -> Array:
        error = np.zeros((len(values), 3, values.shape[1]))
        error[:, axis] = values
        return model.whiten(model.observe_reference_error(error))

    return _build_families(name, options, observe)


def _build_families(name: str, options: list[Array], observe: Callable[[int, Array], Array]) -> Iterator[Family]:
    if not options:
        return
    widths = np.cumsum([0] + [option.shape[1] for option in options])
    together = normalise_columns(np.hstack(options))
    for axis in range(3):
        columns = observe(axis, together)
        yield Family(name, AXES[axis], [columns[:, a:b] for a, b in pairwise(widths)])
