"""DSS-2 turned against DSS-1: O = Mᵀ O_nominal with M = exp([m×]), the true sensor frame to the nominal one as in R (1).

DSS-1 is the reference, as in R: turning all sensors together is an attitude error. m is about the axes of the nominal sensor
frame; the default direction is that of R (3).
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array
from simulator.effects.base import Parameter, Parameters, Setting
from simulator.effects.sensor.base import DEG, Sightings, VectorEffect
from simulator.sensors.suite import SensorSuite

MISALIGNED_SENSOR = 2


class _DssMisalignment(VectorEffect):
    def fitted(self, suite: SensorSuite, setting: Setting) -> SensorSuite:
        first, second = suite.sun_sensors
        turn = Rotation.from_rotvec(DEG * self.amplitudes(setting)).as_matrix()
        return replace(suite, sun_sensors=(first, replace(second, alignment=second.alignment @ turn)))

    def error(self, sightings: Sightings, axis: str | None, amplitudes: Array, parameters: Parameters) -> tuple[Array, Array]:
        sun, earth = sightings.nothing
        rows = sightings.sun_sensor == MISALIGNED_SENSOR
        angles = sightings.sun_angles[rows]
        nominal = np.column_stack([np.tan(angles), np.ones(len(angles))])
        directions = Rotation.from_rotvec(DEG * amplitudes).inv().apply(nominal)
        sun[rows] = np.arctan2(directions[:, :2], directions[:, 2:]) - angles
        return sun, earth


EFFECT = _DssMisalignment(
    name="dss_misalignment",
    summary="DSS-2 is turned against DSS-1",
    says="one sun sensor is turned by {size} against the other",
    unit="deg",
    stage="sensor",
    prior=(3e-3, 2.0),
    bounds=(-5.0, 5.0),
    axes=(),
    parameters=(
        Parameter("m_x_deg", "deg", -0.1565, "about the sensor's x; only the direction of the three counts"),
        Parameter("m_y_deg", "deg", -0.1141, "about y"),
        Parameter("m_z_deg", "deg", 0.1140, "about z"),
    ),
    count=3,
    acts_on=f"DSS-{MISALIGNED_SENSOR}",
    wanders=True,
    alignment="solved",
    meaning="DSS-2 is turned against DSS-1.",
)
