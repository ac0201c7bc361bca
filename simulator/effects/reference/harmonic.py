"""What reference errors that are sinusoidal along the orbit have in common: e = size · sin(k n t + φ) about one body axis.

n = 2π/period is the orbit rate, k the order and t the time since the epoch. Amplitudes (size cos φ, size sin φ) make it linear.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from simulator.effects.base import Array, Effect, References, Setting, Surroundings, Value
from simulator.effects.common import DEG, from_phase_amplitudes, harmonic, no_orbit, on_axis, phase_amplitudes


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
