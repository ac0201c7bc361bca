"""Effects on the attitude sensors: what they do to the simulated sensors, against the error they state."""

from dataclasses import replace

import numpy as np
import pytest

from simulator import scenario
from simulator.effects.sensor import SENSOR_EFFECTS, Sightings, parse
from simulator.sensors import earth as earth_sensor
from simulator.sensors.horizon import compute_orbit_position
from simulator.sensors.raw_tables import build_nominal_suite
from simulator.sensors.sun import compute_head_tangents
from simulator.simulate import simulate
from simulator.truth.orbit import CircularOrbit, compute_lvlh_attitude
from simulator.truth.sun import DAY, compute_julian_date, compute_sun_vector

EPOCH = "1997-12-19T21:30:00"
ORBIT = CircularOrbit(350e3, np.deg2rad(35.0), node=np.deg2rad(-133.0))
MONTHS = scenario.load("trmm_months")
SETTINGS = [
    "dss_head:2=-0.9,e1_deg=1,e2_deg=-2,e3_deg=0.3",
    "dss_misalignment=0.8",
    "esa_bias=0.3",
    "esa_s_filter=-0.5,time_constant_s=30",
    "esa_sun_intrusion=0.7,field_deg=8,time_constant_s=120",
    "esa_nadir=0.4",
]


@pytest.fixture(scope="module")
def looking():
    """An orbit, −x forward, with the Sun some 40° from the orbit plane, so that it passes two quadrants."""
    t = np.arange(0.0, ORBIT.period, 8.0)
    A = np.diag([-1.0, -1.0, 1.0]) @ compute_lvlh_attitude(ORBIT, t)
    sun = compute_sun_vector(compute_julian_date(EPOCH) + t / DAY)
    body = np.einsum("nij,nj->ni", A, sun)
    assert 38 < np.rad2deg(np.arcsin(-body[:, 1])).mean() < 46
    return t, A, compute_orbit_position(ORBIT, t), sun


def shown(suite, looking):
    """Angles that both sun sensors see before they are counted, and the Earth sensor's without noise."""
    t, A, position, sun = looking
    angles = []
    for sensor in suite.sun_sensors:
        s = np.einsum("nij,nj->ni", A, sun) @ sensor.alignment
        own = [compute_head_tangents(*row, sensor.head) if row[2] > 0.3 else (np.nan, np.nan) for row in s]
        angles.append(np.arctan(np.array(own)))
    return np.stack(angles), *earth_sensor.observe(np.random.default_rng(0), suite.earth, t, A, position, sun)


def sightings(looking, angles, used):
    t, A, position, sun = looking
    seen = np.isfinite(angles).all(axis=2)
    number = np.concatenate([np.full(rows.sum(), k + 1) for k, rows in enumerate(seen)])
    own = np.concatenate([angles[k][rows] for k, rows in enumerate(seen)])
    return Sightings(number, own, t, np.zeros(t.size, dtype=np.intp), A, position, sun, used), seen


@pytest.mark.parametrize("text", SETTINGS)
def test_the_error_is_what_the_simulated_sensors_show(looking, text):
    setting = parse(text)
    effect = SENSOR_EFFECTS[setting.effect]
    plain = build_nominal_suite(0.0, 0.0)
    # A quadrant that is not used shows the Sun in S, and what it would show without is wanted.
    before, earth_before, _ = shown(replace(plain, earth=replace(plain.earth, sun_radiance=0.0)), looking)
    after, earth_after, used = shown(effect.fitted(plain, setting), looking)
    where, seen = sightings(looking, before, used)
    sun_error, earth_error = effect.error(where, setting.axis, effect.amplitudes(setting), setting.parameters)
    changed = np.concatenate([(after - before)[k][rows] for k, rows in enumerate(seen)])
    np.testing.assert_allclose(sun_error, changed, rtol=0, atol=1e-12)
    np.testing.assert_allclose(earth_error[used], (earth_after - earth_before)[used], rtol=0, atol=1e-12)
    assert np.abs(sun_error).max() + np.abs(earth_error[used]).max() > 1e-3


def test_an_effect_leaves_the_noise_as_it_was():
    few = MONTHS.model_copy(update={"interval": MONTHS.interval[6:8]})
    plain, biased = simulate(few, seed=5), simulate(few, seed=5, effects=[parse("esa_bias=0.4")])
    np.testing.assert_array_equal(plain.sensors.sun.counts, biased.sensors.sun.counts)
    np.testing.assert_array_equal(plain.gyro.rates, biased.gyro.rates)
    bias = np.deg2rad(SENSOR_EFFECTS["esa_bias"].amplitudes(parse("esa_bias=0.4")))
    difference = biased.sensors.earth.angles - plain.sensors.earth.angles
    np.testing.assert_allclose(difference, np.tile(bias, (len(difference), 1)), atol=1e-12)
