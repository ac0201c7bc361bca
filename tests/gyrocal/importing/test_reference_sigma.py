"""Sigma of references by axis: the likelihood against its dense form, what the gyro hides, and errors that are not white."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrocal.importing import reference_sigma
from gyrocal.importing.reference_sigma import Turns, fit_reference_sigma

ARW = 1e-4  # rad/sqrt(s)


def draw_turns(rng, count, sigma, arw=ARW, elapsed_s=1.0):
    """Turns in a row with white errors of the references and of the gyro, and the errors of twelve parameters and a time."""
    R = Rotation.from_rotvec(0.2 * rng.normal(size=(count, 3))).as_matrix()
    e = rng.normal(size=(count + 1, 3)) * sigma
    columns = rng.normal(size=(count, 3, 13))
    miss = e[1:] - np.einsum("nij,nj->ni", R, e[:-1]) + arw * np.sqrt(elapsed_s) * rng.normal(size=(count, 3))
    follows = np.arange(count) % 50 > 0
    return Turns(miss + columns @ np.full(13, 1e-3), columns, R, np.full(count, elapsed_s), np.zeros(count), follows)


def compute_dense_deviance(turns, squares, g):
    """−2 ln L of the restricted likelihood by whole matrices, but for a constant."""
    n = len(turns.miss)
    V = np.zeros((n, 3, n, 3))
    for k in range(n):
        V[k, :, k] = g * turns.noise_s[k] * np.eye(3) + np.diag(squares) + turns.R[k] * squares @ turns.R[k].T
        if turns.follows[k]:
            V[k, :, k - 1] = turns.R[k] * (g * turns.shared_s[k] - squares)
            V[k - 1, :, k] = V[k, :, k - 1].T
    V, X = V.reshape(3 * n, 3 * n), turns.columns.reshape(3 * n, -1)
    kernel = np.linalg.svd(X)[0][:, X.shape[1] :]
    S, y = kernel.T @ V @ kernel, kernel.T @ turns.miss.ravel()
    return np.linalg.slogdet(S)[1] + y @ np.linalg.solve(S, y)


def test_the_banded_likelihood_is_that_of_what_the_parameters_leave():
    turns = replace(draw_turns(np.random.default_rng(1), 60, 1e-3), shared_s=np.full(60, 0.1))
    deviance = reference_sigma._build_deviance(turns, 1.0, 0.0, np.inf)
    points = [(np.array([1e-6, 4e-6, 9e-8]), 1e-8), (np.array([5e-7, 1e-7, 1e-6]), 1e-6)]
    ours, dense = (np.array([one(*point) for point in points]) for one in (
        lambda squares, g: deviance(np.log([*squares, g])), lambda squares, g: compute_dense_deviance(turns, squares, g)
    ))  # fmt: skip
    assert ours[0] - ours[1] == pytest.approx(dense[0] - dense[1], rel=1e-6)


def test_errors_of_the_logarithms_have_their_stated_variance():
    rng, sigma = np.random.default_rng(7), ARW * np.array([1.0, 2.0, 8.0])
    found = [fit_reference_sigma(draw_turns(rng, 100, sigma), ARW, np.inf) for _ in range(20)]
    z = np.array([2 * np.log(one.sigma / sigma) / np.sqrt(one.variance) for one in found])
    assert (np.abs(np.mean(z, axis=0)) < 4 / np.sqrt(20)).all()
    assert 0.6 < np.mean(np.square(z)) < 1.6


def test_an_axis_below_the_gyros_noise_has_a_bound_and_the_others_keep_theirs():
    """About x and y the references are 20 times better than the gyro."""
    sigma = ARW * np.array([0.05, 0.05, 5.0])
    rng = np.random.default_rng(3)
    found = [fit_reference_sigma(draw_turns(rng, 100, sigma), ARW, np.inf) for _ in range(8)]
    assert np.mean([one.hidden for one in found], axis=0) == pytest.approx([1.0, 1.0, 0.0], abs=0.4)
    assert np.mean([one.sigma[2] for one in found]) == pytest.approx(sigma[2], rel=0.06)
    bounds = np.array([one.sigma[:2] for one in found])
    assert np.mean(bounds >= sigma[:2]) > 0.8
    assert (bounds < ARW).all()


def test_outliers_of_a_large_axis_are_left_out_and_its_tails_are_not():
    rng, sigma = np.random.default_rng(5), ARW * np.array([3.0, 3.0, 100.0])
    turns = draw_turns(rng, 500, sigma)
    turns.miss[::100, 0] += 0.1
    np.testing.assert_allclose(fit_reference_sigma(turns, ARW, np.inf).sigma, sigma, rtol=0.15)
