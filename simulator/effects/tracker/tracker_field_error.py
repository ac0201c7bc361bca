"""A star tracker's low-frequency error: it depends on where the stars are in the field, and changes as they cross it.

About both axes across the boresight a process that forgets over an angle of the sky, not over a time: with s the angle that the
boresight has moved since the interval's start, the covariance is size² exp(−|Δs|/L), so that its correlation time is L over
the rate across the boresight, and it stands still in an inertial hold. L is a part of the field of view. Source: the class of
field-of-view spatial errors of ECSS-E-ST-60-20C, Star sensors terminology and performance specification.
"""

from dataclasses import dataclass

import numpy as np

from simulator.effects.base import Array, Parameter, Parameters, ProcessTimes, References, Setting
from simulator.effects.common import RAD_PER_ARCSEC, gauss_markov, number
from simulator.effects.tracker.base import TrackerEffect, find_tracker_rows

INTERVAL_SEPARATION_RAD = 1e6  # rad between intervals, over which nothing is remembered
LENGTHS_DEG = (0.5, 1.0, 2.0, 4.0, 8.0)  # parts of a field of view


@dataclass(frozen=True)
class TrackerFieldError(TrackerEffect):
    """See the module."""

    def reference_wander(self, rng: np.random.Generator, references: References, setting: Setting) -> Array:
        """The process about the tracker's x and y, in body axes."""
        own, seen = find_tracker_rows(references, str(setting.axis), self), references.trackers
        assert seen is not None
        along = seen.path[own] + INTERVAL_SEPARATION_RAD * references.interval[own]
        length = float(np.deg2rad(number(setting.parameters, "length_deg")))
        error = np.zeros((own.size, 3))
        for axis in range(2):
            process = setting.size * RAD_PER_ARCSEC * gauss_markov(rng, along, length)
            error[own] += process[:, None] * seen.to_axes[own][:, axis]
        return error

    def covariance(self, at: ProcessTimes, parameters: Parameters) -> Array:
        """exp(−|Δs|/L) in each interval."""
        assert at.path is not None
        along = at.path + INTERVAL_SEPARATION_RAD * at.interval
        length = float(np.deg2rad(number(parameters, "length_deg")))
        return np.asarray(RAD_PER_ARCSEC**2 * np.exp(-np.abs(np.subtract.outer(along, along)) / length))


EFFECT = TrackerFieldError(
    name="tracker_field_error",
    summary="a star tracker's error depends on where stars are in its field",
    says="star tracker {axis} errs by {size}, differently as stars cross its field",
    unit="arcsec",
    stage="random_reference",
    prior=(0.02, 360.0),
    bounds=(0.0, 36000.0),
    parameters=(Parameter("length_deg", "deg", 2.0, "over which it changes", 1e-3, 180.0, draw=(0.5, 8.0), tried=LENGTHS_DEG),),
    meaning="The star tracker's error across its boresight changes as stars cross its field, the faster the body turns.",
)
