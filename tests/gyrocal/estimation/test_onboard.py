"""The on-board form: against the ground batch and the recursion, its covariance over seeds, its memory."""

import numpy as np
import pytest

from gyrocal import (
    Attitudes,
    GyroParameters,
    InputError,
    Interval,
    Recording,
    attitude,
    calibrate,
)
from gyrocal.estimation.mekf import KalmanFilter
from gyrocal.estimation.onboard import OnBoardCalibrator, replay
from studies.montecarlo.statistics import compute_nees
from tests.builders import TRUTH, choose_case_numbers, mean_bounds
from tests.gyrocal.estimation.filter_cases import (
    DIRECTION_SENSOR_SIGMA,
    FILTER_CASE_ARW,
    FILTER_START_SIGMA,
    OPENINGS,
    SPANS,
    build_maneuver_timeline,
    compute_independent_covariance,
    fly,
    run_onboard_case,
    simulate_direction_series,
    solve_with_covariances,
)


def calibrated(seed, openings=None, **options):
    """A-priori parameters, calibrator, maneuvers and gyro stream of one case."""
    case = run_onboard_case(np.random.default_rng([21, seed]), openings, **options)
    return case.apriori, case.onboard, case.maneuvers, case.gyro


def build_ground_recording(maneuvers, spans, gyro):
    """The maneuvers as a recording for the ground, and their C (maneuvers, 3, 3)."""
    times, first = np.unique(np.array(spans, dtype=float).ravel(), return_index=True)  # maneuvers that touch share one
    A = np.array([A for maneuver in maneuvers for A in (maneuver.A_start, maneuver.A_end)])[first]
    sigma = np.array([np.sqrt(np.diag(P)) for one in maneuvers for P in (one.P_start, one.P_end)])[first]
    intervals = tuple(Interval(f"m{n + 1}", "maneuver", float(a), float(b)) for n, (a, b) in enumerate(spans))
    references = Attitudes(times, attitude.quaternion_from_matrix(A), sigma)
    return Recording("on board", "1998-01-01T00:00:00Z", gyro, references, intervals), np.array([one.C for one in maneuvers])


def batch_nees(apriori, maneuvers, covariances):
    """NEES of the parameters from these maneuvers with other C."""
    x, P = solve_with_covariances(apriori, maneuvers, covariances)
    return compute_nees((x - TRUTH.vector)[None], P[None])[0]


@pytest.mark.parametrize("prior", [False, True])
def test_same_as_the_ground_batch_from_the_same_references(prior):
    P0 = np.diag(np.repeat([1e-3, np.deg2rad(1e-4)], [9, 3]) ** 2) if prior else None
    _, onboard, maneuvers, gyro = calibrated(0, OPENINGS, through_filter=False, apriori_covariance=P0)
    recording, C = build_ground_recording(maneuvers, SPANS, gyro)
    ground = calibrate(recording, iterations=1, interval_covariance=C, apriori_covariance=P0)
    found, P = onboard.solve()
    assert np.abs((found.vector - ground.parameters.vector) / ground.sigma).max() < 1e-9
    np.testing.assert_allclose(P / ground.covariance, 1, atol=1e-6)


def outcome(cases, openings=None, **options):
    """NEES of the parameters and θᵀ C⁻¹ θ of the residuals' noise, each with C as it is and with C by independence."""
    solved, white = [], []
    for seed in range(cases):
        apriori, onboard, maneuvers, _ = calibrated(seed, openings, **options)
        found, P = onboard.solve()
        by_independence = [compute_independent_covariance(maneuver) for maneuver in maneuvers]
        own = compute_nees((found.vector - TRUTH.vector)[None], P[None])[0]
        solved.append((own, batch_nees(apriori, maneuvers, by_independence)))
        for one, C in zip(maneuvers, by_independence, strict=True):
            noise = one.residual - one.Theta @ (apriori.vector - TRUTH.vector)
            white.append((noise @ np.linalg.solve(one.C, noise), noise @ np.linalg.solve(C, noise)))
    return np.mean(solved, axis=0), np.mean(white, axis=0)


@pytest.mark.parametrize("cases", choose_case_numbers(6, 30))
@pytest.mark.parametrize("opened", [False, True])
def test_covariance_over_seeds(opened, cases):
    """Of a filter that runs through, and as N has it: opened after slews, the references forget the maneuver."""
    options = {"openings": OPENINGS, "through_filter": False} if opened else {}
    (own, naive), (white, white_naive) = outcome(cases, **options)
    low, high = mean_bounds(12, cases)
    assert low < own < high
    low, high = mean_bounds(3, cases * len(SPANS))
    assert low < white < high
    if not opened:
        # Independence counts the noise of the filter's time constant twice: too large, and the parameters look too good.
        assert white_naive < 0.75 * 3
        assert naive < 0.85 * own


def test_the_references_depend_on_the_parameters_as_stated():
    """θ = Θ Δx with S in Θ, by finite differences in G without noise; without S it does not hold."""
    flight = build_maneuver_timeline()
    gyro, series = flight.gyro(), simulate_direction_series(flight, sigma=DIRECTION_SENSOR_SIGMA)
    step = 1e-4 * np.random.default_rng(2).standard_normal((3, 3))

    def maneuvers(G_step, through):
        apriori = GyroParameters(TRUTH.G + G_step, TRUTH.bias)
        estimator = KalmanFilter(flight.A[0], apriori, np.diag(FILTER_START_SIGMA**2), FILTER_CASE_ARW)
        return replay(OnBoardCalibrator(estimator, apriori, through_filter=through), gyro, [series], 0.0, SPANS)

    change = np.concatenate([step.ravel(), np.zeros(3)])
    misses = {}
    for through in (True, False):
        misses[through] = [
            np.abs(up.residual - down.residual - (up.Theta + down.Theta) @ change).max() / np.abs(up.residual).max()
            for up, down in zip(maneuvers(step, through), maneuvers(-step, through), strict=True)
        ]
    assert np.max(misses[True]) < 1e-4
    assert np.median(misses[False]) > 0.1


def test_reference_errors_are_added_at_both_ends():
    sigma = np.deg2rad([0.01, 0.02, 0.03])
    plain, stated = (calibrated(1, reference_sigma=value)[2] for value in (None, sigma))
    for one, other in zip(plain, stated, strict=True):
        D = np.diag(sigma**2)
        np.testing.assert_allclose(other.C - one.C, D + one.R @ D @ one.R.T, atol=1e-18)


def test_wrong_use():
    flight = fly(length=100.0)
    gyro = flight.gyro()
    estimator = KalmanFilter(flight.A[0], TRUTH, np.diag(FILTER_START_SIGMA**2), FILTER_CASE_ARW)
    with pytest.raises(InputError, match="same G"):
        OnBoardCalibrator(estimator, GyroParameters(np.eye(3), TRUTH.bias))
    onboard = OnBoardCalibrator(estimator, TRUTH)
    with pytest.raises(InputError, match="started"):
        onboard.finish()
    for spans in ([], [(20.0, 10.0)], [(10.0, 30.0), (20.0, 40.0)]):
        with pytest.raises(InputError, match="maneuvers must"):
            replay(onboard, gyro, [], 0.0, spans)
