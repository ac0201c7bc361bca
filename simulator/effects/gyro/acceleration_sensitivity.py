"""Bias that follows an acceleration: raw += size · (a − mean a)/g₀, a the accelerometer along one axis, in housekeeping.

The g-sensitivity of vibrating and spinning gyros (IEEE Std 1431, drift per g). The columns are those whose names are
acceleration_x_m_s2, … with anything before; `toward` says which axis' acceleration acts. The constant part is the bias itself.
"""

from collections.abc import Sequence

import numpy as np

from gyrocal.errors import InputError
from simulator.effects.base import AXIS_NAMES, Array, Effect, Parameter, Parameters, Stream, Surroundings, Trial
from simulator.effects.common import DEG_H, put_on_axis
from simulator.effects.housekeeping_columns import ACCELERATION, STANDARD_GRAVITY

LEAST_CHANGE = 1e-3  # g₀, RMS: a steadier acceleration is a bias


class _AccelerationSensitivity(Effect):
    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        toward = str(parameters["toward"])
        name = _find_acceleration(stream, toward)
        if name is None:
            raise InputError(f"{self.name}: the recording has no housekeeping column …{ACCELERATION.format(toward)}")
        acceleration = stream.housekeeping[name] / STANDARD_GRAVITY
        return put_on_axis((acceleration - acceleration.mean()) * DEG_H, axis)

    def trials(self, around: Surroundings) -> Sequence[Trial]:
        """Try each acceleration that changes."""
        axes = _list_changing_axes(around.stream)
        return [Trial({"toward": toward}, 1 / len(axes)) for toward in axes]

    def missing(self, around: Surroundings) -> str | None:
        """Require an acceleration that changes."""
        if not any(_find_acceleration(around.stream, toward) for toward in AXIS_NAMES):
            return "the recording has no housekeeping column …acceleration_x_m_s2, …_y_… or …_z_…"
        return None if _list_changing_axes(around.stream) else f"no acceleration changes by {LEAST_CHANGE:g} g"


def _find_acceleration(stream: Stream, toward: str) -> str | None:
    """Name of the housekeeping column of an axis' acceleration, the shortest of several."""
    return min((name for name in stream.housekeeping if name.endswith(ACCELERATION.format(toward))), key=len, default=None)


def _list_changing_axes(stream: Stream) -> list[str]:
    """List the axes whose recorded acceleration changes."""
    named = {toward: _find_acceleration(stream, toward) for toward in AXIS_NAMES}
    return [
        toward
        for toward, name in named.items()
        if name is not None and float(np.std(stream.housekeeping[name])) > LEAST_CHANGE * STANDARD_GRAVITY
    ]


EFFECT = _AccelerationSensitivity(
    name="acceleration_sensitivity",
    summary="bias follows a recorded acceleration",
    says="{whose} bias {way} by {size} with an acceleration",
    ways=("rises", "falls"),
    unit="deg/h per g",
    stage="rate",
    prior=(1e-3, 1e4),
    parameters=(Parameter("toward", "", None, "body axis whose acceleration acts", choices=AXIS_NAMES),),
    meaning="The gyro's bias follows an acceleration of the housekeeping data; positive: it reads high where that is positive.",
)
