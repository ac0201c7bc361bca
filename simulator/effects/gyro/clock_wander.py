"""Time tags that wander: raw(t) = raw_true(t − d(t)) to first order, d a Gauss–Markov process of σ = size.

A receiver that stamps samples as they arrive, or a clock that is steered. A diagnosis has no name for it: such errors are part
of its remainder, which an adopted scenario simulates.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Parameter, Setting, Stream
from simulator.effects.common import gauss_markov, number
from simulator.effects.timing import compute_delay_columns


class ClockWander(Effect):
    """See the module."""

    def wander(self, rng: np.random.Generator, stream: Stream, setting: Setting) -> Array:
        """−d · dω_raw/dt."""
        late_s = setting.size * gauss_markov(rng, stream.t_s, number(setting.parameters, "time_constant_s"))
        return np.asarray(compute_delay_columns(stream)[:, :, 0] * late_s[:, None])


EFFECT = ClockWander(
    name="clock_wander",
    summary="the gyro's time tags wander",
    says="the gyro's time tags wander by {size}",
    unit="s",
    stage="random_rate",
    prior=(1e-6, 1.0),
    bounds=(0.0, 10.0),
    axes=(),
    parameters=(Parameter("time_constant_s", "s", 60.0, "time constant", 1e-3, 1e9),),
    meaning="The gyro's time tags are early and late by a random time that lasts for a while.",
)
