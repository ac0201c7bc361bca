"""The Sun in a quadrant of the Earth sensor that is not excluded: S rises, and the angle falls with it.

The filtered S takes up the Sun's radiance while it is in the field and gives it back after, so that the error of the angle is
−size · L with L the filter's answer to one inside the field and zero outside. The field is a cone about the quadrant's nominal
limb, and the Sun must not be behind the Earth, which it is where the line of sight passes the centre of a unit sphere by less
than 1, lengths in units of the Earth's semi-axes. With u_k whether a quadrant is used and g_k the filter's gain

    L_k = (1 − u_k g_k) L_{k−1} + u_k g_k inside_k

with g = 1 at the first of an arc, as the filter of `simulator.sensors.earth` has it.
"""

from dataclasses import replace

import numpy as np

from gyrocal.arrays import Array
from simulator.effects.base import Parameter, Parameters, Setting
from simulator.effects.common import recursion
from simulator.effects.sensor.base import DEG, EARTH_SENSOR, S_FILTER_TIME, SensorEffect, Sightings
from simulator.sensors.horizon import AZIMUTHS, POLAR_RADIUS, Horizon
from simulator.sensors.suite import SensorSuite
from simulator.truth.orbit import EARTH_RADIUS


class _EsaSunIntrusion(SensorEffect):
    def fitted(self, suite: SensorSuite, setting: Setting) -> SensorSuite:
        field = DEG * float(setting.parameters["field_deg"])
        return replace(
            suite,
            earth=replace(
                suite.earth,
                sun_radiance=DEG * setting.size / (3 * suite.earth.width),
                sun_field=field,
                sun_margin=-field,
                s_time_constant=float(setting.parameters["time_constant_s"]),
            ),
        )

    def error(self, sightings: Sightings, axis: str | None, amplitudes: Array, parameters: Parameters) -> tuple[Array, Array]:
        sun, _ = sightings.nothing
        inside = _find_sun_inside(sightings, np.cos(DEG * float(parameters["field_deg"])))
        step = np.diff(sightings.t_s, prepend=sightings.t_s[:1])
        first = np.diff(sightings.arc, prepend=-1) != 0
        gain = np.where(first, 1.0, -np.expm1(-step / float(parameters["time_constant_s"])))
        used_gain = np.where(sightings.used | first[:, None], gain[:, None], 0.0)
        decay, drive = np.ascontiguousarray((1 - used_gain).T), np.ascontiguousarray((used_gain * inside).T)
        response = np.stack([recursion(*quadrant) for quadrant in zip(decay, drive, strict=True)], axis=1)
        return sun, -DEG * amplitudes[0] * response


def _find_sun_inside(sightings: Sightings, cos_field: float) -> Array:
    """Find (m, 4) the quadrants with the Sun in their field, 1 or 0."""
    nominal = Horizon().nominal
    limbs = np.stack([np.sin(nominal) * np.cos(AZIMUTHS), np.sin(nominal) * np.sin(AZIMUTHS), np.full(4, np.cos(nominal))])
    cosines = np.einsum("mij,mj->mi", sightings.A, sightings.sun) @ limbs
    scale = np.array([EARTH_RADIUS, EARTH_RADIUS, POLAR_RADIUS])
    position, direction = sightings.position / scale, sightings.sun / scale
    along = (position * direction).sum(axis=1) / (direction * direction).sum(axis=1)
    miss_distance = np.linalg.norm(position - along[:, None] * direction, axis=1)
    lit = (along >= 0) | (miss_distance >= 1)
    return np.asarray(np.where((cosines > cos_field) & lit[:, None], 1.0, 0.0))


FIELDS, CONSTANTS = (3.5, 5.0, 7.0), (20.0, 60.0, 180.0)
EFFECT = _EsaSunIntrusion(
    name="esa_sun_intrusion",
    summary="the Sun in a quadrant of the Earth sensor is not excluded",
    says="the Sun in its view pulls the Earth sensor off by up to {size}",
    unit="deg",
    stage="sensor",
    prior=(0.01, 10.0),
    bounds=(-30.0, 30.0),
    axes=(),
    parameters=(Parameter("field_deg", "deg", 5.0, "half angle of a quadrant's field", lower=0.1, upper=30.0), S_FILTER_TIME),
    options=tuple({"field_deg": field, "time_constant_s": constant} for field in FIELDS for constant in CONSTANTS),
    acts_on=EARTH_SENSOR,
    refined=("field_deg", "time_constant_s"),
    meaning="The Sun in a quadrant of the Earth sensor is not excluded and pulls its angle down.",
)
