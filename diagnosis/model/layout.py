"""What the observations of a recording stand for, so that checks of what an explanation leaves can be general.

Innovations are asked whether they follow the rate. A rate that is read holds the gyro's noise, and so does the innovation of
the reference at which it is read: of a body at rest, where there is little else in it, each would follow the other by
themselves. An innovation is independent of all noise that comes after it. The rate at a reference therefore is the mean of the
readings that follow it, of as many as bring their noise to `QUIET` of the scatter of the rates, and the rate at the reference
before, of which a change is told, that of the readings before that one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.check_statistics import Layout
from diagnosis.model.in_progress import steps_at
from diagnosis.model.recording import RecordingModel

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

QUIET = 0.25  # of the scatter of the rates, that their noise may have
TINY = 1e-300
OUTLIER = 10.0  # sigma of a reading, beyond which it is replaced by the smoothed one


def layout(model: RecordingModel) -> Layout:
    """Times, intervals, body axes, and what the observations may depend on."""
    t_s, interval = model.observation_t_s, model.observation_block
    begins = np.array([model.t_s[block.steps.start] for block in model.blocks])
    place = steps_at(model, t_s, interval)
    rates, before = _rates_beside(model, model.rates[place])
    # The change of the rate since the observation before is what an error of timing follows.
    change = rates - np.vstack([rates[:1], before[:-1]])
    change[np.diff(interval, prepend=-1) != 0] = 0.0
    housekeeping = [values[place] for values in model.stream.housekeeping.values()]
    mission = (t_s - t_s.mean()) / max(float(np.ptp(t_s)), 1.0)
    regressors = np.column_stack([rates, np.abs(rates), change, mission, mission**2, *housekeeping])
    return Layout(
        axes=model.observation_attitude.transpose(0, 2, 1),
        t_s=t_s,
        since_s=t_s - begins[interval],
        interval=interval,
        period_s=model.stream.orbit_period_s,
        regressors=regressors,
        activity=np.linalg.norm(rates, axis=1),
        turned=turned(model)[place],
    )


def turned(model: RecordingModel) -> Array:
    """(n, 3) angle turned about each body axis from the start of its interval to each step of a model, rad."""
    out = np.cumsum(model.rates * model.dt[:, None], axis=0)
    for block in model.blocks:
        out[block.steps] -= out[block.steps.start]
    return np.asarray(out)


def _rates_beside(model: RecordingModel, smooth: Array) -> tuple[Array, Array]:
    """Rates (r, 3) from the readings after the last reference of each observation, and from those before it.

    Where there are none in its interval, they are the `smooth` ones.
    """
    gyro, after, before = model.recording.gyro, smooth.copy(), smooth.copy()
    sigma = gyro.arw / np.sqrt(gyro.sample_s)
    wanted = np.ceil((sigma / (QUIET * np.maximum(smooth.std(axis=0), TINY))) ** 2)
    place = np.clip(np.searchsorted(model.t_s, gyro.t_s), 0, model.t_s.size - 1)
    readings = gyro.rates @ model.G.T + model.bias
    odd = np.abs(readings - model.rates[place]) > OUTLIER * sigma
    total = np.vstack([np.zeros(3), np.cumsum(np.where(odd, model.rates[place], readings), axis=0)])
    row = 0
    for block in model.blocks:
        last = block.references[np.append(block.groups[1:], block.references.size) - 1]
        at = np.searchsorted(gyro.t_s, model.recording.attitudes.t_s[last] - 0.5 * gyro.sample_s)
        first, stop = np.searchsorted(gyro.t_s, model.t_s[[block.steps.start, block.steps.stop - 1]])
        most = max(1, (stop - first) // last.size)  # no more than lie between two observations
        for axis, count in enumerate(np.clip(wanted, 1, most).astype(np.intp)):
            for found, low, high in (
                (after, at, np.minimum(at + count, stop)),
                (before, np.maximum(at - count, first), np.minimum(at, stop)),
            ):
                some = np.flatnonzero(high > low)
                mean = (total[high[some], axis] - total[low[some], axis]) / (high[some] - low[some])
                found[row + some, axis] = mean
        row += last.size
    return after, before
