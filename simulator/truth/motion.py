"""Noise-free truth of a scenario: what gyros, references and raw sensors then see."""

from dataclasses import dataclass, field

import numpy as np

from gyrocal.arrays import Array


@dataclass(frozen=True)
class Motion:
    """Noise-free truth of a scenario."""

    t_s: Array  # (n,) sample starts, s since the epoch
    duration_s: Array  # (n,) sample durations, s
    rates: Array  # (n, 3) true body rates, rad/s: mean over each sample, or at its start if the scenario reads points
    intervals: tuple[slice, ...]  # one slice of the samples per interval
    reference_t_s: Array  # (m,) times of the reference attitudes, s since the epoch
    quaternions: Array  # (m, 4) true attitudes then, inertial to body, scalar last
    # the same at the tags of the raw sensors
    sensor_t_s: Array = field(default_factory=lambda: np.zeros(0))
    sensor_quaternions: Array = field(default_factory=lambda: np.zeros((0, 4)))
    sensor_intervals: tuple[slice, ...] = ()  # one slice of these tags per interval
