"""Which step of a recording, or which bin of its steps, is in progress at a time of an interval.

An interval ends with a reference, behind its last step. The next step is of another interval, in which the body may turn about
another axis, or rest: what is in progress at that reference is the last step of its own interval.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diagnosis.model.bins import Bins
from diagnosis.model.recording_model import RecordingModel

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


def find_steps(model: RecordingModel, t_s: Array, interval: Indices) -> Indices:
    """(k,) step in progress at each of some times (k,), s since the epoch, each within an interval (k,)."""
    first, stop = np.array([(block.steps.start, block.steps.stop) for block in model.blocks], dtype=np.intp).T
    return _find_in_progress(model.t_s, first, stop, t_s, interval)


def find_reference_steps(model: RecordingModel) -> Indices:
    """(m,) step in progress at each reference."""
    return find_steps(model, model.references.t_s, model.interval_of_reference)


def find_reference_bins(model: RecordingModel, bins: Bins) -> Indices:
    """(m,) bin in progress at each reference."""
    numbers = np.arange(len(model.blocks))
    first, stop = (np.searchsorted(bins.interval, numbers, side) for side in ("left", "right"))
    return _find_in_progress(bins.t_s, first, stop, model.references.t_s, model.interval_of_reference)


def _find_in_progress(middle_s: Array, first: Indices, stop: Indices, t_s: Array, interval: Indices) -> Indices:
    """The first with its middle behind a time, held among those of its interval."""
    return np.asarray(np.clip(np.searchsorted(middle_s, t_s), first[interval], stop[interval] - 1))
