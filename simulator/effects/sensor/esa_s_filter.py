"""The filter of the Earth sensor's S detector starts from a wrong value when a quadrant returns after the Sun (R, figure 8).

While the Sun is predicted in a quadrant, the quadrant is not used and its S not filtered. With the time t₀ of the last such
sample, the quadrant's angle is in error by size · exp(−(t − t₀)/τ) after it. The size is 3 w (o − S_f) of the wrong start S_f
(`simulator.sensors.earth`).
"""

from dataclasses import replace

import numpy as np

from gyrocal.arrays import Array
from simulator.effects.base import Parameters, Setting
from simulator.effects.sensor.base import DEG, EARTH_SENSOR, S_FILTER_TIME, SensorEffect, Sightings
from simulator.sensors.suite import SensorSuite


class _EsaSFilter(SensorEffect):
    def fitted(self, suite: SensorSuite, setting: Setting) -> SensorSuite:
        start = suite.earth.offset - DEG * setting.size / (3 * suite.earth.width)
        constant = float(setting.parameters["time_constant_s"])
        return replace(suite, earth=replace(suite.earth, s_filter="restarted", s_restart=start, s_time_constant=constant))

    def error(self, sightings: Sightings, axis: str | None, amplitudes: Array, parameters: Parameters) -> tuple[Array, Array]:
        sun, earth = sightings.nothing
        constant = float(parameters["time_constant_s"])
        for number in np.unique(sightings.arc):
            rows = np.flatnonzero(sightings.arc == number)
            t, used = sightings.t_s[rows, None], sightings.used[rows]
            lost = np.maximum.accumulate(np.where(used, -np.inf, t), axis=0)  # when it was last not used
            earth[rows] = np.where(used, np.exp(-(t - lost) / constant), 0.0)
        return sun, DEG * amplitudes[0] * earth


EFFECT = _EsaSFilter(
    name="esa_s_filter",
    summary="the S filter starts from a wrong value when a quadrant returns",
    says="the Earth sensor errs by up to {size} after the Sun has passed through its view",
    unit="deg",
    stage="sensor",
    prior=(0.01, 5.0),
    bounds=(-10.0, 10.0),
    axes=(),
    parameters=(S_FILTER_TIME,),
    options=tuple({"time_constant_s": value} for value in (15.0, 30.0, 60.0, 120.0, 240.0)),
    acts_on=EARTH_SENSOR,
    refined=("time_constant_s",),
    meaning="A quadrant of the Earth sensor errs for a while after the Sun was in it, as the filter of its S detector restarts "
    "from a wrong value.",
)
