"""Reference attitudes: when they are taken, and their errors.

A reference is exp([e×]) A with A the true attitude and e ~ N(0, diag(σ²)) in body axes, independent from one reference to
the next. They are taken at the ends of each interval only, as in N, or as a series through its constant-rate parts too.
"""

import numpy as np

from simulator.arrays import Array
from simulator.truth.maneuvers import Profile
from simulator.truth.rotation import apply_rotation_errors

TIME_TOLERANCE = 1e-6  # s; times closer than this are one


def list_reference_times(profile: Profile, every: float | None) -> Array:
    """Local times of an interval's reference attitudes, (m,) s, strictly increasing, both ends included.

    Parameters
    ----------
    every : spacing of a series, s, counted from the interval's start; None for the two ends only
    """
    length = profile.stop_s - profile.start_s
    if every is None:
        return np.array([0.0, length])
    inner = every * np.arange(1, int(np.ceil(length / every)))
    inner = inner[inner < length - TIME_TOLERANCE]
    for start, stop in profile.moving_spans:
        inner = inner[(inner <= start) | (inner >= stop)]
    return np.concatenate([[0.0], inner, [length]])


def add_reference_errors(rng: np.random.Generator, quaternions: Array, sigma: Array) -> Array:
    """Reference attitudes (m, 4) with their random errors, of standard deviations (3,) about each body axis, rad."""
    return apply_rotation_errors(quaternions, rng.standard_normal((len(quaternions), 3)) * sigma)
