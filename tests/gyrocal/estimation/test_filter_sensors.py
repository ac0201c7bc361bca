"""Filter and on-board form with the Sun and Earth sensors of TRMM: counts and penetration angles in, estimates out."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gyrocal import GyroParameters, attitude
from gyrocal.estimation.filter_run import run
from gyrocal.estimation.mekf import KalmanFilter, compute_nees
from gyrocal.estimation.onboard import OnBoardCalibrator, replay
from gyrocal.sensors.earth import EarthModel, EarthSensor
from gyrocal.sensors.series import SensorSeries
from gyrocal.sensors.sun import trmm_sun_sensors
from simulator.sensors import earth as true_earth
from simulator.sensors import sun as true_sun
from simulator.sensors.horizon import compute_orbit_position
from simulator.truth.sun import DAY, compute_julian_date, compute_sun_vector, is_eclipsed
from tests.builders import TRUTH, choose_case_numbers, mean_bounds, state_errors
from tests.gyrocal.estimation.filter_cases import FILTER_CASE_ARW, FILTER_CASE_ORBIT, Z, draw_apriori_parameters, fly

EPOCH = "1997-12-13T09:45:00Z"
START = np.repeat([np.deg2rad(0.5), np.deg2rad(1e-3)], 3)
SPAN = (3000.0, 8000.0)
EVERY = 10.0  # s
TIMES = np.array([3000.0, 4800.0, 7000.0, 8800.0])
RIGHT_ANGLES = (np.zeros(3), np.zeros(3))


@cache
def timeline():
    """A yaw maneuver of half a turn while the Sun is near the orbit plane, seen on both sides of it."""
    orbit = replace(FILTER_CASE_ORBIT, node=np.deg2rad(260.0))
    flight = fly([(Z, 180.0, 5000.0, 800.0)], 9000.0, sample_s=2.0, orbit=orbit)
    t = np.arange(0.0, flight.t[-1], EVERY)
    position, sun = compute_orbit_position(orbit, t), compute_sun_vector(compute_julian_date(EPOCH) + t / DAY)
    normal = np.cross(position[0], position[100])
    across = np.rad2deg(np.arcsin(sun[0] @ normal / np.linalg.norm(normal)))
    assert abs(across) < 25
    return flight, t, position, sun


def sensors(rng, heads=RIGHT_ANGLES, swing=0.0):
    """What both DSS and the ESA measure; no misalignment, right-angled heads, and a steady radiance of space by default."""
    flight, t, position, sun = timeline()
    A, lit = flight.get_attitudes(t), ~is_eclipsed(position, sun)
    series = []
    for true, model in zip(true_sun.build_trmm_sensors(heads=heads), trmm_sun_sensors(), strict=True):
        counts, visible = true_sun.observe(rng, true, A, sun)
        if (visible & lit).any():
            series.append(model.series(t, counts, sun, visible & lit))
    angles, used = true_earth.observe(rng, true_earth.TrueEarthSensor(swing=swing), t, A, position, sun)
    sensor = EarthSensor(np.zeros(4))
    series.append(SensorSeries(EarthModel(sensor, position), t, angles, np.where(used, sensor.sigma, np.inf)))
    return series


def started(rng, parameters):
    flight, *_ = timeline()
    off = rng.standard_normal(6) * START
    A = attitude.rotation_matrix(-off[:3]) @ flight.A[0]
    return KalmanFilter(A, GyroParameters(parameters.G, TRUTH.bias + off[3:]), np.diag(START**2), FILTER_CASE_ARW)


def consistency(cases, **options):
    """Mean NEES at each time, and mean normalised innovation per degree of freedom."""
    flight, *_ = timeline()
    values, ratios = [], []
    for seed in range(cases):
        rng = np.random.default_rng([41, seed])
        found = run(started(rng, TRUTH), flight.gyro(rng), sensors(rng, **options), 0.0, TIMES)
        errors = state_errors(found.A, found.x, found.names, flight.get_attitudes(TIMES), TRUTH)
        values.append(compute_nees(errors, found.covariance))
        ratios.append(found.innovations.nis.sum() / found.innovations.dof.sum())
    return np.mean(values, axis=0), np.mean(ratios)


@pytest.mark.parametrize("cases", choose_case_numbers(4, 20))
def test_filter_is_consistent(cases):
    values, ratio = consistency(cases)
    low, high = mean_bounds(6, cases)
    assert (values > low).all()
    assert (values < high).all()
    assert abs(ratio - 1) < 0.05  # the S detectors' noise adds a little to the angles'


@pytest.mark.parametrize("cases", choose_case_numbers(4, 10))
def test_errors_of_an_orbit_period_show(cases):
    """The S detectors' filter lags behind a space radiance that changes over the orbit; DSS heads off the right angle."""
    high = mean_bounds(6, cases)[1]
    lagging, ratio = consistency(cases, swing=0.02)
    assert lagging.max() > high
    assert ratio < 1.1  # and the innovations hardly tell
    heads, _ = consistency(cases, heads=(true_sun.HEAD_DSS1, true_sun.HEAD_DSS2))
    assert heads.max() > 5 * high


@pytest.mark.parametrize("cases", choose_case_numbers(6, 30))
def test_on_board_residual_is_consistent(cases):
    flight, *_ = timeline()
    white, naive = [], []
    for seed in range(cases):
        rng = np.random.default_rng([42, seed])
        apriori = draw_apriori_parameters(rng, 1e-4, np.deg2rad(1e-5))
        onboard = OnBoardCalibrator(started(rng, apriori), apriori)
        (one,) = replay(onboard, flight.gyro(rng), sensors(rng), 0.0, [SPAN])
        noise = one.residual - one.Theta @ (apriori.vector - TRUTH.vector)
        white.append(noise @ np.linalg.solve(one.C, noise))
        C = one.P_end + one.R @ one.P_start @ one.R.T
        naive.append(noise @ np.linalg.solve(C, noise))
    low, high = mean_bounds(3, cases)
    assert low < np.mean(white) < high
    assert np.mean(naive) > high  # the references alone, as the paper's C
