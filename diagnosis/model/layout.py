"""What the references of a recording stand for, so that tests of what M0 leaves of them can be general.

Innovations are asked whether they follow the rate and its changes. A rate that is read holds the gyro's noise, and so do the
innovations of the references behind it, the more often the more references there are: of a body at rest, where there is little
else in a rate, each would follow the other by themselves. An innovation is independent of all noise that comes after it. The
rate at a reference therefore is the mean of the readings that follow it, of as many as bring their noise to `QUIET` of the
scatter of the rates. An error of timing follows the change of the rate since the reference before; where the noise of a
reading is `HEARD` by that many innovations, the change until the reference that comes next stands for it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.criticism import Layout
from diagnosis.model.recording_model import RecordingModel
from diagnosis.model.step_index import find_steps

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

QUIET = 0.25  # of the scatter of the rates, that their noise may have
# of the variance of the rates, from which on noise of readings times the number of innovations is too much
HEARD = 0.1
OUTLIER = 10.0  # sigma of a reading, beyond which it is replaced by the smoothed one

LEAST_POSITIVE = 1e-300


def tabulate_references(model: RecordingModel, kept: Mask) -> Layout:
    """Tabulate what the innovations of some references (m,) may follow."""
    t_s, block = model.recording.attitudes.t_s[model.reference_rows], model.interval_of_reference
    rates, change = measure_motion(model, model.reference_rows, block)
    place = find_steps(model, t_s, block)
    housekeeping = [values[place] for values in model.stream.housekeeping.values()]
    mission = (t_s - t_s.mean()) / max(float(np.ptp(t_s)), 1.0)
    regressors = np.column_stack([rates, np.abs(rates), change, mission, mission**2, *housekeeping])
    axes, speed = model.at_reference.transpose(0, 2, 1), np.linalg.norm(rates, axis=1)
    return Layout(axes[kept], block[kept], regressors[kept], speed[kept])


def measure_motion(model: RecordingModel, references: Indices, block: Indices) -> tuple[Array, Array]:
    """Measure the rate about each axis at some references, and its change, without the noise of their innovations.

    Parameters
    ----------
    model : of the recording
    references : (r,) their rows in the recording, in the order of time within each block
    block : (r,) index of the block of each

    Returns
    -------
    rates : (r, 3) rad/s
    change : (r, 3) since the reference before, or where that would hold their noise until the next, rad/s; 0 without one
    """
    gyro, t_s = model.recording.gyro, model.recording.attitudes.t_s[references]
    first, stop = np.array([(one.steps.start, one.steps.stop - 1) for one in model.blocks])[block].T
    smooth = model.rates[np.clip(np.searchsorted(model.t_s, t_s), first, stop)]
    noise = (gyro.arw**2 / gyro.sample_s) / np.maximum(smooth.var(axis=0), LEAST_POSITIVE)
    first, stop = np.searchsorted(gyro.t_s, model.t_s[first]), np.searchsorted(gyro.t_s, model.t_s[stop])
    most = np.maximum(1, (stop - first) // np.bincount(block)[block])  # no more than lie between two references
    count = np.clip(np.ceil(noise / QUIET**2).astype(np.intp), 1, most[:, None])
    at = np.searchsorted(gyro.t_s, t_s - 0.5 * gyro.sample_s)[:, None]
    total = _accumulate_readings(model)
    rates = _average_readings(total, at, np.minimum(at + count, stop[:, None]), smooth)
    before = _average_readings(total, np.maximum(at - count, first[:, None]), np.minimum(at, stop[:, None]), smooth)
    starts = np.diff(block, prepend=-1) != 0
    since, until = np.zeros_like(rates), np.zeros_like(rates)
    since[1:], until[:-1] = rates[1:] - before[:-1], np.diff(rates, axis=0)
    since[starts] = until[np.append(starts[1:], True)] = 0.0
    return rates, np.where(noise * references.size < HEARD, since, until)


def _accumulate_readings(model: RecordingModel) -> Array:
    """(samples + 1, 3) of the calibrated readings up to each sample; single odd ones are replaced by the smooth rate."""
    gyro = model.recording.gyro
    smooth = model.rates[np.clip(np.searchsorted(model.t_s, gyro.t_s), 0, model.t_s.size - 1)]
    readings = gyro.rates @ model.G.T + model.bias
    odd = np.abs(readings - smooth) > OUTLIER * gyro.arw / np.sqrt(gyro.sample_s)
    return np.vstack([np.zeros(3), np.cumsum(np.where(odd, smooth, readings), axis=0)])


def _average_readings(total: Array, low: Indices, high: Indices, otherwise: Array) -> Array:
    """(r, 3) means of the readings from `low` to before `high`, (r, 3) each, of running sums; of none, something else."""
    low, high, axes = np.broadcast_arrays(low, high, np.arange(3))
    return np.where(high > low, (total[high, axes] - total[low, axes]) / np.maximum(high - low, 1), otherwise)
