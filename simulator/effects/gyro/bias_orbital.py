"""Bias that varies at orbit rate: raw += size · sin(n t + φ), n = 2π/period, t since the epoch.

The Sun warms and the shadow cools the gyro once an orbit. Amplitudes (size cos φ, size sin φ) make it linear.
"""

from collections.abc import Mapping

from simulator.effects.base import Array, Effect, Setting, Stream, Surroundings, Value
from simulator.effects.common import DEG_H, PHASE, from_phase_amplitudes, harmonic, no_orbit, on_axis, phase_amplitudes


class BiasOrbital(Effect):
    """See the module."""

    def columns(self, stream: Stream, axis: str | None, parameters: Mapping[str, Value]) -> Array:
        """sin(nt) and cos(nt), as deg/h."""
        return on_axis(harmonic(stream.t_s, stream.orbit_period_s) * DEG_H, axis)

    def amplitudes(self, setting: Setting) -> Array:
        """(size cos φ, size sin φ)."""
        return phase_amplitudes(setting)

    def from_amplitudes(self, amplitudes: Array) -> tuple[float, dict[str, Value]]:
        """Size and phase."""
        return from_phase_amplitudes(amplitudes)

    def missing(self, around: Surroundings) -> str | None:
        """It needs the orbit's period."""
        return no_orbit(around)


EFFECT = BiasOrbital(
    name="bias_orbital",
    summary="bias varies sinusoidally at orbit rate",
    says="{whose} bias swings by ±{size} once an orbit",
    unit="deg/h",
    stage="rate",
    prior=(1e-5, 1e3),
    parameters=(PHASE,),
    meaning="The gyro's bias goes up and down once an orbit, as when sun and shadow warm and cool it.",
)
