"""The residual covariance against hand-worked cases, and its root against that of the whole matrix."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrocal import attitude
from gyrocal.calibration.covariance import (
    FULL,
    GIVEN,
    REFERENCES_ONLY,
    compute_residual_covariance,
    find_chains,
    integrate_white_noise,
    model_covariance,
    whiten_chain,
)
from gyrocal.calibration.normal_equations import whiten


def test_one_residual_by_hand():
    R = Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()
    noise = np.array([np.diag([1.0, 4.0, 9.0]), np.diag([0.01, 0.04, 0.09])])
    args = (R[None], np.array([0]), np.array([0]), np.array([1]), noise, integrate_white_noise(np.array([100.0]), 0.5))
    given = np.diag([1.0, 2.0, 3.0])[None]
    # A quarter turn about z swaps the start's x and y.
    for model, expected in ((REFERENCES_ONLY, [4.01, 1.04, 9.09]), (FULL, [29.01, 26.04, 34.09]), (GIVEN, [1.0, 2.0, 3.0])):
        np.testing.assert_allclose(model_covariance(*args, model, given), np.diag(expected), atol=1e-13)


@pytest.mark.parametrize(("turn", "chained"), [("touching", True), ("apart", False), ("overlapping", False)])
def test_a_chain_is_whitened_by_the_root_of_its_whole_covariance(turn, chained):
    rng = np.random.default_rng(2)
    second = {"touching": 3, "apart": 4, "overlapping": 2}[turn]
    interval, start = np.repeat([0, 1], [3, 4]), np.repeat([0, second], [3, 4])
    row = np.concatenate([[1, 2, 3], second + np.arange(1, 5)])
    R = attitude.rotation_matrix(rng.normal(size=(7, 3)))
    walk = integrate_white_noise(np.array([1.0, 3.0, 4.0, 2.0, 3.0, 7.0, 9.0]), 0.5)
    noise = np.array([part @ part.T for part in rng.normal(size=(9, 3, 3))])
    values = rng.normal(size=(21, 4))
    order, out, variance = np.arange(7), np.empty((21, 4)), np.empty((7, 3))
    assert find_chains(order, np.array([7]), interval, start, row) == [chained]
    V = compute_residual_covariance(R, interval, start, row, noise, walk)
    whiten_chain(order, values, R, (interval, start, row, noise), walk, out, variance)
    expected = np.empty_like(values)
    for rows in [slice(0, 21)] if turn != "apart" else [slice(0, 9), slice(9, 21)]:  # two chains
        expected[rows] = whiten(V[rows, rows].copy(), values[rows])
    assert np.allclose(out, expected, rtol=1e-10, atol=1e-12) == (turn != "overlapping")
    assert np.allclose(variance.ravel(), np.diag(V), rtol=1e-10)
