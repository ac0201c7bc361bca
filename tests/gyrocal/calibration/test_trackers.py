"""References of several sensors: their covariance, their mountings, and whether they agree."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

import gyrocal
import simulator
from gyrocal import AttitudeSensor, InputError, UnobservableError
from gyrocal.attitude import rotation_matrix
from gyrocal.calibration.covariance import compute_residual_covariance, integrate_white_noise
from gyrocal.calibration.trackers import Mountings, compare_sensors
from simulator.simulate import compute_true_gyros, motion, observe
from simulator.streams import generator
from tests.tracker_cases import AGILE, ESTIMATED, TETRAHEDRON, TURNED_DEG, truth


def observed(scenario, truth, case):
    return observe(
        scenario, truth, gyro_rng=generator(3, case, "gyro_noise"), reference_rng=generator(3, case, "reference_noise")
    )


def test_covariance_is_that_of_the_errors_of_each_reference():
    """Against E diag(N) Eᵀ of the matrix E of ones and −R, with references that are shared in every way."""
    rng = np.random.default_rng(0)
    R = rotation_matrix(rng.normal(size=(5, 3)))
    arc, start, row = np.array([0, 0, 0, 1, 1]), np.array([0, 0, 0, 3, 3]), np.array([1, 2, 3, 4, 5])
    walk = integrate_white_noise(np.array([10.0, 20.0, 30.0, 5.0, 15.0]), 1e-5)
    noise = np.array([1e-9 * part @ part.T for part in rng.normal(size=(6, 3, 3))])
    E = np.zeros((5, 3, 6, 3))
    E[np.arange(5), :, row] += np.eye(3)
    E[np.arange(5), :, start] -= R
    expected = np.einsum("aiuj,ujk,bluk->aibl", E, noise, E)
    expected += np.einsum(
        "aij,abjk,blk->aibl", R, walk[np.minimum.outer(range(5), range(5))] * (arc[:, None] == arc)[..., None, None], R
    )
    found = compute_residual_covariance(R, arc, start, row, noise, walk)
    np.testing.assert_allclose(found, expected.reshape(15, 15), rtol=1e-12, atol=1e-22)


def test_one_named_sensor_is_calibrated_as_one_without_a_name():
    recording = simulator.simulate(AGILE, seed=2)
    alone = gyrocal.of_sensor(recording, "st1")
    sigma = np.deg2rad([1e-3, 2e-3, 3e-3])
    alone = replace(alone, attitudes=replace(alone.attitudes, sigma=np.tile(sigma, (alone.attitudes.t_s.size, 1))))
    rows = np.zeros(alone.attitudes.t_s.size, dtype=np.intp)
    named = replace(alone, attitudes=replace(alone.attitudes, sensor=rows, sensors=(AttitudeSensor("st1"),)))
    one, other = gyrocal.calibrate(alone), gyrocal.calibrate(named)
    assert np.abs((one.parameters.vector - other.parameters.vector) / one.sigma).max() < 1e-6
    assert np.allclose(one.covariance, other.covariance, rtol=1e-6, atol=0)
    assert other.chi2 == pytest.approx(one.chi2, rel=1e-8)


def test_without_noise_gyro_and_mounting_are_found_as_they_are():
    scenario = simulator.override(ESTIMATED, {"gyro.sample_s": 0.5})
    found = gyrocal.calibrate(simulator.simulate(scenario, noise=False))
    assert np.abs((found.parameters.vector - truth(scenario)) / found.sigma).max() < 0.05
    assert np.rad2deg(found.mountings.misalignment) == pytest.approx(TURNED_DEG, abs=1e-6)
    assert found.converged


def test_taking_mountings_out_is_the_joint_solution():
    rng = np.random.default_rng(4)
    recording = simulator.simulate(ESTIMATED, noise=False)
    mountings = replace(Mountings.build(recording.attitudes), prior=np.array([0.3, np.inf, 0.1]))
    H, Hm, z = rng.normal(size=(40, 4)), rng.normal(size=(40, 3)), rng.normal(size=40)
    free = mountings.eliminate(H, z, Hm)
    P = np.linalg.inv(free.H.T @ free.H)
    change = P @ free.H.T @ free.z
    rows = np.diag([1 / 0.3, 0.0, 1 / 0.1])
    whole = np.vstack([np.hstack([H, Hm]), np.hstack([np.zeros((3, 4)), rows])])
    joint = np.linalg.lstsq(whole, np.append(z, np.zeros(3)), rcond=None)[0]
    C = np.linalg.inv(whole.T @ whole)
    assert np.allclose(np.append(change, free.step(change)), joint)
    assert np.allclose(P, C[:4, :4])
    assert np.allclose(free.covariance(P), C[4:, 4:])


@pytest.mark.parametrize("kind", ["mounting free", "mounting with a prior", "four gyros"])
def test_errors_are_as_large_as_stated(kind):
    cases, prior = 12, np.array([2e-4, 5e-4, 2e-4])
    scenario = ESTIMATED
    if kind == "mounting with a prior":
        scenario = simulator.override(ESTIMATED, {"reference.tracker.1.mounting_sigma_deg": prior.tolist()})
    if kind == "four gyros":
        scenario = simulator.override(ESTIMATED, {"gyro.array": TETRAHEDRON})
    flown = motion(scenario)
    nees, of_mounting, agree = [], [], []
    for case in range(cases):
        turned = np.array(TURNED_DEG)
        if kind == "mounting with a prior":
            turned = prior * generator(3, case, "mounting").standard_normal(3)
        here = simulator.override(scenario, {"reference.tracker.1.misalignment_deg": turned.tolist()})
        recording = observed(here, flown, case)
        if kind == "four gyros":
            found = gyrocal.calibrate_gyros(recording)
            error = found.gyros.vector - np.column_stack(compute_true_gyros(here)).ravel()
        else:
            found = gyrocal.calibrate(recording)
            error = found.parameters.vector - truth(here)
        nees.append(error @ np.linalg.solve(found.covariance, error))
        off = found.mountings.misalignment - np.deg2rad(turned)
        of_mounting.append(off @ np.linalg.solve(found.mountings.covariance, off))
        agree.append(found.differences[0].p_value)
    for values, size in ((nees, error.size), (of_mounting, 3)):
        assert 1e-3 < scipy.stats.chi2.cdf(sum(values), cases * size) < 1 - 1e-3
    assert scipy.stats.kstest(agree, "uniform").pvalue > 1e-3


def test_a_tracker_that_is_turned_does_not_agree_with_the_other():
    plain, turned = (
        simulator.override(AGILE, {"reference.tracker.1.misalignment_deg": [size, 0.0, 0.0]}) for size in (0.0, 2e-3)
    )
    assert compare_sensors(simulator.simulate(plain, seed=5))[0].p_value > 1e-3
    found = gyrocal.calibrate(simulator.simulate(turned, seed=5))
    assert found.differences[0].p_value < 1e-6
    assert found.to_json()["tracker_differences"][0]["sensors"] == ["st1", "st2"]


def test_trackers_a_little_apart_in_time_are_compared_by_the_rate_in_between():
    recording = simulator.simulate(simulator.override(AGILE, {"gyro.sample_s": 0.5}), noise=False)
    late = simulator.simulate(simulator.override(AGILE, {"gyro.sample_s": 0.5}), noise=False)
    one, own = recording.attitudes, recording.attitudes.sensor == 1
    turn = rotation_matrix(-0.2 * _rates(recording, one.t_s))  # A(t + 0.2 s)
    A = gyrocal.attitude.matrix_from_quaternion(one.quaternions)
    moved = gyrocal.attitude.quaternion_from_matrix(np.where(own[:, None, None], turn @ A, A))
    inner = own & (one.t_s < 1700.0)
    attitudes = replace(one, t_s=one.t_s + 0.2 * inner, quaternions=np.where(inner[:, None], moved, one.quaternions))
    apart = compare_sensors(replace(late, attitudes=attitudes))[0].apart
    assert np.abs(apart).max() < 1e-6
    assert np.linalg.norm(0.2 * _rates(recording, one.t_s[inner]), axis=1).max() > 1e-4


def _rates(recording, t_s):
    """True rates at some times: in the first interval, of constant rate, those of the sample."""
    gyro = recording.gyro
    row = np.clip(np.searchsorted(gyro.t_s, t_s, side="right") - 1, 0, None)
    return gyro.rates[row] @ np.array(AGILE.gyro.true_G).T + np.deg2rad(AGILE.gyro.true_bias_deg_s)


def test_a_mounting_that_the_data_leave_free_is_said():
    recording = simulator.simulate(ESTIMATED, noise=False)
    first = recording.attitudes.sensor == 0
    bare = gyrocal.recording.trackers.keep_rows(recording.attitudes, first)
    with pytest.raises(UnobservableError, match="mounting of st2"):
        gyrocal.calibrate(replace(recording, attitudes=bare))


def test_other_covariances_are_for_one_sensor():
    recording = simulator.simulate(AGILE, noise=False)
    with pytest.raises(InputError, match="several sensors"):
        gyrocal.calibrate(recording, covariance_model="references only")


def test_references_that_would_count_twice_are_refused_and_the_remedy_works():
    """Both trackers end an interval and begin the next one: their difference there is in both, and no covariance has a root."""
    recording = simulator.simulate(AGILE, seed=2)
    whole, *others = recording.intervals
    times = np.unique(recording.attitudes.t_s)
    cut_s, after_s = (float(one) for one in times[times > whole.start_s][4:6])
    first, second = replace(whole, stop_s=cut_s), replace(whole, name="second", start_s=cut_s)
    with pytest.raises(gyrocal.InputError, match="let each interval begin a reference after the one before ends"):
        gyrocal.calibrate(replace(recording, intervals=(first, second, *others)))
    assert gyrocal.calibrate(replace(recording, intervals=(first, replace(second, start_s=after_s), *others))).converged
