"""Outliers in the gyro samples: with probability ``fraction`` a sample is off by ± size · E, E exponential of mean 1.

Bit flips, lost counts. The sign is random, so the mean absolute outlier is size and their mean is zero; each axis has its
own. Without an axis all three have them.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Parameter, SampleTests, Setting, Smallest, Stream, Surroundings
from simulator.effects.common import DEG, number, select_axes

FRACTION = 0.001
TWO = 3.89  # mean of a Poisson number that is two or more in nine cases of ten


class Spikes(Effect):
    """See the module."""

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """Add outliers."""
        axes = select_axes(setting.axis)
        shape = (len(samples), len(axes))
        hit = rng.random(shape) < number(setting.parameters, "fraction")
        outlier = rng.laplace(0.0, setting.size * DEG, shape)  # an exponential with random sign
        out = samples.copy()
        out[:, axes] += np.where(hit, outlier, 0.0)
        return out

    def smallest(self, around: Surroundings, tests: SampleTests) -> list[Smallest]:
        """Two outliers beyond the limit of the test, a reading less a median of seven, among exponential ones."""
        n, sigma, share = sum(tests.quiet), around.sample_sigma_deg, FRACTION
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
    blind_sizes=(8.0, 50.0),
    in_noise=True,
    parameters=(Parameter("fraction", "", FRACTION, "share of the samples", 0.0, 1.0, draw=(2e-4, 3e-3)),),
    meaning="Single samples are far off, as by bit flips or lost counts; the size is their mean height.",
    symptom="outliers",
)
