"""Bias that varies at orbit rate: raw += size · sin(n t + φ), n = 2π/period, t since the epoch.

The Sun warms and the shadow cools the gyro once an orbit. Amplitudes (size cos φ, size sin φ) make it linear.
"""

from simulator.effects.base import Array, Parameters, Stream
from simulator.effects.common import DEG_H, harmonic, no_orbit, put_on_axis
from simulator.effects.periodic import Sinusoid


class BiasOrbital(Sinusoid):
    """See the module."""

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        """sin(nt) and cos(nt), as deg/h."""
        return put_on_axis(harmonic(stream.t_s, stream.orbit_period_s) * DEG_H, axis)


EFFECT = BiasOrbital(
    name="bias_orbital",
    summary="bias varies sinusoidally at orbit rate",
    says="{whose} bias swings by ±{size} once an orbit",
    unit="deg/h",
    stage="rate",
    prior=(1e-5, 1e3),
    requirement=no_orbit,
    meaning="The gyro's bias goes up and down once an orbit, as when sun and shadow warm and cool it.",
)
