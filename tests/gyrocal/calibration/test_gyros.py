"""Each of several gyros: recovery, agreement with the calibration of three, parity, noise, and consistent sigmas."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import simulator
from gyrocal import GyroArray, InputError, UnobservableError, calibrate, calibrate_gyros
from gyrocal.attitude import cross_matrix, rotation_matrix
from gyrocal.calibration.gyros import (
    LARGEST_TURN,
    build_prior_covariance,
    compute_gain_jacobian,
    compute_parity_sums,
    integrate_noise_walk,
)
from gyrocal.recording.gyros import compute_gyro_gain, compute_nominal_gyros
from gyrocal.recording.parts import build_empty_attitudes
from tests.builders import RPO, choose_case_numbers, mean_bounds, piecewise_recording
from tests.gyro_arrays import SKEWED, TETRAHEDRON, array_recording

ARW = 5e-6
SWITCHED = [None, ("1", "2", "3", "4"), ("1", "2", "4", "5"), None, ("3", "4", "5"), None]
CASES = [(TETRAHEDRON, None), (SKEWED, None), (SKEWED, SWITCHED)]


def truth_of(recording, K, c):
    return GyroArray(recording.gyro.names, K, c)


def with_noise_stated(recording, arw=1e-9):
    return replace(recording, gyro=replace(recording.gyro, arw=arw))


@pytest.mark.parametrize(("axes", "gyros"), CASES)
def test_every_gyro_is_recovered_without_noise(axes, gyros):
    recording, K, c = array_recording(axes, gyros=gyros, series_s=60.0)
    result = calibrate_gyros(with_noise_stated(recording), iterations=4)
    np.testing.assert_allclose(result.gyros.K, K, atol=2e-9)
    np.testing.assert_allclose(result.gyros.c, c, atol=2e-12)
    np.testing.assert_allclose(result.G @ K, np.eye(3), atol=5e-9)
    assert np.abs(result.residuals.filter(like="after").to_numpy()).max() < 1e-6
    assert np.abs(result.residuals.filter(like="before").to_numpy()).max() > 0.05


def test_three_gyros_are_those_of_the_calibration_of_three():
    plain = piecewise_recording(series_s=60.0, arw=1e-9, rng=np.random.default_rng(1))
    gyro = plain.gyro
    named = replace(plain, gyro=replace(gyro, names=("1", "2", "3")))
    expected, found = calibrate(plain, iterations=3), calibrate_gyros(named, iterations=3)
    np.testing.assert_allclose(found.G, expected.G, atol=1e-10)
    np.testing.assert_allclose(found.bias, expected.bias, atol=1e-13)
    np.testing.assert_allclose(np.sqrt(np.diag(found.gain_covariance)), expected.sigma, rtol=1e-6)
    assert found.dof == expected.dof
    assert found.chi2 == pytest.approx(expected.chi2, rel=1e-6)
    assert np.isnan(found.parity_p_value)


def test_parity_sums_say_what_all_samples_say():
    recording, K, c = array_recording(SKEWED, ARW, np.random.default_rng(2))
    (sums,) = compute_parity_sums(recording)
    gyros = GyroArray(recording.gyro.names, np.array(SKEWED), np.zeros(5))
    V, seen, X, square = sums.moments(gyros)
    inside = np.ones(recording.gyro.t_s.size, dtype=bool)
    raw, dt = recording.gyro.rates[inside], recording.gyro.sample_s
    w = np.column_stack([raw @ compute_gyro_gain(SKEWED, np.arange(5)).T, np.ones(len(raw))])
    e = raw @ V
    np.testing.assert_allclose(seen, w.T @ w * dt, rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(X, e.T @ w * dt, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(square, e.T @ e * dt, rtol=1e-9)
    # What its normal equations say of Vᵀ(K − K₀, c) is right within its own sigmas.
    H, z = sums.rows(gyros, ARW)
    error = H @ np.column_stack([SKEWED - K, -c]).ravel() - z  # whitened: eight standard normal numbers
    assert 1.3 < error @ error < 26
    assert np.linalg.matrix_rank(H) == 8


def test_accumulated_noise_by_hand():
    w, dt, n = 0.01, 0.5, 200
    T = n * dt
    N = np.diag([4.0, 1.0, 2.0])
    found = integrate_noise_walk(np.tile([0.0, 0.0, w], (n, 1)), np.full(n, dt), np.array([n // 2, n]), N)[1]
    # Rz(φ) N Rz(φ)ᵀ = 2.5 (I − zz) + 1.5 (cos 2φ, sin 2φ; sin 2φ, −cos 2φ) + 2 zz, integrated; steps hold their middle's.
    even, odd = np.sin(2 * w * T) / (2 * w), (1 - np.cos(2 * w * T)) / (2 * w)
    exact = np.diag([2.5 * T, 2.5 * T, 2 * T]) + 1.5 * np.array([[even, odd, 0], [odd, -even, 0], [0, 0, 0]])
    np.testing.assert_allclose(found, exact, atol=1.5 * T * (2 * LARGEST_TURN) ** 2 / 24)
    one, other = (expm(share * dt * cross_matrix(np.array([0.3, -0.2, 0.1]))) for share in (0.5, 1.5))
    two = integrate_noise_walk(np.tile([0.3, -0.2, 0.1], (2, 1)), np.full(2, dt), np.array([2]), N)[0]
    np.testing.assert_allclose(two, dt * (one @ N @ one.T + other @ N @ other.T), rtol=1e-12)


def test_jacobian_of_G_and_b_by_differences():
    recording, K, c = array_recording(SKEWED)
    gyros = truth_of(recording, K, c + 1e-3)
    J, h = compute_gain_jacobian(gyros), 1e-6
    for k in range(20):
        step = np.zeros(20)
        step[k] = h
        one, other = gyros.at(gyros.vector + step), gyros.at(gyros.vector - step)
        change = np.concatenate([(one.G - other.G).ravel(), one.bias - other.bias]) / (2 * h)
        np.testing.assert_allclose(J[:, k], change, atol=1e-9)


def squared_errors(axes, gyros, cases, stated=1.0):
    """NEES of some seeds, with the stated gyro noise off by a factor."""
    out = []
    for seed in range(cases):
        rng = np.random.default_rng([seed, 9])
        recording, K, c = array_recording(axes, ARW, rng, gyros, sample_s=4.0, series_s=300.0)
        result = calibrate_gyros(with_noise_stated(recording, stated * ARW), iterations=2)
        error = result.gyros.vector - truth_of(recording, K, c).vector
        out.append(error @ np.linalg.solve(result.covariance, error))
    return float(np.mean(out))


@pytest.mark.parametrize(("axes", "gyros"), [(TETRAHEDRON, None), (SKEWED, SWITCHED)])
@pytest.mark.parametrize("cases", choose_case_numbers(25, 60))
def test_sigmas_are_consistent(axes, gyros, cases):
    low, high = mean_bounds(4 * len(axes), cases)
    assert low < squared_errors(axes, gyros, cases) < high


def test_sigmas_from_too_little_noise_are_found_out():
    assert squared_errors(TETRAHEDRON, None, cases=10, stated=0.7) > mean_bounds(16, 10)[1]


def test_parity_of_a_gyro_alone_is_seen_in_chi2():
    recording, *_ = array_recording(TETRAHEDRON, ARW, np.random.default_rng(5), series_s=60.0)
    good = calibrate_gyros(recording)
    assert 0.001 < good.parity_p_value < 0.999
    rates = recording.gyro.rates.copy()
    rates[len(rates) // 2 :, 3] += 1e-5
    assert calibrate_gyros(replace(recording, gyro=replace(recording.gyro, rates=rates))).parity_p_value < 1e-6


def test_what_cannot_be_found_is_named_and_a_prior_helps():
    still = ((((0.0, -RPO, 0.0), 3000.0),),)
    recording, *_ = array_recording(TETRAHEDRON, ARW, np.random.default_rng(6), plan=still, series_s=60.0)
    of_ranges = calibrate_gyros(recording)
    assert of_ranges.prior_from == "plausible ranges"
    assert "K_1x" in " ".join(of_ranges.observability.unobservable)
    assert of_ranges.to_json()["plausible_ranges"]["grade"] == "space"
    with pytest.raises(UnobservableError, match=r"none of 16 parameter .* space grade.*a-priori sigma"):
        calibrate_gyros(recording, plausible_G=1e-9, plausible_bias=1e-14)
    result = calibrate_gyros(recording, prior_sigma=(1e-3, 1e-5))
    assert result.observability.unobservable
    assert result.converged
    spread = np.sqrt(np.diag(result.covariance))
    assert (spread <= np.tile([1e-3, 1e-3, 1e-3, 1e-5], 4) * (1 + 1e-9)).all()


def test_what_is_missing_is_said():
    recording, *_ = array_recording(TETRAHEDRON)
    with pytest.raises(InputError, match="no gyro noise"):
        calibrate_gyros(recording)
    alone = replace(with_noise_stated(recording), attitudes=build_empty_attitudes())
    with pytest.raises(InputError, match="no reference attitudes"):
        calibrate_gyros(alone)


def test_what_is_known_of_all_gyros_together_is_a_prior():
    recording = simulator.simulate(simulator.override(simulator.load("trmm_tetrahedron"), {"gyro.sample_s": 4.0}), seed=1)
    K, _ = compute_nominal_gyros(recording.gyro)
    plain = np.tile([1e-3, 1e-3, 1e-3, 1e-6], 4)
    by_sigma = calibrate_gyros(recording, prior_sigma=(1e-3, 1e-6))
    by_covariance = calibrate_gyros(recording, prior_covariance=np.diag(plain**2))
    np.testing.assert_allclose(by_covariance.gyros.vector, by_sigma.gyros.vector, rtol=1e-10)
    np.testing.assert_allclose(by_covariance.covariance, by_sigma.covariance, rtol=1e-6)
    assert by_covariance.chi2 == pytest.approx(by_sigma.chi2, rel=1e-9)
    # A turn of all gyros and a common scale factor are as wide as is said, and nothing else is.
    P = build_prior_covariance(K, 1e-9, 1e-12, 0.1, 0.01)
    turned = np.column_stack([K @ rotation_matrix(np.array([0.0, 0.0, 1e-6])).T - K, np.zeros(4)]).ravel() / 1e-6
    np.testing.assert_allclose(P @ turned / (0.1**2 * (turned @ turned)), turned, atol=2e-4)
    assert np.linalg.matrix_rank(P, tol=1e-9) == 4
    for given, words in (
        ({"prior_sigma": (1e-3, 1e-6), "prior_covariance": P}, "not both"),
        ({"prior_covariance": -np.eye(16)}, "not a positive definite matrix of 16 rows"),
    ):
        with pytest.raises(InputError, match=words):
            calibrate_gyros(recording, **given)
