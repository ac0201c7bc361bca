"""Noise of one star tracker other than stated: its white errors times size; the recording goes on stating its sigmas."""

from dataclasses import dataclass

import numpy as np

from simulator.effects.base import Array, Setting
from simulator.effects.tracker.base import TrackerEffect


@dataclass(frozen=True)
class TrackerNoiseExcess(TrackerEffect):
    """See the module."""

    def noise_factor(self, setting: Setting) -> Array:
        """Size about all axes of that tracker."""
        return np.full(3, setting.size)


EFFECT = TrackerNoiseExcess(
    name="tracker_noise_excess",
    summary="noise of a star tracker is other than stated",
    says="the noise of star tracker {axis} is {size} times what is stated",
    unit="factor",
    stage="reference_noise",
    prior=(0.1, 30.0),
    bounds=(0.0, 1e3),
    blind_sizes=(1.3, 3.0),
    meaning="The white noise of the star tracker is not as stated; 1 would be as stated.",
    symptom="tracker_noise_level",
)
