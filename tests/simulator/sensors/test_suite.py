"""Raw tables of both kinds of sensor on an orbit, read back by the estimator's models."""

import numpy as np
import pandas as pd
import pytest

import gyrocal.sensors.sun as ground
from gyrocal.sensors.earth import EarthModel, EarthSensor
from simulator.sensors import earth as earth_sensor
from simulator.sensors import sun as sun_sensor
from simulator.sensors.suite import SensorSuite, positions, sensor_tables
from simulator.truth.orbit import EARTH_RADIUS, CircularOrbit, lvlh_attitude
from simulator.truth.sun import DAY, eclipse, julian_date, sun_vector

EPOCH = "1998-01-15T06:00:00"
ORBIT = CircularOrbit(350e3, np.deg2rad(35.0), node=np.deg2rad(20.0))
STEP = 4.0
SQUARE = (np.zeros(3), np.zeros(3))


def generators(seed=1):
    return (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(2))


def of_sensor(table, number):
    return table[table["sensor"] == number]


@pytest.fixture(scope="module")
def case():
    """One orbit, the spacecraft with its −Y side to the Sun."""
    t = np.arange(0, ORBIT.period, STEP)
    A = lvlh_attitude(ORBIT, t)
    sun = sun_vector(julian_date(EPOCH) + t / DAY)
    if (A[0] @ sun[0])[1] > 0:
        A = np.diag([-1.0, -1.0, 1.0]) @ A  # −x forward
    suite = SensorSuite(sun_sensors=sun_sensor.trmm_sun_sensors(heads=SQUARE))
    return t, A, sun, sensor_tables(suite, ORBIT, EPOCH, t, A, *generators())


def test_columns_are_those_of_a_recording(case):
    t, _, _, tables = case
    assert list(tables["sun_sensor"].columns) == ["t_s", "sensor", "count_alpha", "count_beta"]
    assert list(tables["sun_sensor"].dtypes) == [np.float64, np.int64, np.int64, np.int64]
    names = [f"penetration_{i}_deg" for i in range(1, 5)] + [f"used_{i}" for i in range(1, 5)]
    assert list(tables["earth_sensor"].columns) == ["t_s", *names]
    assert list(tables["earth_sensor"].dtypes) == [np.float64] * 5 + [np.bool_] * 4
    np.testing.assert_array_equal(tables["earth_sensor"]["t_s"], t)
    key = tables["sun_sensor"][["t_s", "sensor"]]
    pd.testing.assert_frame_equal(key, key.sort_values(["t_s", "sensor"], ignore_index=True))
    assert not key.duplicated().any()


def test_positions_are_on_the_orbit(case):
    t, *_ = case
    np.testing.assert_allclose(np.linalg.norm(positions(ORBIT, t), axis=1), EARTH_RADIUS + 350e3, rtol=1e-14)
    # From the elements: at the epoch the satellite is at its node.
    node = np.deg2rad(20.0)
    np.testing.assert_allclose(positions(ORBIT, t[:1])[0], ORBIT.radius * np.array([np.cos(node), np.sin(node), 0]), atol=1e-6)


def test_sun_rows_are_those_in_view_and_lit(case):
    t, A, sun, tables = case
    dark = eclipse(positions(ORBIT, t), sun)
    assert 0.2 < dark.mean() < 0.45
    body = np.einsum("nij,nj->ni", A, sun)
    for number, sensor in enumerate(ground.trmm_sun_sensors(), start=1):
        inside = body @ sensor.alignment
        edge = np.tan(sensor.half_fov)
        seen = ~dark & (inside[:, 2] > 0) & (np.abs(inside[:, :2]) <= edge * inside[:, 2:]).all(axis=1)
        rows = of_sensor(tables["sun_sensor"], number)
        np.testing.assert_array_equal(rows["t_s"], t[seen])
        assert 50 < len(rows) < 0.4 * len(t)


def test_sun_table_closes_with_the_estimators_model(case):
    t, A, sun, tables = case
    white = []
    for number, sensor in enumerate(ground.trmm_sun_sensors(), start=1):
        rows = of_sensor(tables["sun_sensor"], number)
        index = np.searchsorted(t, rows["t_s"])
        series = sensor.series(t[index], rows[["count_alpha", "count_beta"]].to_numpy(), sun[index])
        white.append((series.y - series.model.predict(A[index], np.arange(index.size))) / series.sigma)
    white = np.concatenate(white).ravel()
    # The sigma holds at the boresight, where a count is largest; elsewhere it is up to 9 % above the truth.
    assert abs(white.mean()) < 4 / np.sqrt(white.size)
    assert 0.8 - 4 * np.sqrt(2 / white.size) < white.var() < 1 + 4 * np.sqrt(2 / white.size)


def test_turned_heads_would_be_seen(case):
    """Negative control: with the flight's heads the estimator's model misses by ten sigma and more."""
    t, A, sun, _ = case
    table = sensor_tables(SensorSuite(), ORBIT, EPOCH, t, A, *generators())["sun_sensor"]
    table = of_sensor(table, 2)
    sensor, index = ground.trmm_sun_sensors()[1], np.searchsorted(t, table["t_s"])
    series = sensor.series(t[index], table[["count_alpha", "count_beta"]].to_numpy(), sun[index])
    white = (series.y - series.model.predict(A[index], np.arange(index.size))) / series.sigma
    assert np.sqrt((white[:, 1] ** 2).mean()) > 10
    assert white[:, 0].var() < 1.5


def test_earth_table_closes_with_the_estimators_model(case):
    t, A, _, tables = case
    table, truth = tables["earth_sensor"], earth_sensor.TrueEarthSensor()
    y = np.deg2rad(table[[f"penetration_{i}_deg" for i in range(1, 5)]].to_numpy())
    used = table[[f"used_{i}" for i in range(1, 5)]].to_numpy()
    expected = EarthModel(EarthSensor(np.zeros(4)), positions(ORBIT, t)).predict(A, np.arange(t.size))
    error = (y - expected)[used]
    # The S filter's own noise and lag add a little to the noise of the angles.
    assert truth.sigma * 0.95 < np.sqrt((error**2).mean()) < 1.3 * truth.sigma


def test_streams_are_apart(case):
    t, A, _, tables = case
    suite = SensorSuite(sun_sensors=sun_sensor.trmm_sun_sensors(heads=SQUARE))
    again = sensor_tables(suite, ORBIT, EPOCH, t, A, *generators())
    for name in tables:
        pd.testing.assert_frame_equal(again[name], tables[name])
    alone = sensor_tables(SensorSuite(suite.sun_sensors, earth=None), ORBIT, EPOCH, t, A, *generators())
    assert list(alone) == ["sun_sensor"]
    pd.testing.assert_frame_equal(alone["sun_sensor"], tables["sun_sensor"])
    other = sensor_tables(suite, ORBIT, EPOCH, t, A, *generators(2))
    assert (other["sun_sensor"]["count_alpha"] != tables["sun_sensor"]["count_alpha"]).mean() > 0.3
