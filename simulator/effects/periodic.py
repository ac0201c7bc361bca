"""Sinusoidal errors, size · sin(2π t/P + φ), t since the epoch.

Amplitudes (size cos φ, size sin φ) make it linear; the period is not. Where nothing states it, it may be any between what the
spacing of the references can show and the whole time from the first of them to the last, even in its logarithm. One phase goes
through all intervals, so that two periods are told apart by how they differ over the whole time, gaps included.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simulator.effects.base import Array, Effect, Parameter, Setting, Surroundings, Trial, Value
from simulator.effects.common import PHASE, convert_phase_amplitudes, measure_reference_arc, phase_amplitudes

SHORTEST_PERIOD_SPACINGS = 2.5  # spacings of the references; a swing is sampled twice in a period at least
PLANNED_PERIODS = 16  # periods of a plan, for which nothing can be scanned


def compute_period_band(around: Surroundings) -> tuple[float, float] | None:
    """Shortest and longest period that can show, s; None without a series of references."""
    spacing, arc = measure_reference_arc(around)
    if not arc > 2 * SHORTEST_PERIOD_SPACINGS * spacing:
        return None
    return SHORTEST_PERIOD_SPACINGS * spacing, float(np.ptp(around.references.t_s))


PERIOD_PARAMETER = Parameter("period_s", "s", 1000.0, "period", 1e-3, 1e12)


@dataclass(frozen=True)
class Sinusoid(Effect):
    """An effect whose columns are a sine and a cosine."""

    parameters: tuple[Parameter, ...] = (PHASE,)

    def amplitudes(self, setting: Setting) -> Array:
        """(size cos φ, size sin φ)."""
        return phase_amplitudes(setting)

    def from_amplitudes(self, amplitudes: Array) -> tuple[float, dict[str, Value]]:
        """Size and phase."""
        return convert_phase_amplitudes(amplitudes)


@dataclass(frozen=True)
class Periodic(Sinusoid):
    """A sinusoid of any period."""

    parameters: tuple[Parameter, ...] = (PERIOD_PARAMETER, PHASE)
    scanned: bool = True

    def trials(self, around: Surroundings) -> Sequence[Trial]:
        """Some periods, evenly spaced in their logarithm."""
        band = compute_period_band(around)
        return (
            ()
            if band is None
            else tuple(Trial({"period_s": float(p)}, 1 / PLANNED_PERIODS) for p in np.geomspace(*band, PLANNED_PERIODS))
        )

    def missing(self, around: Surroundings) -> str | None:
        """It needs references that follow one another."""
        return None if compute_period_band(around) else "it needs a series of references"
