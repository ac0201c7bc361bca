"""Random errors of the references.

reference_correlated
    First-order Gauss–Markov about one body axis, autocovariance size² exp(−|Δt|/τ): what an onboard filter leaves, or slowly
    wandering sensor errors. Adds to the white errors, of which the stated sigma stays.
reference_noise_excess
    The white reference errors times size; the recording goes on stating its sigma.
"""

import numpy as np

from simulator.effects.base import Array, References, Setting
from simulator.effects.common import DEG, GaussMarkov, NoiseFactor, TriedConstants


class _ReferenceCorrelated(GaussMarkov):
    def reference_wander(self, rng: np.random.Generator, references: References, setting: Setting) -> Array:
        return self.draw(rng, references.t_s, setting)


EFFECTS = [
    _ReferenceCorrelated(
        name="reference_correlated",
        summary="reference error correlated in time",
        says="errors of the reference attitude about {axis}, of {size}, last for a while",
        unit="deg",
        stage="random_reference",
        prior=(1e-5, 10.0),
        bounds=(0.0, 90.0),
        meaning="Errors of the reference attitude last for a while instead of being new each time.",
        scale=DEG,
        # Shorter ones look white, a longer one like a constant offset.
        tried=TriedConstants(spacings=1.5, intervals=4.0, ratio=2.0, most=8),
    ),
    NoiseFactor(
        name="reference_noise_excess",
        summary="reference noise is other than stated",
        says="the noise of the reference attitude about {axis} is {size} times what is stated",
        unit="factor",
        stage="reference_noise",
        prior=(0.1, 30.0),
        bounds=(0.0, 1e3),
        axis_optional=True,
        meaning="The white noise of the reference attitudes is not as stated; 1 would be as stated.",
        symptom="reference_noise_level",
    ),
]
