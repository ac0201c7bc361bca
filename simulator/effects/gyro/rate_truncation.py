"""Output cut toward zero to a step: samples become the multiple of size next to them on the side of zero, noise included.

What an integer conversion does that drops the fraction. The counts −1 < x/size < 1 all read zero, so that the bin of zero is
twice as wide as the others, and every other reading is half a step too near to zero on average. Found in the gyros of the
BROAD trials (docs/validation.md). Without an axis it acts on all three.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Setting, Stream
from simulator.effects.common import DEG, round_to_multiples


class RateTruncation(Effect):
    """See the module."""

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """Multiples of the step toward zero."""
        return round_to_multiples(samples, setting.axis, setting.size * DEG, np.trunc)


EFFECT = RateTruncation(
    name="rate_truncation",
    summary="output cut toward zero to a step",
    says="the gyro's readings are cut down to steps of {size}",
    unit="deg/s",
    stage="resolution",
    prior=(1e-6, 1.0),
    bounds=(1e-12, 1e5),
    axis_optional=True,
    meaning="The gyro's output is cut off to a multiple of a step instead of rounded.",
    symptom="lattice_cut",
)
