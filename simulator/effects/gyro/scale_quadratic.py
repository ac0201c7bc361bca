"""Scale factor that grows with the rate, an odd non-linearity: raw_i += size · 10⁻⁶ ω_i |ω_i|, one of the ω in deg/s.

Loss of torquer gain at high rates and the like; the even part of a quadratic is scale asymmetry's neighbour, the odd part
reads high in both senses of rotation.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Parameters, Stream
from simulator.effects.common import PPM, index, put_on_axis


class ScaleQuadratic(Effect):
    """See the module."""

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        """10⁻⁶ ω_i |ω_i|."""
        omega = stream.rates[:, index(axis)]
        return put_on_axis(PPM * omega * np.abs(np.rad2deg(omega)), axis)


EFFECT = ScaleQuadratic(
    name="scale_quadratic",
    summary="scale factor grows with the rate, odd non-linearity",
    says="{whose} scale factor {way} by {size} of turning rate",
    ways=("grows", "shrinks"),
    unit="ppm per deg/s",
    stage="rate",
    prior=(0.1, 3e5),
    bounds=(-1e8, 1e8),
    meaning="The scale factor grows with the rate; positive: fast turns read too fast, in both senses.",
)
