"""The compiled filter steps against integrals, the calibration's own matrices, and the textbook's information form."""

import numpy as np
import pytest
from scipy.integrate import quad_vec

from gyrocal import psi_matrix
from gyrocal.attitude import cross_matrix, rotation_matrix
from gyrocal.calibration.propagation import compute_psi_coefficients
from gyrocal.estimation.error_state import (
    COVARIANCE_SERIES_LIMIT,
    compute_kalman_gain,
    compute_process_noise,
    compute_step_integrals,
    compute_transition,
    propagate_covariance,
    update_covariance,
)
from tests.builders import TRUTH

RAW = np.array([0.02, -0.3, 0.11])
ALL = np.arange(12)


def a_covariance(n, seed=0):
    L = np.random.default_rng(seed).normal(size=(n, n))
    return L @ L.T


@pytest.mark.parametrize(
    "phi", [0.0, 1e-4, 0.3, 0.999999 * COVARIANCE_SERIES_LIMIT, 1.000001 * COVARIANCE_SERIES_LIMIT, 2.0, 7.0]
)
def test_integrals_of_a_step(phi):
    c, d, e, f = compute_step_integrals(phi)
    np.testing.assert_allclose((c, d), compute_psi_coefficients(np.array(phi)), rtol=1e-14)
    axis = np.array([0.6, 0.0, 0.8])
    K = cross_matrix(phi * axis)
    psi = lambda s: psi_matrix(phi * axis, np.array(s))  # noqa: E731
    for closed, function in (
        (np.eye(3) / 3 + e * K @ K, lambda s: psi(s) @ psi(s).T),
        (np.eye(3) / 2 - d * K + f * K @ K, psi),
    ):
        np.testing.assert_allclose(closed, quad_vec(function, 0, 1, epsabs=1e-14)[0], atol=1e-13)


@pytest.mark.parametrize("dt", [0.5, 10.0])
def test_transition_is_that_of_the_calibration(dt):
    R, B = np.empty((3, 3)), np.empty((3, 12))
    angle = compute_transition(TRUTH.vector, RAW, dt, ALL, R, B)
    omega = TRUTH.G @ RAW + TRUTH.bias
    np.testing.assert_allclose(angle, omega * dt, rtol=1e-15)
    np.testing.assert_allclose(R, rotation_matrix(-omega * dt), atol=1e-15)
    np.testing.assert_allclose(
        B, psi_matrix(omega, dt) @ np.hstack([np.kron(np.eye(3), RAW), np.eye(3)]), rtol=1e-13, atol=1e-15
    )


def test_noise_of_long_steps_is_that_of_many_short_ones():
    arw, walk, dt, parts = 1e-3, 1e-4, 8.0, 64
    x = TRUTH.vector
    biases = ALL[9:]
    R, B = np.empty((3, 3)), np.empty((3, 3))
    whole, pieces = a_covariance(6), a_covariance(6)
    angle = compute_transition(x, RAW, dt, biases, R, B)
    propagate_covariance(whole, R, B, *compute_process_noise(angle, dt, arw, walk))
    for _ in range(parts):
        angle = compute_transition(x, RAW, dt / parts, biases, R, B)
        propagate_covariance(pieces, R, B, *compute_process_noise(angle, dt / parts, arw, walk))
    np.testing.assert_allclose(whole, pieces, rtol=1e-12)


def test_propagated_covariance_by_dense_matrices():
    R, B = np.empty((3, 3)), np.empty((3, 12))
    angle = compute_transition(TRUTH.vector, RAW, 4.0, ALL, R, B)
    Q, cross, variance = compute_process_noise(angle, 4.0, 1e-2, 3e-2)
    P = a_covariance(15)
    Phi = np.block([[R, B], [np.zeros((12, 3)), np.eye(12)]])
    noise = np.zeros((15, 15))
    noise[:3, :3], noise[:3, 12:], noise[12:, :3], noise[12:, 12:] = Q, cross, cross.T, variance * np.eye(3)
    dense = Phi @ P @ Phi.T + noise
    propagate_covariance(P, R, B, Q, cross, variance)
    np.testing.assert_allclose(P, dense, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(P, P.T)


def test_correction_is_the_information_form():
    P, H = a_covariance(7), np.random.default_rng(1).normal(size=(2, 3))
    sigma, z = np.array([0.3, 0.7]), np.array([0.4, -1.0])
    wide = np.hstack([H, np.zeros((2, 4))])
    K, S, nis = compute_kalman_gain(P, H, sigma, z)
    after = P.copy()
    update_covariance(after, K, H, sigma)
    weight = np.diag(1 / sigma**2)
    information = np.linalg.inv(np.linalg.inv(P) + wide.T @ weight @ wide)
    np.testing.assert_allclose(after, information, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(K, information @ wide.T @ weight, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(nis, z @ np.linalg.solve(S, z), rtol=1e-12)
    # Joseph's form holds for another gain too: that of errors s - K (H s + noise).
    other = 0.5 * K
    after = P.copy()
    update_covariance(after, other, H, sigma)
    left = np.eye(7) - other @ wide
    np.testing.assert_allclose(after, left @ P @ left.T + other @ np.diag(sigma**2) @ other.T, rtol=1e-12)
