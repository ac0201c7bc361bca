"""The candidate "small rates read zero" of a recording: what the samples show of it, and the columns of what it hides.

The samples say where a slow reading is zero and how likely that is without a dead zone (`diagnosis.detectors.deadzone`); that
enters as the candidate's likelihood. In the attitude a rate is missing in those slow parts. It is a rate the reading does not
show, so it needs a number of its own in each slow part, and its evidence counts all of them: a drift, a step or an asymmetry
that needs one number wins over it wherever both explain the data.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnosis.detectors.deadzone import DeadStretches, half_width
from diagnosis.model.candidates import Group
from diagnosis.model.linear import Array, Parameters
from diagnosis.model.prepare import Prepared
from diagnosis.model.recording import RecordingModel
from simulator.effects.base import Effect

AXES = "xyz"
DIFFERENCE = 0.4  # usual size of the differences between slow parts beside what they have in common
MOST_ODDS = 20.0  # what the samples may say for it
LEAST_ODDS = -10.0  # and against it


def missing(model: RecordingModel, one: DeadStretches) -> Array:
    """Observations of a missing rate, deg/s: in all slow parts alike, and its difference in each; (N, 1 + parts)."""
    step = np.searchsorted(model.recording.gyro.t_s, model.t_s, side="right") - 1
    part = one.stretch[step]
    numbers = np.unique(part[part >= 0])
    low = np.zeros((model.t_s.size, 3, 1 + numbers.size))
    low[part >= 0, one.axis, 0] = -np.deg2rad(1.0)
    for k, number in enumerate(numbers):
        low[part == number, one.axis, 1 + k] = -DIFFERENCE * np.deg2rad(1.0)
    return model.reading(low)


def dead_zone_groups(prepared: Prepared, effects: Sequence[Effect]) -> list[Group]:
    """A candidate for each gyro that may have a dead zone, if an effect claims that symptom."""
    effect = next((one for one in effects if one.symptom == "dead_zone"), None)
    if effect is None:
        return []
    return [_group(prepared.model, one, effect) for one in prepared.dead]


def _group(model: RecordingModel, one: DeadStretches, effect: Effect) -> Group:
    def read(amplitudes: Array) -> tuple[float, Parameters]:
        size, _ = half_width(one, float(amplitudes[0]), DIFFERENCE * amplitudes[1:], np.zeros(amplitudes.size - 1))
        return size, {}

    return Group(
        effect=effect.name,
        axis=AXES[one.axis],
        listed=True,
        columns=[model.whitened(missing(model, one))],
        parameters=[{}],
        weights=np.ones(1),
        limits=effect.prior,
        unit=effect.unit,
        log_odds=float(np.clip(one.log_odds, LEAST_ODDS, MOST_ODDS)),
        read=read,
    )
