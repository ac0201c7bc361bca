import numpy as np
import pytest

from simulator.truth.maneuvers import (
    MODE_YAW,
    Hold,
    Profile,
    Slew,
    Sway,
    integrate_trajectory,
)
from simulator.truth.orbit import CircularOrbit, compute_lvlh_attitude
from simulator.truth.rotation import convert_to_quaternion, separation

ORBIT = CircularOrbit(350e3, np.deg2rad(35.0), node=0.3, latitude_argument=2.0)
RPO = ORBIT.mean_motion
Z = np.array([0.0, 0.0, 1.0])
SWAY = Sway(np.deg2rad([0.05, 0.1, 0.2]), np.array([110.0, 70.0, 190.0]), np.array([0.1, 1.2, 2.5]))


def finite_difference_rate(attitude, tau: np.ndarray, h: float) -> np.ndarray:
    A = [attitude(tau + k * h) for k in (-2, -1, 1, 2)]
    W = -((A[0] - 8 * A[1] + 8 * A[2] - A[3]) / (12 * h)) @ np.swapaxes(attitude(tau), -1, -2)
    return np.stack([W[:, 2, 1], W[:, 0, 2], W[:, 1, 0]], axis=-1)


@pytest.mark.parametrize(
    ("mode", "rate", "forward"),
    [
        ("+x", [0, -1, 0], [1, 0, 0]),
        ("-x", [0, 1, 0], [-1, 0, 0]),
        ("-y", [-1, 0, 0], [0, -1, 0]),
        ("+y", [1, 0, 0], [0, 1, 0]),
    ],
)
def test_modes(mode, rate, forward):
    """The named axis lies along the velocity, z to nadir, and the rate is that of the flight."""
    profile = Profile(ORBIT, 1000.0, 1600.0, MODE_YAW[mode])
    tau = np.array([0.0, 100.0])
    np.testing.assert_allclose(profile.rate(tau), np.tile(RPO * np.array(rate), (2, 1)), atol=1e-17)
    A_bl = profile.attitude(tau) @ np.swapaxes(compute_lvlh_attitude(ORBIT, 1000.0 + tau), -1, -2)
    np.testing.assert_allclose(A_bl[:, :, 0], np.tile(forward, (2, 1)), atol=1e-15)
    np.testing.assert_allclose(A_bl[:, :, 2], np.tile(Z, (2, 1)), atol=1e-15)


@pytest.mark.parametrize("ramp_fraction", [0.1, 0.3, 0.5])
def test_slew_profile(ramp_fraction):
    slew = Slew(Z, np.pi, 100.0, 400.0, ramp_fraction)
    tau = np.linspace(0.0, 600.0, 60_001)
    angles, rates = slew.angles(tau), slew.rates(tau)
    assert angles[0] == 0.0
    assert angles[-1] == pytest.approx(np.pi, rel=1e-15)
    assert rates.max() == pytest.approx(np.pi / (400.0 * (1 - ramp_fraction)), rel=1e-12)
    h = tau[1] - tau[0]
    np.testing.assert_allclose((angles[2:] - angles[:-2]) / (2 * h), rates[1:-1], atol=1e-9)
    # A jump of the rate or of its derivative would show as a second difference of the order of the value, not of h².
    acceleration = np.diff(rates) / h
    assert np.abs(np.diff(rates)).max() < 2e-3 * rates.max()
    assert np.abs(np.diff(acceleration)).max() < 2e-3 * np.abs(acceleration).max()
    assert not rates[(tau <= 100) | (tau >= 500)].any()


@pytest.mark.parametrize("sway", [None, SWAY])
def test_rate_is_the_derivative_of_the_closed_form(sway):
    """Two slews about different oblique axes, with and without control motion, on a regressing orbit."""
    orbit = CircularOrbit(350e3, 0.6, 0.3, 2.0, j2=True)
    slews = (Slew(np.array([0.6, 0.0, 0.8]), 1.5, 50.0, 300.0, 0.3), Slew(np.array([0.0, -0.8, 0.6]), -0.7, 400.0, 150.0, 0.5))
    profile = Profile(orbit, 5000.0, 5600.0, MODE_YAW["-x"], slews, sway=sway)
    tau = np.arange(3.0, 600.0, 7.3)
    h = 0.05
    tau = tau[np.abs(tau[:, None] - profile.knots).min(axis=1) > 2 * h]
    np.testing.assert_allclose(profile.rate(tau), finite_difference_rate(profile.attitude, tau, h), rtol=0, atol=3e-13 / h)


HOLDS = [
    Hold(150.0, 5400.0, 300.0, np.zeros(3)),
    Hold(150.0, 5400.0, 300.0, np.deg2rad([40.0, 0.0, 0.0])),
    Hold(0.0, 2700.0, 400.0, np.deg2rad([-15.0, 5.0, 60.0])),
    Hold(200.0, 2000.0, 250.0, np.zeros(3)),
]


@pytest.mark.parametrize("hold", HOLDS)
def test_inertial_hold(hold):
    """The rate vanishes inside; the attitude is that of the mode before, at the stop and after."""
    profile = Profile(ORBIT, 0.0, hold.stop + 100.0, MODE_YAW["-x"], hold=hold)
    tau = np.arange(0.0, profile.stop_s + 0.25, 0.5)
    path = integrate_trajectory(profile, tau)
    held = (tau >= hold.start + hold.transition) & (tau <= hold.stop - hold.transition)
    assert not profile.rate(tau[held]).any()
    rest = path.quaternions[held]
    assert np.abs(separation(rest[:1], rest)).max() < 1e-14
    tracking = (tau <= hold.start) | (tau >= hold.stop)
    gap = separation(path.quaternions[tracking], convert_to_quaternion(profile.attitude(tau[tracking])))
    assert np.abs(gap).max() < 1e-11
    assert (tau[tracking] > hold.stop).any()
