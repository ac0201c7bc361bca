"""Bias correlated in time: first-order Gauss–Markov noise of the rate, autocovariance size² exp(−|Δt|/τ).

IEEE Std 952, annex C: a spectrum 2 size² τ/(1 + (2πfτ)²), so that the Allan deviation rises to 0.617 size near 1.9 τ and falls
again. Unlike a random walk it returns. The time constant is tried from what the references' spacing can show to what an
interval can; a longer one is a random walk, or a bias of its own in each interval.
"""

from collections.abc import Sequence

import numpy as np

from simulator.effects.base import (
    Array,
    Effect,
    Parameter,
    Parameters,
    ProcessTimes,
    Setting,
    Stream,
    Surroundings,
    Trial,
)
from simulator.effects.common import (
    DEG_H,
    gauss_markov,
    list_time_constants,
    markov,
    measure_reference_arc,
    number,
    put_on_axis,
)

SHORTEST_BIAS_CONSTANT = 1.0  # spacing of the references
LONGEST_BIAS_CONSTANT = 1.0  # intervals
BIAS_CONSTANT_RATIO = 3.0  # between time constants that are tried


class BiasMarkov(Effect):
    """See the module."""

    def wander(self, rng: np.random.Generator, stream: Stream, setting: Setting) -> Array:
        """The process on its axis, in true time over the gaps too."""
        process = gauss_markov(rng, stream.t_s, number(setting.parameters, "time_constant_s"))
        return put_on_axis(setting.size * DEG_H * process, setting.axis)[:, :, 0]

    def covariance(self, at: ProcessTimes, parameters: Parameters) -> Array:
        """exp(−|Δt|/τ)."""
        return np.asarray(DEG_H**2 * markov(at.t_s, number(parameters, "time_constant_s")))

    def trials(self, around: Surroundings) -> Sequence[Trial]:
        """Time constants evenly spaced in their logarithm."""
        spacing, arc = measure_reference_arc(around)
        if not arc > 2 * spacing:
            return ()
        return list_time_constants(SHORTEST_BIAS_CONSTANT * spacing, LONGEST_BIAS_CONSTANT * arc, BIAS_CONSTANT_RATIO)

    def missing(self, around: Surroundings) -> str | None:
        """It needs references that follow one another."""
        return None if self.trials(around) else "it needs a series of references"


EFFECT = BiasMarkov(
    name="bias_markov",
    summary="bias correlated in time (Markov)",
    says="{whose} bias wanders by {size} and comes back",
    unit="deg/h",
    stage="random_rate",
    prior=(1e-5, 1e3),
    bounds=(0.0, 1e9),
    parameters=(Parameter("time_constant_s", "s", 600.0, "time constant", 1e-3, 1e9),),
    meaning="The gyro's bias wanders and returns, within a time constant.",
)
