"""An element of the gyro matrix that follows a temperature: raw_axis += size · 10⁻⁶ ω_toward (T − mean T).

With toward = axis it is the scale factor's thermal coefficient (IEEE Std 952), else a mount that bends. T is what the
housekeeping shows, the gyro's temperature before others.
"""

from simulator.effects.base import Array, Effect, Parameters, Stream
from simulator.effects.common import PPM, TOWARD, index, put_on_axis
from simulator.effects.housekeeping_columns import find_temperature, make_temperature_parameter, no_gyro_temperature


class GMatrixTemperature(Effect):
    """See the module."""

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        """10⁻⁶ ω_toward (T − mean T)."""
        temperature = find_temperature(stream.housekeeping, parameters, "gyro", self.name)
        omega = stream.rates[:, index(str(parameters["toward"]))]
        return put_on_axis(PPM * omega * (temperature - temperature.mean()), axis)


EFFECT = GMatrixTemperature(
    name="g_matrix_temperature",
    summary="an element G[axis, toward] follows a temperature",
    says="{whose} scale or alignment changes by {size} with a temperature",
    unit="ppm per K",
    stage="rate",
    prior=(1e-2, 1e4),
    bounds=(-1e6, 1e6),
    parameters=(TOWARD, make_temperature_parameter("the gyro's")),
    meaning="One element of the gyro's scale-factor and misalignment matrix follows a temperature of the housekeeping data.",
    requirement=no_gyro_temperature,
)
