"""The filter of all twelve: the Davenport solution where both hold, and what it does with sensors that do not fit."""

from dataclasses import dataclass

import numpy as np
import pytest

from gyrocal import attitude, calibrate
from gyrocal.estimation.full_filter import Leg, build_starting_covariance, compute_change_chi2, run_legs
from gyrocal.estimation.mekf import KalmanFilter
from gyrocal.sensors.series import SensorSeries
from studies.montecarlo.statistics import compute_nees
from tests.builders import TRUTH, choose_case_numbers, mean_bounds, piecewise_recording
from tests.gyrocal.estimation.filter_cases import (
    FILTER_CASE_ARW,
    build_apriori_covariance,
    draw_apriori_parameters,
    run_full_and_separate,
)


@dataclass(frozen=True)
class AttitudeModel:
    """Compares the attitude with measured ones A_obs (n, 3, 3); the measurement to go with it is zero."""

    A_obs: np.ndarray
    name: str = "attitudes"
    size: int = 3
    parameters: tuple[str, ...] = ()

    def predict(self, A, rows):
        return attitude.residual(A, self.A_obs[rows])

    def jacobian(self, A, rows):
        return np.tile(np.eye(3), (len(A), 1, 1))

    def partials(self, A, rows):
        return np.zeros((len(A), 3, 0))

    def corrected(self, change):
        return self


def error_nees(x, P):
    return compute_nees((x - TRUTH.vector)[None], P[None])[0]


def ends_only(sigma_G, sigma_b):
    """The same recording by the filter, which meets an attitude at each end of the maneuvers, and by the calibration."""
    rng = np.random.default_rng([31, 0])
    apriori = draw_apriori_parameters(rng, sigma_G, sigma_b)
    recording = piecewise_recording(rng=rng, arw=FILTER_CASE_ARW, apriori=apriori)
    A = attitude.matrix_from_quaternion(recording.attitudes.quaternions)
    series = SensorSeries(AttitudeModel(A), recording.attitudes.t_s, np.zeros((len(A), 3)), recording.attitudes.sigma)
    legs = [Leg(one.name, one.start_s, one.stop_s, A[2 * k]) for k, one in enumerate(recording.intervals)]
    P0 = build_apriori_covariance(sigma_G, sigma_b)
    estimator = KalmanFilter(A[0], apriori, build_starting_covariance(1.0, P0), FILTER_CASE_ARW, names="all")
    full = run_legs(estimator, recording.gyro, [series], legs, restart_sigma=1.0)
    return full, calibrate(recording, apriori_covariance=P0)


def test_equals_the_calibration_where_both_linearise():
    full, ground = ends_only(1e-6, 1e-9)
    assert np.abs((full.parameters.vector - ground.parameters.vector) / ground.sigma).max() < 1e-6
    scale = np.outer(ground.sigma, ground.sigma)
    # The attitude before the first measurement of an interval is known to 1 rad against 1e-4.
    np.testing.assert_allclose(full.covariance / scale, ground.covariance / scale, atol=1e-6)


@pytest.mark.parametrize("cases", choose_case_numbers(4, 25))
def test_right_model(cases):
    """Consistent, and better than the separate scheme: it also uses what the sensors see within a maneuver."""
    rows = []
    for seed in range(cases):
        full, (separate, P) = run_full_and_separate(np.random.default_rng([32, seed]))
        total = sum(run.innovations.dof.sum() for run in full.runs)
        dof = sum(change.dof for change in full.changes)
        rows.append(
            (
                error_nees(full.parameters.vector, full.covariance),
                error_nees(separate.vector, P),
                sum(one.innovations.nis.sum() for one in full.runs) / total,
                sum(one.chi2 for one in full.changes) / dof,
                np.square(full.parameters.G - TRUTH.G).mean(),
                np.square(separate.G - TRUTH.G).mean(),
            )
        )
    nees, separate_nees, nis, changes, full_G, separate_G = np.mean(rows, axis=0)
    low, high = mean_bounds(12, cases)
    assert low < nees < high
    assert low < separate_nees < high
    assert abs(nis - 1) < 4 * np.sqrt(2 / (cases * 1420 * 6))
    assert abs(changes - 1) < 4 * np.sqrt(2 / (cases * dof))
    assert full_G < separate_G


def test_change_of_an_estimate_by_hand():
    before, after = np.diag([4.0, 9.0, 1.0]), np.diag([1.0, 9.0, 0.5])
    chi2, dof = compute_change_chi2(np.array([3.0, 0.1, 1.0]), before, after)
    assert dof == 2  # nothing has been told about the second
    np.testing.assert_allclose(chi2, 9.0 / 3.0 + 1.0 / 0.5)
    # Whatever the basis: the same in mixed parameters.
    T = np.random.default_rng(0).normal(size=(3, 3))
    mixed = compute_change_chi2(T @ [3.0, 0.1, 1.0], T @ before @ T.T, T @ after @ T.T)
    np.testing.assert_allclose(mixed, (chi2, dof))
