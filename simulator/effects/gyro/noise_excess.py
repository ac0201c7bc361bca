"""White gyro noise other than stated: the noise of each sample times size; 1 is as stated.

The same draws are scaled, so that all else stays as it was. Without an axis it acts on all three.
"""

from collections.abc import Sequence

import numpy as np
import scipy.special

from simulator.effects.base import Array, Effect, SampleTests, Setting, Smallest, Surroundings
from simulator.effects.common import chosen, log_uniform

FEWEST = 200  # quiet samples


class NoiseExcess(Effect):
    """See the module."""

    def noise_factor(self, setting: Setting) -> Array:
        """Size on its axes, 1 elsewhere."""
        factor = np.ones(3)
        factor[chosen(setting.axis)] = setting.size
        return factor

    def missing(self, around: Surroundings) -> str | None:
        """It needs noise to multiply."""
        return None if around.arw > 0 else "the recording states no gyro noise"

    def draw_size(self, rng: np.random.Generator, around: Surroundings, axis: str | None) -> float:
        """Somewhat too much."""
        return log_uniform(rng, 1.15, 3.0)

    def smallest(self, around: Surroundings, tests: SampleTests) -> Sequence[Smallest]:
        """Second differences: z = (f² − 1)/rel must pass the point of the test with scatter f² rel."""
        n = sum(tests.quiet)
        if n < FEWEST or around.arw == 0:
            return [Smallest(None, np.inf, f"needs {FEWEST} quiet samples of a gyro with stated noise")]
        relative = np.sqrt(2 / n * tests.correlated)
        level, spread = -scipy.special.ndtri(tests.event_p / 2) * relative, scipy.special.ndtri(tests.power) * relative
        size = float(np.sqrt((1 + level) / (1 - spread))) if spread < 1 else np.inf
        low = float(np.sqrt(max(1 - level, 0.0) / (1 + spread)))
        return [Smallest(None, size, f"any one axis; or a factor below {low:.3f}")]


EFFECT = NoiseExcess(
    name="noise_excess",
    summary="white gyro noise is other than stated",
    says="{whose} white noise is {size} times what is stated",
    unit="factor",
    stage="white_noise",
    prior=(0.1, 30.0),
    bounds=(0.0, 1e6),
    axis_optional=True,
    meaning="The gyro's white noise is not what the recording states; 1 would be as stated.",
    symptom="white_noise_level",
)
