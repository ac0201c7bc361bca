"""Output rounded to a step: samples become the nearest multiple of size, noise included.

The least significant bit of the converter or of telemetry. Without an axis it acts on all three.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Setting, Stream
from simulator.effects.common import DEG, round_to_multiples


class RateQuantization(Effect):
    """See the module."""

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """Nearest multiples of the step."""
        return round_to_multiples(samples, setting.axis, setting.size * DEG, np.round)


EFFECT = RateQuantization(
    name="rate_quantization",
    summary="output rounded to a step",
    says="the gyro's readings are rounded to steps of {size}",
    unit="deg/s",
    stage="resolution",
    prior=(1e-6, 1.0),
    bounds=(1e-12, 1e5),
    axis_optional=True,
    meaning="The gyro's output is rounded to multiples of a step.",
    symptom="lattice_rounded",
)
