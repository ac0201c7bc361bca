"""The commanded frame, the estimate against it, and the yaw that a sun sensor gives."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulator.mission_mode.onboard_attitude import compute_sun_azimuth, propagate_error, wrap_angle
from simulator.mission_mode.target_frame import compute_commanded_attitude
from simulator.sensors.horizon import compute_orbit_position
from simulator.sensors.sun import build_trmm_sensors, compute_counts, compute_head_tangents
from simulator.truth.orbit import CircularOrbit, compute_lvlh_attitude
from tests.simulator.sensors.nadir import geodetic_nadir

ORBIT = CircularOrbit(350e3, np.deg2rad(35.0), node=0.7, latitude_argument=0.3, j2=True)
T = np.linspace(0.0, ORBIT.period, 200)


def turn(vector):
    """exp(−[v×])."""
    return Rotation.from_rotvec(-np.asarray(vector)).as_matrix()


def test_z_is_the_geodetic_nadir():
    frame = compute_commanded_attitude(ORBIT, T)
    assert np.abs(frame[:, 2] - geodetic_nadir(compute_orbit_position(ORBIT, T))).max() < 1e-9
    assert np.abs(frame @ np.swapaxes(frame, 1, 2) - np.eye(3)).max() < 1e-14
    assert np.abs(frame[:, 2] - compute_lvlh_attitude(ORBIT, T)[:, 2]).max() > 1e-3  # negative control: geocentric is elsewhere


def test_propagated_error_is_that_of_matrices():
    """Frame and body turn by small steps of their own; ε is exp(−[ε×]) = A Cᵀ, to first order in ε."""
    rng = np.random.default_rng(2)
    C, error = np.eye(3), np.array([2e-4, -1e-4, 3e-4])
    A = turn(error)
    for _ in range(2000):
        moved = np.array([0.0, -5.7e-4, 1e-3])
        turned = moved + 1e-7 * rng.normal(size=3)
        C, A = turn(moved) @ C, turn(turned) @ A
        propagate_error(error, turned, moved)
    exact = Rotation.from_matrix(A @ C.T).inv().as_rotvec()
    assert error == pytest.approx(exact, abs=3e-7)
    assert np.abs(exact - [2e-4, -1e-4, 3e-4]).max() > 1e-4  # it has moved


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("yaw", [0.0, 0.01])
def test_azimuth_of_the_sun(number, yaw):
    """Counts of a head without misalignment give the Sun's azimuth back, smaller by the body's yaw."""
    sensor = build_trmm_sensors(heads=(np.zeros(3), np.zeros(3)))[number]
    side = 1.0 if number == 0 else -1.0
    expected = np.array([side * np.cos(0.5), -np.sin(0.5), 0.0])
    s = sensor.alignment.T @ turn([0.0, 0.0, yaw]) @ expected
    counts = compute_counts(*compute_head_tangents(*s, sensor.head), sensor.coefficients_alpha, sensor.coefficients_beta)
    seen = compute_sun_azimuth(*counts, sensor.coefficients_alpha, sensor.coefficients_beta, sensor.alignment)
    assert wrap_angle(np.arctan2(expected[1], expected[0]) - seen) == pytest.approx(yaw, abs=1e-9)
