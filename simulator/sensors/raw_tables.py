"""The raw sensor tables of a simulated recording.

M0 at the level of the sensors: TRMM's sun sensors as nominal, heads at right angles, and an Earth sensor without biases whose S
detector shows a constant offset without noise, so that its filter is exact and all noise is white. Counts are whole numbers.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import radians

import numpy as np

from gyrocal.errors import InputError
from gyrocal.recording.sensor_tables import SensorTables, read
from simulator.effects.base import Setting
from simulator.effects.sensor import SENSOR_EFFECTS
from simulator.scenario import Scenario
from simulator.sensors.earth import TrueEarthSensor
from simulator.sensors.horizon import Horizon, compute_orbit_position
from simulator.sensors.suite import SensorSuite, simulate_earth_table, simulate_sun_table
from simulator.sensors.sun import build_trmm_sensors
from simulator.streams import generator
from simulator.truth.motion import Motion
from simulator.truth.rotation import convert_to_matrix
from simulator.truth.sun import DAY, compute_julian_date, compute_sun_vector


def build_nominal_suite(sun_noise: float, earth_noise: float) -> SensorSuite:
    """Build the sensors of M0; noises are 1-sigma of each angle, rad."""
    square = (np.zeros(3), np.zeros(3))
    first, second = (replace(sensor, noise=sun_noise) for sensor in build_trmm_sensors(heads=square))
    return SensorSuite((first, second), TrueEarthSensor(Horizon(), sigma=earth_noise, sigma_s=0.0, swing=0.0))


def simulate_sensor_tables(
    scenario: Scenario,
    motion: Motion,
    effects: Sequence[Setting] = (),
    seed: int = 0,
    case: int = 0,
    noise: bool = True,
    change: Callable[[SensorSuite], SensorSuite] | None = None,
) -> SensorTables | None:
    """Simulate the raw sensor tables of a scenario, None if it has no sensors.

    An `InputError` if there is an effect on the sensors, and no sensors.

    Parameters
    ----------
    scenario : what was simulated
    motion : its noise-free truth
    effects : on the sensors, see `simulator.effects.sensor`
    seed, case : of the random streams; an effect leaves the noise as it was
    noise : whether there is any; counts are whole numbers all the same
    change : what else is done to the nominal sensors, for discrepancies that are no listed effect
    """
    if scenario.sensors is None:
        if effects:
            raise InputError(f"{effects[0].effect}: acts on raw sensor tables; the scenario needs a [sensors] section")
        return None
    import pandas as pd  # late: 65 MiB that a Monte Carlo worker does without

    section, orbit = scenario.sensors, scenario.orbit.build_circular_orbit()
    suite = build_nominal_suite(radians(section.sun_noise_deg) * noise, radians(section.earth_noise_deg) * noise)
    suite = change(suite) if change else suite
    for setting in effects:
        suite = SENSOR_EFFECTS[setting.effect].fitted(suite, setting)
    t, A = motion.sensor_t_s, convert_to_matrix(motion.sensor_quaternions)
    position, sun = compute_orbit_position(orbit, t), compute_sun_vector(compute_julian_date(scenario.epoch) + t / DAY)
    sun_rng, earth_rng = generator(seed, case, "sun_sensor_noise"), generator(seed, case, "earth_sensor_noise")
    counts = simulate_sun_table(sun_rng, suite.sun_sensors, t, A, position, sun)
    # The filters start anew in each interval.
    angles = [
        simulate_earth_table(earth_rng, suite.earth, t[rows], A[rows], position[rows], sun[rows])
        for rows in motion.sensor_intervals
    ]
    ephemeris = pd.DataFrame(
        np.column_stack([t, position, sun]),
        columns=["t_s", *(f"position_{axis}_m" for axis in "xyz"), *(f"sun_{axis}" for axis in "xyz")],
    )
    return read({"sun_sensor": counts, "earth_sensor": pd.concat(angles, ignore_index=True), "ephemeris": ephemeris})
