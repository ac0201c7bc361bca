"""Batch reference attitudes: right without noise, covered with it, and refused where nothing determines them."""

import numpy as np
import pytest

from gyrocal import InputError, UnobservableError
from gyrocal.attitude import residual, rotation_matrix
from gyrocal.estimation.arc import Estimate, build_gyro_arc, choose_columns, linearise, list_measured_times
from gyrocal.estimation.batch import batch
from gyrocal.sensors.series import SensorSeries
from simulator.streams import generator
from tests.builders import choose_case_numbers, is_mean_of_chi2, squared_error
from tests.gyrocal.estimation.attitude_cases import ATTITUDE_CASE_ORBIT, TRUE_BIAS, build_orbit_flight, make_direction_sensor
from tests.gyrocal.estimation.flights import compute_nadir

SUN = np.array([np.cos(0.4), np.sin(0.4) * np.cos(0.41), np.sin(0.4) * np.sin(0.41)])
SIGMA = 1e-3
TIMES = np.array([0.0, 1000.0, 2746.0, 5488.0])
EPOCH = 1000.0
TURN = rotation_matrix(np.array([0.05, -0.03, 0.02]))


@pytest.fixture(scope="module")
def motion():
    return build_orbit_flight()


def sensors(motion, rng=None, low=0.0, high=5490.0, every_s=30.0):
    """A Sun sensor that sees it for part of the orbit, and one that sees the direction to the Earth."""
    t = np.arange(low, high, every_s)
    visible = np.abs((motion.get_attitudes(t) @ SUN)[:, 0]) > 0.6
    sun = make_direction_sensor("sun", np.tile(SUN, (t.size, 1))).simulate_series(motion, t, SIGMA, rng)
    seen = np.where(visible[:, None], sun.y, np.nan), np.where(visible[:, None], sun.sigma, np.inf)
    earth = make_direction_sensor("earth", compute_nadir(t, ATTITUDE_CASE_ORBIT)).simulate_series(motion, t, SIGMA, rng)
    return [SensorSeries(sun.model, t, *seen), earth]


@pytest.mark.parametrize("weighting", ["exact", "plain"])
def test_noise_free_attitudes_are_those_flown_also_beyond_the_measurements(motion, weighting):
    series = sensors(motion, low=300.0, high=4500.0)
    found = batch(series, motion.gyro(), TURN @ motion.get_attitudes(EPOCH), epoch_s=EPOCH, times=TIMES, weighting=weighting)
    np.testing.assert_allclose(found.bias, TRUE_BIAS, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found.attitude, motion.get_attitudes(EPOCH), rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.attitudes, motion.get_attitudes(TIMES), rtol=0, atol=1e-11)
    assert found.chi2 < 1e-12
    assert found.dof == sum(one.used.sum() for one in series) - 6
    assert (np.diff(found.attitude_sigma[1:], axis=0)[-1] > 0).all()  # extrapolated by 988 s


def test_rows_are_the_derivatives_of_the_residuals(motion):
    series = sensors(motion, every_s=200.0)
    solved = choose_columns(series, {"sun": ("m_x", "m_z"), "earth": ("m_y",)})
    path = build_gyro_arc(motion.gyro(), list_measured_times(series), np.eye(3))
    estimate = Estimate(
        np.tile(TURN @ motion.get_attitudes(0.0), (len(path.t), 1, 1)), 1.5 * TRUE_BIAS, tuple(one.model for one in series)
    )
    state = linearise(path, series, estimate, solved)
    for k, size in enumerate([1e-6] * 3 + [1e-10] * 3 + [1e-6] * 3):
        step = np.zeros(9)
        step[k] = size
        ends = []
        for sign in (1, -1):
            C = rotation_matrix(sign * step[:3]) @ estimate.C
            models = solved.correct_models(estimate.models, sign * step[6:])
            ends.append(linearise(path, series, Estimate(C, estimate.bias + sign * step[3:6], models), solved).rows.z)
        slope = (ends[1] - ends[0]) / (2 * size)  # z = measured − predicted
        np.testing.assert_allclose(state.rows.plain[:, k], slope, rtol=0, atol=1e-7 * np.abs(slope).max() + 1e-6)


@pytest.mark.parametrize("cases", choose_case_numbers(30, 200))
def test_errors_are_covered_one_by_one_and_together_but_not_by_the_formal_covariance(motion, cases):
    """NEES of epoch attitude and bias, of four attitudes together, and χ², for each way of treating the gyro noise."""
    out = {"exact": [], "plain": []}
    formal = []
    for case in range(cases):
        rng = generator(51, case, "batch")
        gyro, series = motion.gyro(rng), sensors(motion, rng)
        for way, rows in out.items():
            found = batch(series, gyro, motion.get_attitudes(EPOCH), epoch_s=EPOCH, times=TIMES, weighting=way)
            error = np.concatenate([residual(motion.get_attitudes(EPOCH), found.attitude), TRUE_BIAS - found.bias])
            many = residual(motion.get_attitudes(TIMES), found.attitudes).ravel()
            together = squared_error(many, found.attitude_covariance)
            rows.append((squared_error(error, found.covariance), together, found.chi2))
            if way == "plain":
                formal.append(squared_error(error, found.errors.measurements[:6, :6]))
    for way, rows in out.items():
        alone, together, chi2 = np.array(rows).T
        assert is_mean_of_chi2(alone, 6)
        assert is_mean_of_chi2(together, 12)
        if way == "exact":
            assert is_mean_of_chi2(chi2, found.dof)
    assert np.mean(formal) > 2.5 * 6


def test_one_sun_direction_leaves_the_rotation_about_it(motion):
    series = sensors(motion)
    with pytest.raises(UnobservableError) as caught:
        batch(series[:1], motion.gyro(), motion.get_attitudes(0.0))
    assert len(caught.value.combinations) == 1
    axis = np.array([float(x) for x in caught.value.combinations[0].partition("(")[2].rstrip(")").split(",")])
    np.testing.assert_allclose(np.abs(axis @ SUN), 1, atol=1e-3)


def test_what_cannot_be_used_is_refused_in_one_line(motion):
    gyro, series = motion.gyro(), sensors(motion)
    start = motion.get_attitudes(0.0)
    for match, arguments, options in (
        ("none to be used", ([], gyro, start), {}),
        ("no gyro samples between", (series, gyro, start), {"times": [6000.0]}),
        ("did not converge", (series, gyro, start), {"max_iterations": 1}),
        ("no measurements of sensor 'moon'", (series, gyro, start), {"free": {"moon": ("m_x",)}}),
    ):
        with pytest.raises(InputError, match=match):
            batch(*arguments, **options)
