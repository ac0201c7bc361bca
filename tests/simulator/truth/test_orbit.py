import numpy as np
import pytest

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
