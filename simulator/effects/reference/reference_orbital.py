"""Reference error about one body axis at orbit rate, e = size · sin(n t + φ), and the same at twice that rate.

An orbital error comes from thermal bending between sensors and gyro or from the ephemeris. Twice orbit rate is the horizon:
geodetic against geocentric nadir over an oblate Earth, and the latitude dependence of its radiance. n = 2π/period, t since
the epoch; `reference_horizon` has 2n in place of n.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from simulator.effects.base import Array, Effect, References, Setting, Surroundings, Value
from simulator.effects.common import DEG, PHASE, from_phase_amplitudes, harmonic, no_orbit, on_axis, phase_amplitudes


@dataclass(frozen=True)
class ReferenceHarmonic(Effect):
    """A sinusoidal reference error; ``order`` periods an orbit."""

    order: int = 1

    def reference_columns(self, references: References, axis: str | None, parameters: Mapping[str, Value]) -> Array:
        """Sine and cosine, as degrees."""
        return on_axis(harmonic(references.t_s, references.orbit_period_s / self.order) * DEG, axis)

    def amplitudes(self, setting: Setting) -> Array:
        """(size cos φ, size sin φ)."""
        return phase_amplitudes(setting)

    def from_amplitudes(self, amplitudes: Array) -> tuple[float, dict[str, Value]]:
        """Size and phase."""
        return from_phase_amplitudes(amplitudes)

    def missing(self, around: Surroundings) -> str | None:
        """It needs the orbit's period."""
        return no_orbit(around)


EFFECT = ReferenceHarmonic(
    name="reference_orbital",
    summary="reference error sinusoidal at orbit rate",
    unit="deg",
    stage="reference",
    prior=(5e-4, 5.0),
    bounds=(-90.0, 90.0),
    parameters=(PHASE,),
    meaning="The reference attitude errs sinusoidally once an orbit.",
)
