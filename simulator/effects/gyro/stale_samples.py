"""Telemetry that repeats the previous sample, all axes at once: runs of size samples on average.

A two-state chain, fresh and stale. A stale run goes on with probability 1 − 1/size, so its length is geometric of mean
size; fresh ones turn stale with probability p such that the share of stale samples f = p·size/(1 + p·size) is ``fraction``.
The first sample of an interval is fresh.
"""

import numpy as np

from gyrocal.errors import InputError
from simulator.effects.base import Array, Effect, Parameter, Setting, Stream
from simulator.effects.common import number


def draw_stale_mask(rng: np.random.Generator, count: int, mean_run: float, fraction: float) -> np.ndarray:
    """Which samples repeat the one before, (count,) bool."""
    onset = fraction / ((1 - fraction) * mean_run)
    if onset > 1:
        raise InputError(
            f"stale_samples: fraction {fraction:g} needs longer runs than {mean_run:g}; one sample between two is fresh"
        )
    stale = np.zeros(count, dtype=bool)
    place = int(rng.geometric(onset)) if onset > 0 else count
    while place < count:
        length = int(rng.geometric(1 / mean_run))
        stale[place : place + length] = True
        place += length + int(rng.geometric(onset))
    return stale


class StaleSamples(Effect):
    """See the module."""

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """Repeat samples."""
        stale = draw_stale_mask(rng, len(samples), setting.size, number(setting.parameters, "fraction"))
        stale[[part.start for part in stream.intervals]] = False
        source = np.maximum.accumulate(np.where(stale, 0, np.arange(len(samples))))
        return np.asarray(samples[source])


EFFECT = StaleSamples(
    name="stale_samples",
    summary="telemetry repeats the previous sample",
    says="telemetry repeats old samples of the gyro, in runs of {number} on average",
    unit="samples, mean run",
    stage="telemetry",
    prior=(1.0, 100.0),
    bounds=(1.0, 1e6),
    axes=(),
    parameters=(Parameter("fraction", "", 0.01, "share of the samples that are repeats", 0.0, 0.99),),
    meaning="Telemetry repeats the sample before; the size is the mean length of a run of repeats.",
    symptom="repeats",
)
