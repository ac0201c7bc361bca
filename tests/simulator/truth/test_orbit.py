"""Orbit and frame of geodetic nadir: against the papers, the frame on board the Mission Mode, and differences."""

import numpy as np
import pytest

from gyrocal import calibrate
from simulator import scenario as scenarios
from simulator import simulate
from simulator.mission_mode.target_frame import compute_commanded_attitude
from simulator.simulate import motion
from simulator.truth.nadir import compute_pointing_attitude, compute_pointing_rate
from simulator.truth.orbit import CircularOrbit, compute_lvlh_attitude, compute_lvlh_rate

PLAIN = CircularOrbit(350e3, np.deg2rad(35.0), node=0.4, latitude_argument=1.1)
REGRESSING = CircularOrbit(350e3, np.deg2rad(35.0), node=0.4, latitude_argument=1.1, j2=True)
TIMES = np.linspace(0.0, 2 * PLAIN.period, 41)


def finite_difference_rate(orbit: CircularOrbit, t: np.ndarray, h: float) -> np.ndarray:
    """From [w x] = -A' A^T with a fourth-order central difference."""
    A = [compute_lvlh_attitude(orbit, t + k * h) for k in (-2, -1, 1, 2)]
    derivative = (A[0] - 8 * A[1] + 8 * A[2] - A[3]) / (12 * h)
    W = -derivative @ np.swapaxes(compute_lvlh_attitude(orbit, t), -1, -2)
    return np.stack([W[:, 2, 1], W[:, 0, 2], W[:, 1, 0]], axis=-1)


def test_trmm_orbit_is_the_papers():
    assert PLAIN.period / 60 == pytest.approx(91.5, abs=0.05)
    assert np.rad2deg(PLAIN.mean_motion) == pytest.approx(0.0656, abs=1e-4)


@pytest.mark.parametrize("orbit", [PLAIN, REGRESSING])
def test_rate_is_the_derivative_of_the_attitude(orbit):
    # h = 20 s: truncation n (n h)^4 / 30 = 1e-11, rounding 1e-16 / h.
    np.testing.assert_allclose(compute_lvlh_rate(orbit, TIMES), finite_difference_rate(orbit, TIMES, 20.0), rtol=0, atol=2e-11)


def test_nodal_regression():
    """A 350 km, 35 deg orbit regresses by 6.8 deg a day; every part of it is seen in the rate."""
    assert PLAIN.nodal_rate == 0.0
    assert np.rad2deg(REGRESSING.nodal_rate) * 86400 == pytest.approx(-6.77, abs=0.02)
    assert np.abs(compute_lvlh_rate(REGRESSING, TIMES) - compute_lvlh_rate(PLAIN, TIMES)).max(axis=0).min() > 5e-7


ORBITS = [
    CircularOrbit(350e3, np.deg2rad(35.0), node=0.4, latitude_argument=1.0, j2=j2, geodetic=True) for j2 in (False, True)
] + [CircularOrbit(700e3, np.deg2rad(98.0), geodetic=True), CircularOrbit(500e3, 0.0, geodetic=True)]
T = np.linspace(0.0, 6000.0, 61)


@pytest.mark.parametrize("orbit", ORBITS)
def test_frame_is_that_of_the_ellipsoids_normal(orbit):
    # The frame on board iterates for the latitude three times, which leaves 1e-9 rad.
    np.testing.assert_allclose(compute_pointing_attitude(orbit, T), compute_commanded_attitude(orbit, T), rtol=0, atol=3e-9)


@pytest.mark.parametrize("orbit", ORBITS)
def test_rate_of_the_nadir_is_the_derivative_of_its_attitude(orbit):
    h = 0.5
    A = {k: compute_pointing_attitude(orbit, T + k * h) for k in (-2, -1, 1, 2)}
    # dA/dt = −[ω×] A; fourth-order differences.
    derivative = (8 * (A[1] - A[-1]) - (A[2] - A[-2])) / (12 * h)
    cross = -derivative @ np.swapaxes(compute_pointing_attitude(orbit, T), -1, -2)
    omega = np.stack([cross[:, 2, 1], cross[:, 0, 2], cross[:, 1, 0]], axis=1)
    np.testing.assert_allclose(compute_pointing_rate(orbit, T), omega, rtol=0, atol=2e-14)


def test_a_scenario_points_to_geodetic_nadir():
    """Figure 3's ω_x, zero in LVLH; simulated attitudes follow the rates, so that a calibration recovers what was put in."""
    trmm = scenarios.load("trmm")
    plain, true = (scenarios.override(trmm, {"orbit.nadir": nadir, "orbit.j2": True}) for nadir in ("geocentric", "geodetic"))
    geocentric, geodetic = (np.rad2deg(path.rates[path.intervals[0]]) for path in (motion(plain), motion(true)))
    assert np.abs(geodetic - geocentric)[:, 0].max() > 1.5e-4
    result = calibrate(simulate(true, noise=False))
    np.testing.assert_allclose(result.G, true.gyro.true_G, rtol=0, atol=1e-6)
