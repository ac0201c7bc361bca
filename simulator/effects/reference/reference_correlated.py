"""Reference error correlated in time: first-order Gauss–Markov, autocovariance size² exp(−|Δt|/τ), about one body axis.

What an onboard filter leaves, or slowly wandering sensor errors. Adds to the white errors, of which the stated sigma stays.
"""

from collections.abc import Sequence

import numpy as np

from simulator.effects.base import (
    Array,
    Effect,
    Parameter,
    Parameters,
    ProcessTimes,
    References,
    Setting,
    Surroundings,
    Trial,
)
from simulator.effects.common import DEG, gauss_markov, list_time_constants, markov, measure_reference_arc, number, put_on_axis

SHORTEST_ERROR_CONSTANT = 1.5  # spacings of the references: shorter ones look white
LONGEST_ERROR_CONSTANT = 4.0  # intervals: a longer time constant looks like a constant offset
ERROR_CONSTANT_RATIO = 2.0  # between time constants that are tried, or more where there would be too many of them
MOST_TIME_CONSTANTS = 8


class ReferenceCorrelated(Effect):
    """See the module."""

    def reference_wander(self, rng: np.random.Generator, references: References, setting: Setting) -> Array:
        """The process at the references."""
        process = gauss_markov(rng, references.t_s, number(setting.parameters, "time_constant_s"))
        return put_on_axis(setting.size * DEG * process, setting.axis)[:, :, 0]

    def covariance(self, at: ProcessTimes, parameters: Parameters) -> Array:
        """exp(−|Δt|/τ)."""
        return np.asarray(DEG**2 * markov(at.t_s, number(parameters, "time_constant_s")))

    def trials(self, around: Surroundings) -> Sequence[Trial]:
        """Time constants evenly spaced in their logarithm, from what the spacing can show to what an interval can."""
        spacing, longest = measure_reference_arc(around)
        return list_time_constants(
            SHORTEST_ERROR_CONSTANT * spacing, LONGEST_ERROR_CONSTANT * longest, ERROR_CONSTANT_RATIO, MOST_TIME_CONSTANTS
        )

    def missing(self, around: Surroundings) -> str | None:
        """It needs references that follow one another."""
        return None if self.trials(around) else "it needs a series of references"


EFFECT = ReferenceCorrelated(
    name="reference_correlated",
    summary="reference error correlated in time",
    says="errors of the reference attitude about {axis}, of {size}, last for a while",
    unit="deg",
    stage="random_reference",
    prior=(1e-5, 10.0),
    bounds=(0.0, 90.0),
    parameters=(Parameter("time_constant_s", "s", 600.0, "time constant", 1e-3, 1e9),),
    meaning="Errors of the reference attitude last for a while instead of being new each time.",
)
