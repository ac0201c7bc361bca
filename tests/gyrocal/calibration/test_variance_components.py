"""Sizes of noise components: recovered in simulations, with the likelihood of a dense covariance."""

import numpy as np
import pytest

from gyrocal.calibration.variance_components import estimate_variance_components, evaluate_likelihood, list_lower_places

ROWS, PARAMETERS = 120, 5
TIME = np.arange(ROWS, dtype=float)


def build_process(time_scale):
    """Columns of an Ornstein-Uhlenbeck process of unit variance, whose covariance is their product."""
    return np.linalg.cholesky(np.exp(-np.abs(np.subtract.outer(TIME, TIME)) / time_scale))


def build_case(seed, variances, noise=1.0):
    """Projected residuals, projected components and the projector (N, N), with an orthonormal basis (N, d) of its range."""
    rng = np.random.default_rng(seed)
    H = rng.normal(size=(ROWS, PARAMETERS))
    components = [build_process(20.0), np.repeat(np.eye(12), 10, axis=0), rng.normal(size=(ROWS, 20))]
    y = np.sqrt(noise) * rng.normal(size=ROWS) + H @ rng.normal(size=PARAMETERS) * 10
    for part, variance in zip(components, variances, strict=True):
        y = y + np.sqrt(variance) * part @ rng.normal(size=part.shape[1])
    basis = np.linalg.qr(H, mode="complete")[0][:, PARAMETERS:]
    projector = basis @ basis.T
    return projector @ y, [projector @ part for part in components], basis


def test_likelihood_is_that_of_the_dense_covariance_with_its_gradient():
    y, parts, basis = build_case(1, (2.0, 1.0, 0.5))
    lower = list_lower_places(ROWS)
    kernels = np.array([(part @ part.T).ravel()[lower] for part in parts])

    def evaluate_densely(noise, theta):
        C = basis.T @ (noise * np.eye(ROWS) + sum(t * part @ part.T for t, part in zip(theta, parts, strict=True))) @ basis
        r = basis.T @ y
        return 0.5 * (np.linalg.slogdet(C)[1] + r @ np.linalg.solve(C, r))

    x = np.log([1.3, 0.7, 2.1, 0.2])
    value, slope = evaluate_likelihood(np.exp(x[0]), np.exp(x[1:]), kernels, y, ROWS - PARAMETERS, lower)
    assert value == pytest.approx(evaluate_densely(np.exp(x[0]), np.exp(x[1:])), rel=1e-10)
    for k in range(x.size):
        ahead, behind = x + 1e-5 * np.eye(x.size)[k], x - 1e-5 * np.eye(x.size)[k]
        difference = (
            evaluate_densely(np.exp(ahead[0]), np.exp(ahead[1:])) - evaluate_densely(np.exp(behind[0]), np.exp(behind[1:]))
        ) / 2e-5
        assert slope[k] == pytest.approx(difference, rel=1e-5, abs=1e-5)


def test_sizes_of_simulated_components_are_recovered():
    truth, noise, cases = np.array([4.0, 2.0, 0.3]), 1.5, 40
    found = [estimate_variance_components(*build_case(seed, truth, noise)[:2], ROWS - PARAMETERS) for seed in range(cases)]
    sizes = np.array([[one.noise, *one.variances] for one in found])
    error = sizes.mean(axis=0) - [noise, *truth]
    assert (np.abs(error) < 4 * sizes.std(axis=0) / np.sqrt(cases)).all(), sizes.mean(axis=0)
    assert np.mean([one.log_likelihood_gain for one in found]) > 30
