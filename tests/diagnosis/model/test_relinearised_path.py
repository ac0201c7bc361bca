"""The path of large attitude errors, against the integral of the error along the true attitude."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from diagnosis.model.relinearised_path import find_relinearised_path

STEP_S, COUNT, EACH = 0.05, 6000, 60


@pytest.fixture(scope="module")
def flown():
    """Aᵀ along the true and the propagated path, both at every step, and the error of the rates."""
    t = (np.arange(COUNT) + 0.5) * STEP_S
    true = np.column_stack([0.02 * np.sin(0.01 * t), 0.03 * np.cos(0.013 * t), 0.01 + 0 * t])
    error = np.column_stack([2e-3 * np.sin(0.02 * t) + 5e-4, 1.5e-3 * (t > 100), -1e-3 * np.cos(0.005 * t)])

    def path(rates):
        turns = [Rotation.identity()]
        for rate in rates:
            turns.append(turns[-1] * Rotation.from_rotvec(rate * STEP_S))
        return Rotation.concatenate(turns)

    return path(true), path(true - error), true, error


def test_path_gives_the_integral_where_the_first_order_does_not(flown):
    true, propagated, rates, error = flown
    ends = np.arange(0, COUNT + 1, EACH)
    zeta = (true[ends] * propagated[ends].inv()).as_rotvec()
    middle = (true[:-1] * Rotation.from_rotvec(0.5 * rates * STEP_S)).as_matrix()
    integral = np.cumsum(np.einsum("nij,nj->ni", middle, error) * STEP_S, axis=0)
    exact = np.vstack([np.zeros(3), integral])[ends]
    path = find_relinearised_path(zeta, np.full(zeta.shape, 1e-4))
    assert np.rad2deg(np.abs(zeta).max()) > 10
    assert np.abs(zeta - exact).max() > 100 * np.abs(path.errors - exact).max()
    assert np.abs(path.errors - exact).max() < 2e-4
    begun = (propagated[:-1] * Rotation.from_rotvec(0.5 * (rates - error) * STEP_S)).as_matrix()
    assert np.abs(path.interpolate_turns(ends) @ begun - middle).max() < 2e-3
    assert path.turn_attitudes(propagated[ends].as_matrix()) == pytest.approx(true[ends].as_matrix(), abs=1e-12)
    small = np.random.default_rng(1).normal(0, 1e-4, (50, 3))
    assert find_relinearised_path(small, np.full((50, 3), 1e-4)) is None
