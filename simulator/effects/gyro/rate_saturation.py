"""Output clipped: samples beyond ±size read ±size. The range of the rebalance loop, the converter or the telemetry word."""

import numpy as np

from simulator.effects.base import Array, Effect, Setting, Stream
from simulator.effects.common import DEG, index


class RateSaturation(Effect):
    """See the module."""

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """Clipped at ±size."""
        axis, limit = index(setting.axis), setting.size * DEG
        out = samples.copy()
        out[:, axis] = np.clip(samples[:, axis], -limit, limit)
        return out


EFFECT = RateSaturation(
    name="rate_saturation",
    summary="output clipped",
    says="{gyro} cuts off rates above {size}",
    unit="deg/s",
    stage="range",
    prior=(1e-2, 3e3),
    bounds=(1e-9, 1e5),
    meaning="Rates larger than this are cut off.",
    symptom="plateau",
)
