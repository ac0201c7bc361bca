"""Bias that follows a housekeeping temperature: raw += size · (T − mean T), the mean over the recording's samples.

The linear term of a gyro's thermal model; the constant one is the bias itself. T is what the housekeeping shows, linear
between its rows. The column may be named; else one whose name ends in temperature_c is taken, the gyro's before others.
"""

from simulator.effects.base import Array, Effect, Parameters, Stream
from simulator.effects.common import DEG_H, put_on_axis
from simulator.effects.housekeeping_columns import find_temperature, make_temperature_parameter, no_gyro_temperature


class BiasTemperature(Effect):
    """See the module."""

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        """T − mean T, as deg/h."""
        temperature = find_temperature(stream.housekeeping, parameters, "gyro", self.name)
        return put_on_axis((temperature - temperature.mean()) * DEG_H, axis)


EFFECT = BiasTemperature(
    name="bias_temperature",
    summary="bias follows a housekeeping temperature",
    says="{whose} bias {way} by {size} with a temperature",
    ways=("rises", "falls"),
    unit="deg/h per K",
    stage="rate",
    prior=(1e-6, 1e3),
    parameters=(make_temperature_parameter("the gyro's"),),
    meaning="The gyro's bias follows a temperature of the housekeeping data; positive: it reads high when warm.",
    requirement=no_gyro_temperature,
)
