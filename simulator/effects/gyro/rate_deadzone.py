"""Small rates read zero: the noise-free reading is 0 where its absolute value is below size.

Stiction of a pivot, or lock-in of a laser gyro without dither. Acts before the white noise, which comes from the electronics
behind it and goes on.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Setting, Stream
from simulator.effects.common import DEG, index


class RateDeadzone(Effect):
    """See the module."""

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """Zero inside the zone."""
        axis = index(setting.axis)
        out = samples.copy()
        out[np.abs(samples[:, axis]) < setting.size * DEG, axis] = 0.0
        return out


EFFECT = RateDeadzone(
    name="rate_deadzone",
    summary="small rates read zero",
    says="{gyro} does not feel rates below {size}",
    unit="deg/s",
    stage="threshold",
    prior=(1e-5, 1.0),
    bounds=(0.0, 1e5),
    meaning="Rates smaller than this read zero.",
)
