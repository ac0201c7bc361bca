"""Scale factor that differs with the sign of the rate: raw_i += size · 10⁻⁶ |ω_i|.

Positive turns read high and negative ones low by the same share, the rest of it is scale factor proper. IEEE Std 528 calls
it scale-factor asymmetry; it is what differs between the two halves of a rebalance loop.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Parameters, Stream
from simulator.effects.common import PPM, index, put_on_axis


class ScaleAsymmetry(Effect):
    """See the module."""

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        """10⁻⁶ |ω_i|."""
        return put_on_axis(PPM * np.abs(stream.rates[:, index(axis)]), axis)


EFFECT = ScaleAsymmetry(
    name="scale_asymmetry",
    summary="scale factor differs with the sign of the rate",
    says="{gyro} reads turns one way {size} too large and the other way as much too small",
    unit="ppm",
    stage="rate",
    prior=(1.0, 5e4),
    bounds=(-1e6, 1e6),
    meaning="The scale factor differs between the two senses of rotation; positive: both rates read too high.",
)
