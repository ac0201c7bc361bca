"""The remainder of a calibration: columns by finite differences, and sigmas that hold in simulations with and without one."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrocal import calibrate
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.remainder import (
    add_remainder,
    build_paths,
)
from gyrocal.calibration.remainder_processes import NOMINAL, WITH_REMAINDER, Process, Stretches, read_processes
from gyrocal.calibration.sampling import prepare_measurements
from gyrocal.estimation.remainder_noise import KnownCalibration, RemainderNoise, read_calibration
from tests.gyrocal.calibration.remainder_cases import TRUTH, simulate_remainder

RATE, REFERENCE = np.deg2rad(0.1), np.deg2rad(0.2)
SEEDS = range(6)
REMAINDERS = {"rate error": {"rate": RATE}, "correlated reference error": {"reference": REFERENCE}, "delay": {"delay_s": 0.01}}


@cache
def calibrate_with_remainder(kind):
    recordings = [simulate_remainder(seed, **REMAINDERS[kind]) for seed in SEEDS]
    return [add_remainder(recording, calibrate(recording)) for recording in recordings]


def build_problem(recording):
    """Paths at the truth, with the problem and the state there."""
    result = calibrate(recording)
    problem = Problem.build(recording, prepare_measurements(recording))
    return build_paths(recording, problem, replace(result, parameters=TRUTH)), problem, problem.state(TRUTH)


def test_rate_columns_are_the_derivative_of_the_residuals_by_an_error_of_one_stretch():
    recording = simulate_remainder(0)
    paths, _, state = build_problem(recording)  # residuals of the noise change the derivative by a thousandth
    gyro, step = recording.gyro, 1e-6
    for stretch in (3, 17):
        low, high = paths.stretches.from_s[stretch], paths.stretches.to_s[stretch]
        own = (gyro.t_s > low - 1e-6) & (gyro.t_s < high - 1e-6)
        for member in (10, 5):  # b_y and G_yz
            rates = gyro.rates.copy()
            along = np.eye(3)[1] if member == 10 else gyro.rates[own, 2:] * np.eye(3)[1]
            rates[own] += step * np.linalg.solve(TRUTH.G, np.broadcast_to(along, (own.sum(), 3)).T).T
            moved = replace(recording, gyro=replace(gyro, rates=rates))
            shifted = Problem.build(moved, prepare_measurements(moved)).state(TRUTH)
            columns = paths.compute_process_influence(Process("rate", (member,), 1.0), member, np.eye(state.theta.size)).T
            np.testing.assert_allclose(columns[:, stretch], (shifted.theta - state.theta).ravel() / step, atol=3e-3)


def test_reference_columns_are_the_derivative_of_the_residuals_by_an_error_of_one_reference():
    recording = simulate_remainder(1)
    paths, _, state = build_problem(recording)
    own, step = recording.attitudes, 1e-6
    for process, along in (("reference", np.tile(np.eye(3)[2], (own.t_s.size, 1))), ("delay", paths.body_rates)):
        columns = paths.compute_process_influence(Process(process, (2,), 1.0), 2, np.eye(state.theta.size)).T
        for place in (0, 5, 12):  # the first starts an interval, the last ends one and starts the next
            q = own.quaternions.copy()
            q[place] = (Rotation.from_quat(q[place]) * Rotation.from_rotvec(-step * along[place])).as_quat()
            moved = replace(recording, attitudes=replace(own, quaternions=q))
            shifted = Problem.build(moved, prepare_measurements(moved)).state(TRUTH)
            np.testing.assert_allclose(columns[:, place], (shifted.theta - state.theta).ravel() / step, atol=3e-3)


@pytest.mark.parametrize("time_scale", [0.3, 5.0, 1e7])
def test_covariance_of_means_is_the_integral_of_the_correlation(time_scale):
    stretches = Stretches(np.array([0.0, 1.0, 4.0]), np.array([1.0, 4.0, 4.5]), np.zeros(3, dtype=int))
    found = stretches.covariance(Process("rate", (9,), time_scale))
    fine = [np.linspace(a, b, 801) for a, b in zip(stretches.from_s, stretches.to_s, strict=True)]
    middles = [0.5 * (one[1:] + one[:-1]) for one in fine]
    expected = [[np.exp(-np.abs(np.subtract.outer(a, b)) / time_scale).mean() for b in middles] for a in middles]
    np.testing.assert_allclose(found, expected, rtol=2e-3)


def test_without_a_remainder_the_nominal_sigmas_stay():
    for seed in range(3):
        recording = simulate_remainder(100 + seed)
        result = add_remainder(recording, calibrate(recording))
        assert result.recommended == NOMINAL, result.remainder
        np.testing.assert_allclose(result.remainder.sigma, result.sigma, rtol=0.03)


@pytest.mark.parametrize("kind", REMAINDERS)
def test_errors_of_the_parameters_have_the_covariance_with_remainder(kind):
    nominal, widened = [], []
    for result in calibrate_with_remainder(kind):
        error = result.parameters.vector - TRUTH.vector
        nominal.append(error / result.sigma)
        widened.append(error / np.sqrt(np.diag(result.recommended_covariance)))
    # Twelve correlated errors a seed: about five independent ones, and sizes that are estimated.
    assert 0.65 < np.sqrt(np.mean(np.square(widened))) < 1.4
    assert np.sqrt(np.mean(np.square(nominal))) > 1.6


def test_remainder_has_the_size_and_the_side_of_the_simulation():
    results = [one.remainder for one in calibrate_with_remainder("rate error")]
    assert np.sqrt(np.mean([np.square(result.gyro) for result in results])) == pytest.approx(RATE, rel=0.3)
    assert np.sqrt(np.mean([np.square(one.reference) for one in results])) < 0.3 * REFERENCE
    delays = [one.remainder.delay_s for one in calibrate_with_remainder("delay")]
    assert np.sqrt(np.mean(np.square(delays))) == pytest.approx(0.01, rel=0.6)


def test_result_keeps_its_fields_and_gains_both_sigmas(tmp_path):
    recording = simulate_remainder(3, rate=RATE, reference=REFERENCE)
    plain = calibrate(recording)
    assert plain.to_json()["sigma_with_remainder"] is None
    result = add_remainder(recording, plain)
    document = result.to_json()
    np.testing.assert_array_equal(result.covariance, plain.covariance)
    assert document["recommended"] == WITH_REMAINDER
    assert read_processes(document["remainder"]) == result.remainder.processes
    path = tmp_path / "result.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    known, direct = read_calibration(path), KnownCalibration.build(result)
    np.testing.assert_allclose(known.covariance, direct.covariance, rtol=1e-9)
    assert known.noise == direct.noise
    nominal = KnownCalibration.build(plain)
    assert nominal.noise == RemainderNoise()
    np.testing.assert_array_equal(nominal.covariance, plain.covariance)
