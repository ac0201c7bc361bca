"""White gyro noise other than stated: the noise of each sample times size; 1 is as stated.

The same draws are scaled, so that all else stays as it was. Without an axis it acts on all three.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Setting
from simulator.effects.common import chosen


class NoiseExcess(Effect):
    """See the module."""

    def noise_factor(self, setting: Setting) -> Array:
        """Size on its axes, 1 elsewhere."""
        factor = np.ones(3)
        factor[chosen(setting.axis)] = setting.size
        return factor


EFFECT = NoiseExcess(
    name="noise_excess",
    summary="white gyro noise is other than stated",
    unit="factor",
    stage="white_noise",
    prior=(0.1, 30.0),
    bounds=(0.0, 1e6),
    axis_optional=True,
    meaning="The gyro's white noise is not what the recording states; 1 would be as stated.",
    symptom="white_noise_level",
)
