"""Outliers in the gyro samples: with probability ``fraction`` a sample is off by ± size · E, E exponential of mean 1.

Bit flips, lost counts. The sign is random, so the mean absolute outlier is size and their mean is zero; each axis has its
own. Without an axis all three have them.
"""

from collections.abc import Sequence

import numpy as np

from simulator.effects.base import Array, Effect, Parameter, SampleTests, Setting, Smallest, Stream, Surroundings, Value
from simulator.effects.common import DEG, chosen, log_uniform, number, sample_sigma_deg

FRACTION = 0.001
TWO = 3.89  # mean of a Poisson number that is two or more in nine cases of ten


def any_fraction(rng: np.random.Generator, around: Surroundings) -> Value:
    """A share of outliers of which there are some and not many."""
    return log_uniform(rng, 2e-4, 3e-3)


class Spikes(Effect):
    """See the module."""

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """With outliers added."""
        axes = chosen(setting.axis)
        shape = (len(samples), len(axes))
        hit = rng.random(shape) < number(setting.parameters, "fraction")
        outlier = rng.laplace(0.0, setting.size * DEG, shape)  # an exponential with random sign
        out = samples.copy()
        out[:, axes] += np.where(hit, outlier, 0.0)
        return out

    def draw_size(self, rng: np.random.Generator, around: Surroundings, axis: str | None) -> float:
        """Clear of the noise of a sample."""
        return sample_sigma_deg(around) * log_uniform(rng, 8.0, 50.0)

    def smallest(self, around: Surroundings, tests: SampleTests) -> Sequence[Smallest]:
        """Two outliers beyond the limit of the test, a reading less a median of seven, among exponential ones."""
        n, sigma, share = sum(tests.quiet), sample_sigma_deg(around), FRACTION
        if 3 * n * share <= TWO:
            return [Smallest(None, np.inf, f"too few samples for a share of {share:g}")]
        limit = tests.outlier_sigma * sigma * np.sqrt(1 + np.pi / 14)
        size = float(limit / np.log(3 * n * share / TWO))
        return [Smallest(None, size, f"share {share:g} on all axes; two beyond {limit:.2g} suffice")]


EFFECT = Spikes(
    name="spikes",
    summary="outliers in the gyro samples",
    says="single samples of {gyro} are far off, by about {size}",
    unit="deg/s",
    stage="outliers",
    prior=(1e-6, 1e3),
    bounds=(0.0, 1e4),
    axis_optional=True,
    parameters=(Parameter("fraction", "", FRACTION, "share of the samples", 0.0, 1.0, draw=any_fraction),),
    meaning="Single samples are far off, as by bit flips or lost counts; the size is their mean height.",
    symptom="outliers",
)
