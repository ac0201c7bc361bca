"""White gyro noise other than stated: the noise of each sample times size; 1 is as stated.

The same draws are scaled, so that all else stays as it was. Without an axis it acts on all three.
"""

import numpy as np

from simulator.effects.base import Array, Effect, SampleTests, Setting, Smallest, Surroundings
from simulator.effects.common import build_factor, compute_noise_powers, no_gyro_noise

FEWEST_QUIET_SAMPLES = 200  # quiet samples


class NoiseExcess(Effect):
    """See the module."""

    def noise_factor(self, setting: Setting) -> Array:
        """Size on its axes, 1 elsewhere."""
        return build_factor(setting.axis, setting.size)

    def smallest(self, around: Surroundings, tests: SampleTests) -> list[Smallest]:
        """Factors whose squares show in second differences."""
        n = sum(tests.quiet)
        if n < FEWEST_QUIET_SAMPLES or around.arw == 0:
            return [Smallest(None, np.inf, f"needs {FEWEST_QUIET_SAMPLES} quiet samples of a gyro with stated noise")]
        high, low = compute_noise_powers(n, tests)
        return [Smallest(None, float(np.sqrt(high)), f"any one axis; or a factor below {np.sqrt(low):.3f}")]


EFFECT = NoiseExcess(
    name="noise_excess",
    summary="white gyro noise is other than stated",
    says="{whose} white noise is {size} times what is stated",
    unit="factor",
    stage="white_noise",
    prior=(0.1, 30.0),
    bounds=(0.0, 1e6),
    axis_optional=True,
    blind_sizes=(1.15, 3.0),
    meaning="The gyro's white noise is not what the recording states; 1 would be as stated.",
    symptom="white_noise_level",
    requirement=no_gyro_noise,
)
