"""Reference noise other than stated: the white reference errors times size; the recording goes on stating its sigma.

The same draws are scaled, so that all else stays as it was. Without an axis it acts on all three.
"""

from simulator.effects.base import Array, Effect, Setting
from simulator.effects.common import build_factor


class ReferenceNoiseExcess(Effect):
    """See the module."""

    def noise_factor(self, setting: Setting) -> Array:
        """Size on its axes, 1 elsewhere."""
        return build_factor(setting.axis, setting.size)


EFFECT = ReferenceNoiseExcess(
    name="reference_noise_excess",
    summary="reference noise is other than stated",
    says="the noise of the reference attitude about {axis} is {size} times what is stated",
    unit="factor",
    stage="reference_noise",
    prior=(0.1, 30.0),
    bounds=(0.0, 1e3),
    axis_optional=True,
    meaning="The white noise of the reference attitudes is not as stated; 1 would be as stated.",
    symptom="reference_noise_level",
)
