"""An element of the gyro matrix that follows a temperature: raw_axis += size · 10⁻⁶ ω_toward (T − mean T).

With toward = axis it is the scale factor's thermal coefficient (IEEE Std 952), else a mount that bends. T is what the
housekeeping shows, the gyro's temperature before others.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from simulator.effects.base import AXES, Array, Effect, Parameter, Stream, Surroundings, Trial, Value
from simulator.effects.common import PPM, index, on_axis
from simulator.effects.housekeeping import SUFFIX, temperature_column


def any_axis(rng: np.random.Generator, around: Surroundings) -> Value:
    """One of the three."""
    return str(rng.choice(AXES))


class GMatrixTemperature(Effect):
    """See the module."""

    def columns(self, stream: Stream, axis: str | None, parameters: Mapping[str, Value]) -> Array:
        """10⁻⁶ ω_toward (T − mean T)."""
        name = temperature_column(stream.housekeeping, str(parameters.get("column", "")), "gyro", self.name)
        temperature = stream.housekeeping[name]
        omega = stream.rates[:, index(str(parameters["toward"]))]
        return on_axis(PPM * omega * (temperature - temperature.mean()), axis)

    def trials(self, around: Surroundings) -> Sequence[Trial]:
        """Towards each axis."""
        return tuple(Trial({"toward": toward}, 1 / 3) for toward in AXES)

    def missing(self, around: Surroundings) -> str | None:
        """It needs a temperature."""
        there = any(name.endswith(SUFFIX) for name in around.stream.housekeeping)
        return None if there else f"the recording has no housekeeping column …{SUFFIX}"


EFFECT = GMatrixTemperature(
    name="g_matrix_temperature",
    summary="an element G[axis, toward] follows a temperature",
    says="{whose} scale or alignment changes by {size} with a temperature",
    unit="ppm per K",
    stage="rate",
    prior=(1e-2, 1e4),
    bounds=(-1e6, 1e6),
    parameters=(
        Parameter("toward", "", None, "body axis whose rate is picked up", choices=AXES, draw=any_axis),
        Parameter("column", "", "", "housekeeping column; the gyro's temperature if empty", choices=("*",)),
    ),
    meaning="One element of the gyro's scale-factor and misalignment matrix follows a temperature of the housekeeping data.",
    drawn=False,
)
