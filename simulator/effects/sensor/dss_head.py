"""Heads of a sun sensor that are not at right angles: the β head is turned by a 2-3-1 Euler sequence (e₁, e₂, e₃).

R found both sensors' heads so mounted after launch. With a = tan α, b = tan β, to first order (`simulator.sensors.sun`)

    δ tan β = −e₁ a b − e₂ a + e₃ (1 + b²),    δα = 0

A misalignment m of the whole sensor does the same to β with m = (e₃, e₁, e₂), but also turns the α head:
δ tan α = m_x a b − m_y (1 + a²) + m_z b. An orthogonal matrix can therefore not take a head's angles, and least squares divides
them: where both angles are as noisy and the Sun comes from everywhere, about half of each goes into the matrix and as much is
left in β as is brought into α. Only e₃ along a = 0, where the yaw is updated, is taken in full.

The size is the norm of the three angles; the default direction is that of the flight's DSS-2.
"""

from dataclasses import replace

import numpy as np

from gyrocal.arrays import Array
from simulator.effects.base import Parameter, Parameters, Setting
from simulator.effects.sensor.base import DEG, Sightings, VectorEffect
from simulator.sensors.suite import SensorSuite


class _DssHead(VectorEffect):
    def fitted(self, suite: SensorSuite, setting: Setting) -> SensorSuite:
        sensors = list(suite.sun_sensors)
        place = int(str(setting.axis)) - 1
        sensors[place] = replace(sensors[place], head=sensors[place].head + DEG * self.amplitudes(setting))
        return replace(suite, sun_sensors=tuple(sensors))

    def error(self, sightings: Sightings, axis: str | None, amplitudes: Array, parameters: Parameters) -> tuple[Array, Array]:
        sun, earth = sightings.nothing
        rows = sightings.sun_sensor == int(str(axis))
        a, b = np.tan(sightings.sun_angles[rows].T)
        e1, e2, e3 = DEG * amplitudes
        p = np.cos(e2) * b - np.sin(e2) * (a * np.cos(e1) - np.sin(e1))
        q = a * np.sin(e1) + np.cos(e1)
        sun[rows, 1] = e3 + np.arctan2(p, q) - sightings.sun_angles[rows, 1]
        return sun, earth


EFFECT = _DssHead(
    name="dss_head",
    summary="the heads of a sun sensor are not at right angles",
    says="the two heads of sun sensor {axis} are {size} off a right angle",
    unit="deg",
    stage="sensor",
    prior=(3e-3, 2.0),
    bounds=(-5.0, 5.0),
    axes=("1", "2"),
    parameters=(
        Parameter("e1_deg", "deg", 0.206, "first Euler angle, about y; only the direction of the three counts"),
        Parameter("e2_deg", "deg", 0.061, "second, about z"),
        Parameter("e3_deg", "deg", 0.182, "third, about x"),
    ),
    count=3,
    acts_on="DSS-{axis}",
    alignment="mistaken",
    meaning="The two heads of a sun sensor are not at right angles, which differs from a rotation of the whole sensor; "
    "the axis is the number of the sensor.",
)
