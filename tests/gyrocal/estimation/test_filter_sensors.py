"""The filter with the Sun and Earth sensors of TRMM: counts and penetration angles in, estimates out."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gyrocal import GyroParameters, attitude
from gyrocal.estimation.filter_run import run
from gyrocal.estimation.mekf import KalmanFilter, compute_nees
from gyrocal.sensors.earth import EarthModel, EarthSensor
from gyrocal.sensors.series import SensorSeries
from gyrocal.sensors.sun import trmm_sun_sensors
from simulator.sensors import earth as true_earth
from simulator.sensors import sun as true_sun
from simulator.sensors.horizon import compute_orbit_position
from simulator.truth.sun import DAY, compute_julian_date, compute_sun_vector, is_eclipsed
from tests.builders import TRUTH, choose_case_numbers, mean_bounds, state_errors
from tests.gyrocal.estimation.filter_cases import FILTER_CASE_ARW, FILTER_CASE_ORBIT, Z, fly

EPOCH = "1997-12-13T09:45:00Z"
START = np.repeat([np.deg2rad(0.5), np.deg2rad(1e-3)], 3)
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


def sensors(rng):
    """What both DSS and the ESA measure, with heads at right angles, no misalignment and a steady radiance of space."""
    flight, t, position, sun = timeline()
    A, lit = flight.get_attitudes(t), ~is_eclipsed(position, sun)
    series = []
    for true, model in zip(true_sun.build_trmm_sensors(heads=RIGHT_ANGLES), trmm_sun_sensors(), strict=True):
        counts, visible = true_sun.observe(rng, true, A, sun)
        if (visible & lit).any():
            series.append(model.series(t, counts, sun, visible & lit))
    angles, used = true_earth.observe(rng, true_earth.TrueEarthSensor(swing=0.0), t, A, position, sun)
    sensor = EarthSensor(np.zeros(4))
    series.append(SensorSeries(EarthModel(sensor, position), t, angles, np.where(used, sensor.sigma, np.inf)))
    return series


@pytest.mark.parametrize("cases", choose_case_numbers(4, 20))
def test_filter_is_consistent(cases):
    flight, *_ = timeline()
    values, ratios = [], []
    for seed in range(cases):
        rng = np.random.default_rng([41, seed])
        off = rng.standard_normal(6) * START
        A = attitude.rotation_matrix(-off[:3]) @ flight.A[0]
        estimator = KalmanFilter(A, GyroParameters(TRUTH.G, TRUTH.bias + off[3:]), np.diag(START**2), FILTER_CASE_ARW)
        found = run(estimator, flight.gyro(rng), sensors(rng), 0.0, TIMES)
        errors = state_errors(found.A, found.x, found.names, flight.get_attitudes(TIMES), TRUTH)
        values.append(compute_nees(errors, found.covariance))
        ratios.append(found.innovations.nis.sum() / found.innovations.dof.sum())
    low, high = mean_bounds(6, cases)
    assert (np.mean(values, axis=0) > low).all()
    assert (np.mean(values, axis=0) < high).all()
    assert abs(np.mean(ratios) - 1) < 0.05  # the S detectors' noise adds a little to the angles'
