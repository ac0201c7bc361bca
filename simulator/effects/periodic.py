"""Sinusoidal errors, size · sin(2π t/P + φ), t since the epoch.

Amplitudes (size cos φ, size sin φ) make it linear; the period is not. Where nothing states it, it may be any between what the
spacing of the references can show and the whole time from the first of them to the last, even in its logarithm. One phase goes
through all intervals, so that two periods are separated by their difference over the whole time, gaps included.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from simulator.effects.base import Array, Effect, Parameter, Parameters, Setting, Surroundings, Trial, Value
from simulator.effects.common import (
    PHASE,
    convert_phase_amplitudes,
    harmonic,
    measure_reference_arc,
    no_orbit,
    number,
    phase_amplitudes,
)

SHORTEST_PERIOD_SPACINGS = 2.5  # spacings of the references; a swing is sampled twice in a period at least
PLANNED_PERIODS = 16  # periods of a plan, for which nothing can be scanned


def compute_period_band(around: Surroundings) -> tuple[float, float] | None:
    """Compute the shortest and longest period that can show, s; None without a series of references."""
    spacing, arc = measure_reference_arc(around)
    if not arc > 2 * SHORTEST_PERIOD_SPACINGS * spacing:
        return None
    return SHORTEST_PERIOD_SPACINGS * spacing, float(np.ptp(around.references.t_s))


@dataclass(frozen=True)
class Sinusoid(Effect):
    """An effect whose columns are a sine and a cosine, of ``order`` periods an orbit."""

    parameters: tuple[Parameter, ...] = (PHASE,)
    requirement: Callable[[Surroundings], str | None] | None = no_orbit
    order: int = 1

    def build_waves(self, t_s: Array, orbit_period_s: float, parameters: Parameters) -> Array:
        """Build sine and cosine at some times (n,), s since the epoch; (n, 2)."""
        return harmonic(t_s, orbit_period_s / self.order)

    def amplitudes(self, setting: Setting) -> Array:
        """Compute (size cos φ, size sin φ)."""
        return phase_amplitudes(setting)

    def from_amplitudes(self, amplitudes: Array) -> tuple[float, dict[str, Value]]:
        """Convert to size and phase."""
        return convert_phase_amplitudes(amplitudes)


def no_reference_series(around: Surroundings) -> str | None:
    """Give the reason why a sinusoid of any period cannot be seen; None if it can."""
    return None if compute_period_band(around) else "it needs a series of references"


@dataclass(frozen=True)
class Periodic(Sinusoid):
    """A sinusoid of any period."""

    parameters: tuple[Parameter, ...] = (Parameter("period_s", "s", 1000.0, "period", 1e-3, 1e12), PHASE)
    requirement: Callable[[Surroundings], str | None] | None = no_reference_series
    scanned: bool = True

    def build_waves(self, t_s: Array, orbit_period_s: float, parameters: Parameters) -> Array:
        """Build sine and cosine at some times (n,), s since the epoch; (n, 2)."""
        return harmonic(t_s, number(parameters, "period_s"))

    def trials(self, around: Surroundings) -> Sequence[Trial]:
        """List some periods, evenly spaced in their logarithm."""
        band = compute_period_band(around)
        if band is None:
            return ()
        return tuple(Trial({"period_s": float(p)}, 1 / PLANNED_PERIODS) for p in np.geomspace(*band, PLANNED_PERIODS))
