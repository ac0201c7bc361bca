"""White gyro noise other than stated: the noise of each sample times size; 1 is as stated.

The same draws are scaled, so that all else stays as it was. Without an axis it acts on all three.
"""

from simulator.effects.base import Array, Effect, Setting
from simulator.effects.common import build_factor, no_gyro_noise


class NoiseExcess(Effect):
    """See the module."""

    def noise_factor(self, setting: Setting) -> Array:
        """Size on its axes, 1 elsewhere."""
        return build_factor(setting.axis, setting.size)


EFFECT = NoiseExcess(
    name="noise_excess",
    summary="white gyro noise is other than stated",
    says="{whose} white noise is {size} times what is stated",
    unit="factor",
    stage="white_noise",
    prior=(0.1, 30.0),
    bounds=(0.0, 1e6),
    axis_optional=True,
    meaning="The gyro's white noise is not what the recording states; 1 would be as stated.",
    symptom="white_noise_level",
    requirement=no_gyro_noise,
)
