"""An element of the gyro matrix that steps at one time: raw_axis += size · 10⁻⁶ ω_toward H(t − time_s).

With toward = axis the scale factor jumps; else the gyro's input axis tilts towards another one, as after a thermal shock or
a shift of the mount. A sample that the step falls into shows its mean.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from simulator.effects.base import AXES, Array, Effect, Parameter, Stream, Surroundings, Trial, Value
from simulator.effects.common import PPM, TIME, index, number, on_axis, share_after


def any_axis(rng: np.random.Generator, around: Surroundings) -> Value:
    """One of the three."""
    return str(rng.choice(AXES))


class GMatrixStep(Effect):
    """See the module."""

    def columns(self, stream: Stream, axis: str | None, parameters: Mapping[str, Value]) -> Array:
        """10⁻⁶ ω_toward H(t − time_s)."""
        omega = stream.rates[:, index(str(parameters["toward"]))]
        return on_axis(PPM * omega * share_after(stream, number(parameters, "time_s")), axis)

    def trials(self, around: Surroundings) -> Sequence[Trial]:
        """Towards each axis."""
        return tuple(Trial({"toward": toward}, 1 / 3) for toward in AXES)


EFFECT = GMatrixStep(
    name="g_matrix_step",
    summary="an element G[axis, toward] steps at one time",
    says="{whose} scale or alignment jumps by {size} at one time",
    unit="ppm",
    stage="rate",
    prior=(1.0, 5e4),
    bounds=(-1e6, 1e6),
    parameters=(TIME, Parameter("toward", "", None, "body axis whose rate is picked up", choices=AXES, draw=any_axis)),
    meaning="One element of the gyro's scale-factor and misalignment matrix jumps at one time, as after a shock.",
    switched=True,
)
