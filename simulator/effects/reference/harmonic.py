"""What reference errors that are sinusoidal along the orbit have in common: e = size · sin(k n t + φ) about one body axis.

n = 2π/period is the orbit rate, k the order and t the time since the epoch. Amplitudes (size cos φ, size sin φ) make it linear.
"""

from collections.abc import Callable
from dataclasses import dataclass

from simulator.effects.base import Array, Parameters, References, Surroundings
from simulator.effects.common import DEG, harmonic, no_orbit, put_on_axis
from simulator.effects.periodic import Sinusoid


@dataclass(frozen=True)
class ReferenceHarmonic(Sinusoid):
    """A sinusoidal reference error; ``order`` periods an orbit."""

    order: int = 1
    requirement: Callable[[Surroundings], str | None] | None = no_orbit

    def reference_columns(self, references: References, axis: str | None, parameters: Parameters) -> Array:
        """Sine and cosine, as degrees."""
        return put_on_axis(harmonic(references.t_s, references.orbit_period_s / self.order) * DEG, axis)
