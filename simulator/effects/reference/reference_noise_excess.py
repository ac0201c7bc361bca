"""Reference noise other than stated: the white reference errors times size; the recording goes on stating its sigma.

The same draws are scaled, so that all else stays as it was. Without an axis it acts on all three.
"""

import numpy as np
import scipy.special

from simulator.effects.base import AXIS_NAMES, Array, Effect, SampleTests, Setting, Smallest, Surroundings
from simulator.effects.common import build_factor, compute_noncentrality


class ReferenceNoiseExcess(Effect):
    """See the module."""

    def noise_factor(self, setting: Setting) -> Array:
        """Size on its axes, 1 elsewhere."""
        return build_factor(setting.axis, setting.size)

    def smallest(self, around: Surroundings, tests: SampleTests) -> list[Smallest]:
        """χ² of three axes' mean square second differences; one axis with a factor f has z = (f² − 1) v/rel."""
        references = around.references
        inside = np.diff(references.interval) == 0
        count = int(np.sum(inside[1:] & inside[:-1]))
        if count < tests.fewest_references:
            return [Smallest(None, np.inf, "needs a longer series of references")]
        point = 2 * scipy.special.gammainccinv(1.5, tests.reference_p)  # of a χ² with 3 degrees of freedom
        needed = np.sqrt(compute_noncentrality(point, 3, tests.power))
        relative = np.sqrt(2 * tests.correlated * tests.trimming / count)
        walk = 2 * around.arw**2 * float(np.median(np.diff(references.t_s)[inside]))
        noise = 6 * np.median(around.reference_sigma, axis=0) ** 2
        factors = np.sqrt(1 + needed * relative * (noise + walk) / noise)
        return [Smallest(axis, float(factor)) for axis, factor in zip(AXIS_NAMES, factors, strict=True)]


EFFECT = ReferenceNoiseExcess(
    name="reference_noise_excess",
    summary="reference noise is other than stated",
    says="the noise of the reference attitude about {axis} is {size} times what is stated",
    unit="factor",
    stage="reference_noise",
    prior=(0.1, 30.0),
    bounds=(0.0, 1e3),
    axis_optional=True,
    blind_sizes=(1.3, 3.0),
    meaning="The white noise of the reference attitudes is not as stated; 1 would be as stated.",
    symptom="reference_noise_level",
)
