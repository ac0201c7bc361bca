"""The attitude and bias filter and the smoother against least squares, the truth over many seeds, and a form by steps."""

import dataclasses

import numpy as np
import pytest

from gyrocal import GyroParameters, InputError, attitude
from gyrocal.estimation.batch import batch
from gyrocal.estimation.filter_run import run, smooth
from gyrocal.estimation.mekf import KalmanFilter
from gyrocal.sensors.series import SensorSeries
from studies.montecarlo.statistics import compute_nees
from tests.builders import TRUTH, mean_bounds, state_errors
from tests.gyrocal.estimation.filter_cases import FILTER_CASE_ARW, FILTER_CASE_SIGMA, Z, fly, simulate_direction_series

SIGMA = np.repeat([np.deg2rad(0.5), np.deg2rad(1e-3)], 3)
P0 = np.diag(SIGMA**2)
TIMES = np.array([600.0, 2200.0, 4000.0])


@pytest.fixture(scope="module")
def flight():
    return fly([(Z, 180.0, 1500.0, 800.0)], 4000.0)


def started(flight, rng, arw=FILTER_CASE_ARW, scale=1.0, **options):
    """A filter whose start is off by a draw from its covariance."""
    off = rng.standard_normal(6) * SIGMA * scale
    A = attitude.rotation_matrix(-off[:3]) @ flight.A[0]
    return KalmanFilter(A, GyroParameters(TRUTH.G, TRUTH.bias + off[3:]), P0 * scale**2, arw, **options)


def errors_of(flight, found):
    return state_errors(found.A, found.x, found.names, flight.get_attitudes(found.t), TRUTH)


def test_consistent_over_seeds_and_not_when_told_too_little_noise(flight):
    cases = 40
    results = {}
    for label, told in (("right", FILTER_CASE_ARW), ("understated", FILTER_CASE_ARW / 4)):
        values, innovations = [], []
        for seed in range(cases):
            rng = np.random.default_rng([11, seed])
            estimator = started(flight, rng, arw=told)
            found = run(estimator, flight.gyro(rng), [simulate_direction_series(flight, rng)], 0.0, TIMES)
            values.append(compute_nees(errors_of(flight, found), found.covariance))
            innovations.append(found.innovations.nis)
        results[label] = np.mean(values, axis=0), np.mean(innovations)
    low, high = mean_bounds(6, cases)
    assert (results["right"][0] > low).all()
    assert (results["right"][0] < high).all()
    low, high = mean_bounds(6, cases * 401)  # innovations are white
    assert low < results["right"][1] < high
    assert (results["understated"][0] > mean_bounds(6, cases)[1]).all()
    assert results["understated"][1] > high


def test_a_walking_bias_is_followed_by_a_filter_that_knows(flight):
    walk, cases = np.deg2rad(4e-6), 20
    values = {walk: [], 0.0: []}
    for seed in range(cases):
        for told in values:
            rng = np.random.default_rng([12, seed])
            estimator = started(flight, rng, rate_random_walk=told)
            # The walk within a sample adds (walk^2 dt^3 / 3) to the angle, a ten-thousandth of the white noise's.
            steps = walk * rng.standard_normal(flight.rates.shape)
            bias = TRUTH.bias + np.cumsum(steps, axis=0)
            found = run(estimator, flight.gyro(rng, bias=bias), [simulate_direction_series(flight, rng)], 0.0, TIMES[-1:])
            truth = GyroParameters(TRUTH.G, bias[-1])
            error = state_errors(found.A, found.x, found.names, flight.A[-1:], truth)
            values[told].append(compute_nees(error, found.covariance)[0])
    low, high = mean_bounds(6, cases)
    assert low < np.mean(values[walk]) < high
    assert np.mean(values[0.0]) > high


def test_gate_keeps_outliers_out(flight):
    rng = np.random.default_rng(13)
    gyro, series = flight.gyro(rng), simulate_direction_series(flight, rng)
    bad = rng.random(len(series.t)) < 0.05
    bad[:10] = False
    spoilt = dataclasses.replace(series, y=series.y + np.where(bad[:, None], 50 * FILTER_CASE_SIGMA, 0.0))
    gated = started(flight, np.random.default_rng(14), gate=1e-6)
    clean = started(flight, np.random.default_rng(14))
    found = run(gated, gyro, [spoilt], 0.0, TIMES)
    reference = run(clean, gyro, [dataclasses.replace(series, sigma=np.where(bad[:, None], np.inf, series.sigma))], 0.0, TIMES)
    assert bad.sum() == (~found.innovations.accepted).sum()
    np.testing.assert_array_equal(found.innovations.row[~found.innovations.accepted], np.flatnonzero(bad))
    np.testing.assert_allclose(found.x, reference.x, rtol=1e-12)


def test_run_is_the_step_by_step_form(flight):
    rng = np.random.default_rng(15)
    gyro, series = flight.gyro(rng), simulate_direction_series(flight, rng)
    found = run(started(flight, np.random.default_rng(1)), gyro, [series], 0.0, TIMES)
    alone = started(flight, np.random.default_rng(1))
    for k in range(len(gyro.t_s) + 1):
        if k % 10 == 0:
            alone.update(series.model, k // 10, series.y[k // 10], series.sigma[k // 10])
        if k < len(gyro.t_s):
            alone.step(gyro.rates[k], 1.0)
    np.testing.assert_allclose(found.A[-1], alone.A, atol=1e-14)
    np.testing.assert_allclose(found.x[-1], alone.x, rtol=1e-13)
    np.testing.assert_allclose(found.covariance[-1], alone.P, rtol=1e-9)
    np.testing.assert_allclose(alone.A @ alone.A.T, np.eye(3), atol=1e-15)


def test_numbers_with_infinite_sigma_do_not_act(flight):
    rng = np.random.default_rng(16)
    gyro, series = flight.gyro(rng), simulate_direction_series(flight, rng)
    sigma = series.sigma.copy()
    sigma[:, 3:] = np.inf
    sigma[100:200] = np.inf
    y = np.where(np.isfinite(sigma), series.y, np.nan)
    found = run(started(flight, np.random.default_rng(1)), gyro, [SensorSeries(series.model, series.t, y, sigma)], 0.0, TIMES)
    large = np.where(np.isfinite(sigma), sigma, 1e6)
    same = run(
        started(flight, np.random.default_rng(1)), gyro, [SensorSeries(series.model, series.t, series.y, large)], 0.0, TIMES
    )
    np.testing.assert_allclose(found.x, same.x, rtol=1e-9)
    assert (found.innovations.dof == 3).all()
    assert len(found.innovations.t) == len(series.t) - 100


def test_wrong_use(flight):
    gyro = flight.gyro()
    with pytest.raises(InputError, match="walks must be solved for"):
        KalmanFilter(np.eye(3), TRUTH, np.eye(5), FILTER_CASE_ARW, rate_random_walk=1e-9, names=("b_x", "b_y"))
    with pytest.raises(InputError, match="ascend"):
        run(started(flight, np.random.default_rng(0)), gyro, [], 0.0, np.array([5.0, 3.0]))
    late = dataclasses.replace(gyro, t_s=np.where(gyro.t_s > 1000, gyro.t_s + 30, gyro.t_s))
    with pytest.raises(InputError, match=r"no gyro samples between 1001.0 s and 1031.0 s"):
        run(started(flight, np.random.default_rng(0)), late, [], 0.0, np.array([2000.0]))
    run(started(flight, np.random.default_rng(0)), late, [], 0.0, np.array([2000.0]), max_gap_s=40.0)


def test_smoothed_attitudes_are_the_batch_ones_with_their_joint_covariance():
    flight, rng, times = fly([(Z, 90.0, 400.0, 500.0)], 1500.0), np.random.default_rng(0), np.array([100.0, 900.0, 1500.0])
    near, gyro, series = started(flight, rng), flight.gyro(rng), simulate_direction_series(flight, rng)
    estimator = KalmanFilter(near.A, GyroParameters(TRUTH.G, near.x[9:]), 1e-4 * np.eye(6), FILTER_CASE_ARW)
    smoothed = smooth(run(estimator, gyro, [series], 0.0, times, keep_history=True))
    whole = batch([series], gyro, near.A, epoch_s=0.0, times=times)
    sigma = np.sqrt(np.diag(whole.attitude_covariance))
    # The batch iterates, the filter linearises once a measurement; its wide prior tells 1e-6 of what the data do.
    apart = attitude.residual(whole.attitudes, smoothed.A).ravel()
    np.testing.assert_allclose(apart / sigma, 0.0, atol=2e-2)
    scale = np.outer(sigma, sigma)
    np.testing.assert_allclose(smoothed.attitude_covariance / scale, whole.attitude_covariance / scale, atol=2e-2)
    assert abs(whole.attitude_covariance[0, 3] / scale[0, 3]) > 5e-3
    np.testing.assert_allclose(smoothed.x[:, 9:], np.tile(whole.bias, (3, 1)), atol=1e-2 * np.sqrt(whole.covariance[3, 3]))
