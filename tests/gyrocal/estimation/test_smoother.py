"""The smoother against the batch of all measurements, and against the truth over many seeds."""

import numpy as np

from gyrocal import GyroParameters, attitude
from gyrocal.estimation.batch import batch
from gyrocal.estimation.filter_run import run
from gyrocal.estimation.mekf import KalmanFilter
from gyrocal.estimation.smoother import smooth
from tests.builders import TRUTH
from tests.gyrocal.estimation.filter_cases import FILTER_CASE_ARW, Z, fly, simulate_direction_series

SIGMA = np.repeat([np.deg2rad(0.5), np.deg2rad(1e-3)], 3)
TIMES = np.array([100.0, 900.0, 1500.0])


def filtered(flight, rng, sigma=SIGMA, times=TIMES):
    off = rng.standard_normal(6) * SIGMA
    A = attitude.rotation_matrix(-off[:3]) @ flight.A[0]
    start = GyroParameters(TRUTH.G, TRUTH.bias + off[3:])
    gyro, series = flight.gyro(rng, start), simulate_direction_series(flight, rng)
    estimator = KalmanFilter(A, start, np.diag(sigma**2), FILTER_CASE_ARW)
    return run(estimator, gyro, [series], 0.0, times, keep_history=True), gyro, series, A


def test_smoothed_attitudes_are_the_batch_ones_with_their_joint_covariance():
    flight = fly([(Z, 90.0, 400.0, 500.0)], 1500.0)
    found, gyro, series, A = filtered(flight, np.random.default_rng(0), sigma=np.repeat([1e-2, 1e-2], 3))
    smoothed = smooth(found)
    whole = batch([series], gyro, A, epoch_s=0.0, times=TIMES)
    sigma = np.sqrt(np.diag(whole.attitude_covariance))
    # The batch iterates, the filter linearises once a measurement; its wide prior tells 1e-6 of what the data do.
    apart = attitude.residual(whole.attitudes, smoothed.A).ravel()
    np.testing.assert_allclose(apart / sigma, 0.0, atol=2e-2)
    scale = np.outer(sigma, sigma)
    np.testing.assert_allclose(smoothed.attitude_covariance / scale, whole.attitude_covariance / scale, atol=2e-2)
    assert abs(whole.attitude_covariance[0, 3] / scale[0, 3]) > 5e-3
    np.testing.assert_allclose(smoothed.x[:, 9:], np.tile(whole.bias, (3, 1)), atol=1e-2 * np.sqrt(whole.covariance[3, 3]))
