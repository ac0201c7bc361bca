"""Outliers in the gyro samples: with probability ``fraction`` a sample is off by ± size · E, E exponential of mean 1.

Bit flips, lost counts. The sign is random, so the mean absolute outlier is size and their mean is zero; each axis has its
own. Without an axis all three have them.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Parameter, Setting, Stream
from simulator.effects.common import DEG, number, select_axes

FRACTION = 0.001


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


EFFECT = Spikes(
    name="spikes",
    summary="outliers in the gyro samples",
    says="single samples of {gyro} are far off, by about {size}",
    unit="deg/s",
    stage="outliers",
    prior=(1e-6, 1e3),
    bounds=(0.0, 1e4),
    axis_optional=True,
    parameters=(Parameter("fraction", "", FRACTION, "share of the samples", 0.0, 1.0),),
    meaning="Single samples are far off, as by bit flips or lost counts; the size is their mean height.",
    symptom="outliers",
)
