"""Raw tables of the sun sensors on an orbit."""

import numpy as np

import gyrocal.sensors.sun as ground
from simulator.sensors.horizon import compute_orbit_position
from simulator.sensors.suite import simulate_sun_table
from simulator.sensors.sun import build_trmm_sensors
from simulator.truth.orbit import CircularOrbit, compute_lvlh_attitude
from simulator.truth.sun import DAY, compute_julian_date, compute_sun_vector, is_eclipsed

ORBIT = CircularOrbit(350e3, np.deg2rad(35.0), node=np.deg2rad(20.0))
T = np.arange(0, ORBIT.period, 4.0)
SUN = compute_sun_vector(compute_julian_date("1998-01-15T06:00:00") + T / DAY)
AHEAD = compute_lvlh_attitude(ORBIT, T)
# The −Y side to the Sun: else −x forward.
A = np.diag([-1.0, -1.0, 1.0]) @ AHEAD if (AHEAD[0] @ SUN[0])[1] > 0 else AHEAD
SQUARE = build_trmm_sensors(heads=(np.zeros(3), np.zeros(3)))


def test_sun_rows_are_those_in_view_and_lit():
    position = compute_orbit_position(ORBIT, T)
    table = simulate_sun_table(np.random.default_rng(1), SQUARE, T, A, position, SUN)
    dark = is_eclipsed(position, SUN)
    body = np.einsum("nij,nj->ni", A, SUN)
    for number, sensor in enumerate(ground.trmm_sun_sensors(), start=1):
        inside = body @ sensor.alignment
        edge = np.tan(sensor.half_fov)
        seen = ~dark & (inside[:, 2] > 0) & (np.abs(inside[:, :2]) <= edge * inside[:, 2:]).all(axis=1)
        rows = table[table["sensor"] == number]
        np.testing.assert_array_equal(rows["t_s"], T[seen])
        assert 50 < len(rows) < 0.4 * len(T)
