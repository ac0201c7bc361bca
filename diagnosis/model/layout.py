"""What the observations of a recording stand for, so that checks of what an explanation leaves can be general."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.checks import Layout
from diagnosis.model.recording import RecordingModel

Array = NDArray[np.float64]


def layout(model: RecordingModel) -> Layout:
    """Times, intervals, body axes, and what the observations may depend on."""
    t_s, interval = model.observation_t_s, model.observation_block
    begins = np.array([model.t_s[block.steps.start] for block in model.blocks])
    place = np.clip(np.searchsorted(model.t_s, t_s), 0, model.t_s.size - 1)
    rates = model.rates[place]
    # The change of the rate since the observation before is what an error of timing follows.
    change = np.diff(rates, axis=0, prepend=rates[:1])
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
    )
