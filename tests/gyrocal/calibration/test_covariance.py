"""The residual covariance against Monte Carlo of its definition and against hand-worked cases."""

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
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.propagation import propagate
from gyrocal.calibration.sampling import prepare_measurements
from tests.builders import RPO, TRUTH, piecewise_recording

# Two touching intervals with a turn, then a separate one; several references in each.
PLAN = ((((0.0, -RPO, 0.0), 200.0), ((0.0, 0.0, np.deg2rad(0.4)), 200.0)), (((RPO, 0.0, 0.0), 200.0),))


def test_one_residual_by_hand():
    R = Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()
    noise = np.array([np.diag([1.0, 4.0, 9.0]), np.diag([0.01, 0.04, 0.09])])
    args = (R[None], np.array([0]), np.array([0]), np.array([1]), noise, integrate_white_noise(np.array([100.0]), 0.5))
    given = np.diag([1.0, 2.0, 3.0])[None]
    # A quarter turn about z swaps the start's x and y.
    for model, expected in ((REFERENCES_ONLY, [4.01, 1.04, 9.09]), (FULL, [29.01, 26.04, 34.09]), (GIVEN, [1.0, 2.0, 3.0])):
        np.testing.assert_allclose(model_covariance(*args, model, given), np.diag(expected), atol=1e-13)


@pytest.mark.parametrize("gap_s", [0.0, 50.0])
def test_full_covariance_is_that_of_simulated_residuals(gap_s):
    arw, cases = np.deg2rad(4e-4), 1500
    rng = np.random.default_rng(5)
    plain = piecewise_recording(PLAN, sample_s=5.0, series_s=100.0, arw=arw, gap_s=gap_s, apriori=TRUTH)
    prepared = prepare_measurements(plain)
    problem = Problem.build(plain, prepared)
    R = propagate(prepared.arcs, TRUTH.G, TRUTH.bias).R
    groups = np.split(problem.groups[0], problem.groups[1][:-1])
    assert len(groups) == (1 if gap_s == 0 else 2)
    # The motion is the same in every case: only the noises of the samples and of the references are drawn anew.
    A, sigma, draws = attitude.matrix_from_quaternion(plain.attitudes.quaternions), plain.attitudes.sigma, []
    for _ in range(cases):
        rates = plain.gyro.rates + rng.normal(size=plain.gyro.rates.shape) * arw / np.sqrt(5.0)
        seen = Rotation.from_rotvec(rng.normal(size=sigma.shape) * sigma).as_matrix() @ A
        draws.append(problem.replace_case(rates, seen).state(TRUTH).theta)
    draws = np.array(draws)
    for rows in groups:
        V = problem.covariance(R[rows], rows)
        sample = draws[:, rows].reshape(cases, -1)
        white = np.linalg.solve(np.linalg.cholesky(V), sample.T)
        # Elements of a whitened covariance scatter by 1/sqrt(cases), its diagonal by sqrt(2/cases); 5 sigma.
        np.testing.assert_allclose(white @ white.T / cases, np.eye(len(V)), atol=5 * np.sqrt(2 / cases))
        correlation = np.corrcoef(sample.T)[0, 3]  # two references of one interval share their start
        assert correlation > 0.3


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
