"""Reference error correlated in time: first-order Gauss–Markov, autocovariance size² exp(−|Δt|/τ), about one body axis.

What an onboard filter leaves, or slowly wandering sensor errors. Adds to the white errors, of which the stated sigma stays.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Parameter, References, Setting
from simulator.effects.common import DEG, gauss_markov, index, number


class ReferenceCorrelated(Effect):
    """See the module."""

    def reference_wander(self, rng: np.random.Generator, references: References, setting: Setting) -> Array:
        """The process at the references."""
        out = np.zeros((len(references.t_s), 3))
        process = gauss_markov(rng, references.t_s, number(setting.parameters, "time_constant_s"))
        out[:, index(setting.axis)] = setting.size * DEG * process
        return out


EFFECT = ReferenceCorrelated(
    name="reference_correlated",
    summary="reference error correlated in time",
    unit="deg",
    acts_on="references",
    kind="covariance",
    prior=(5e-4, 5.0),
    bounds=(0.0, 90.0),
    parameters=(Parameter("time_constant_s", "s", 600.0, "time constant", 1e-3, 1e9),),
)
