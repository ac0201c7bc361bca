"""Penetration-angle biases of the Earth sensor, one for each quadrant.

Two of the four combinations, the differences of opposite quadrants, are a roll and a pitch of the Earth sensor against the sun
sensors. The sum is a change of the horizon's height, and y₁ − y₂ + y₃ − y₄ of its shape; both are seen by the Earth sensor
alone. The default direction is R's, in the order printed there (`gyrocal.sensors.earth.TRMM_BIASES` on what that order is).
"""

from dataclasses import replace

from gyrocal.arrays import Array
from simulator.effects.base import Parameter, Parameters, Setting
from simulator.effects.sensor.base import DEG, EARTH_SENSOR, Sightings, VectorEffect
from simulator.sensors.suite import SensorSuite


class _EsaBias(VectorEffect):
    def fitted(self, suite: SensorSuite, setting: Setting) -> SensorSuite:
        return replace(suite, earth=replace(suite.earth, biases=suite.earth.biases + DEG * self.amplitudes(setting)))

    def error(self, sightings: Sightings, axis: str | None, amplitudes: Array, parameters: Parameters) -> tuple[Array, Array]:
        sun, earth = sightings.nothing
        return sun, earth + DEG * amplitudes


EFFECT = _EsaBias(
    name="esa_bias",
    summary="penetration-angle biases of the Earth sensor's quadrants",
    says="the quadrants of the Earth sensor read up to {size} high or low",
    unit="deg",
    stage="sensor",
    prior=(3e-3, 2.0),
    bounds=(-3.0, 3.0),
    axes=(),
    parameters=(
        Parameter("bias_1_deg", "deg", -0.1574, "of the first quadrant; only the direction of the four counts"),
        Parameter("bias_2_deg", "deg", 0.04635, "of the second"),
        Parameter("bias_3_deg", "deg", -0.09414, "of the third"),
        Parameter("bias_4_deg", "deg", -0.05382, "of the fourth"),
    ),
    count=4,
    acts_on=EARTH_SENSOR,
    wanders=True,
    alignment="solved",
    finding=("ESA", "quadrants of the Earth sensor are off by constants"),
    meaning="The quadrants of the Earth sensor read constantly high or low.",
)
