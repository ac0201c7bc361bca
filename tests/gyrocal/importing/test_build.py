"""From tables to recordings: sensors joined, rests, noise, intervals, and what is refused."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import gyrocal
from gyrocal import importing, rests
from gyrocal.calibration.gate import LargeResidualError
from gyrocal.importing import estimates, validate_mapping
from gyrocal.importing.build import import_streams
from gyrocal.importing.streams import Sensor, Streams, read_streams
from tests.gyrocal.importing import mems_log
from tests.gyrocal.importing.mems import CORRECT_MAPPING, find_refusal


@pytest.fixture(scope="module")
def data():
    return mems_log.log(np.random.default_rng(5), seconds=120.0)


@pytest.fixture(scope="module")
def imported(data):
    mapping = validate_mapping(CORRECT_MAPPING, "mapping")
    return import_streams(read_streams(data.gyro, data.attitude, mapping), mapping)


def test_noise_bias_rests_and_intervals_are_found_and_calibrated(imported, data):
    gyro = imported.recording.gyro
    assert np.rad2deg(gyro.arw) == pytest.approx(mems_log.MEMS_ARW_DEG_PER_SQRT_S, rel=0.05)
    assert np.rad2deg(imported.recording.attitudes.sigma) == pytest.approx(mems_log.REFERENCE_SIGMA_DEG, rel=0.15)
    # At rest G ω_raw + b = 0 up to noise; the bias to start from has G = I.
    np.testing.assert_allclose(gyro.apriori_bias, np.linalg.solve(data.G, data.bias), rtol=0.02)
    assert max(interval.stop_s - interval.start_s for interval in imported.recording.intervals) < 31
    result = gyrocal.calibrate(imported.recording)
    error = result.parameters.vector - np.concatenate([data.G.ravel(), data.bias])
    assert (np.abs(error) < 4 * result.sigma).all()


def test_a_wrong_mapping_is_named_as_the_only_one_that_fits(data):
    message = find_refusal(data, {"gyro": "gx,gy,gz:rad/s", "quat": "qw,qx,qy,qz:inertial-to-body"})
    wanted = "the attitude from body to inertial (body-to-inertial) and the gyro in deg/s, not rad/s"
    assert message.endswith(f" % with {wanted}")


@pytest.mark.parametrize("factor", [180 / np.pi, np.pi / 180])
def test_a_column_with_another_unit_than_the_others_is_named(data, factor):
    message = find_refusal(replace(data, gyro=data.gyro.assign(gz=factor * data.gyro["gz"])), {})
    number, found = re.search(r"the rates of gyro (\d) alone times (\S+): its column has another unit", message).groups()
    assert (number, float(found)) == ("3", pytest.approx(1 / factor, rel=0.05))


def test_a_gap_ends_an_interval(data):
    mapping = validate_mapping(CORRECT_MAPPING | {"interval_s": 1000.0}, "mapping")
    holed = data.gyro[(data.gyro.index < 5000) | (data.gyro.index > 5100)]
    first, second = import_streams(read_streams(holed, data.attitude, mapping), mapping).recording.intervals
    assert second.start_s - first.stop_s > 0.9


def test_tables_of_different_times_say_which_unit_would_do(data):
    later = data.attitude.assign(timestamp_ms=data.attitude["timestamp_ms"] + 10**7)
    assert "is one of the time tags offset?" in find_refusal(replace(data, attitude=later), {})
    started = data.attitude["timestamp_ms"] - mems_log.UNIX_MS
    g = data.gyro.assign(timestamp_ms=(data.gyro["timestamp_ms"] - mems_log.UNIX_MS) / 1000)
    wrong = replace(data, gyro=g, attitude=data.attitude.assign(timestamp_ms=started))
    assert "with the attitudes' time unit 1000 times finer" in find_refusal(wrong, {"time": "timestamp_ms:s"})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (np.deg2rad, "the gyro in rad/s, not deg/s"),
        (Rotation.from_rotvec([0.5, -0.7, 0.4]).apply, "--mounting estimate"),
    ],
)
def test_a_refusal_of_the_calibration_is_explained(imported, change, words):
    gyro = imported.recording.gyro
    with pytest.raises(LargeResidualError, match="too large to linearise") as caught:
        gyrocal.calibrate(replace(imported.recording, gyro=replace(gyro, rates=change(gyro.rates))))
    assert re.search(words, importing.explain_refusal(caught.value))


# Several sensors and gyros, in closed form.

MOUNTING = Rotation.from_rotvec([0.3, 1.0, -0.4])  # second sensor's axes to the first's


def turning(n=3000, dt=0.1):
    """Body-to-inertial rotations at constant rates about an axis that changes, and the rates."""
    t = dt * np.arange(n)
    omega = np.deg2rad(np.column_stack([np.sin(0.05 * t), 2 * np.cos(0.021 * t), np.sin(0.033 * t + 1)]))
    steps = Rotation.from_rotvec(omega * dt).as_matrix()
    bodies = np.empty((n + 1, 3, 3))
    bodies[0] = np.eye(3)
    for k, step in enumerate(steps):
        bodies[k + 1] = bodies[k] @ step
    return t, omega, Rotation.from_matrix(bodies[:-1])


FOUR = CORRECT_MAPPING | {
    "gyro": "a,b,c,d:rad/s",
    "time": "t:s",
    "attitude_time": "t:s",
    "quat": "x,y,z,w:body-to-inertial",
    "axes": "tetrahedron",
    "mounting": "estimate",
    "sigma_deg": [1e-4] * 3,
    "bias_deg_s": [0.0] * 3,
}


def import_four(mirror=1.0, walk=0.0, damage=None, **entries):
    """The import of a tetrahedron of gyros, turned against the body, and the body's rates."""
    t, omega, body = turning()
    axes = np.array(importing.column_mapping.TETRAHEDRON) * [1.0, 1.0, mirror]
    raw = MOUNTING.inv().apply(omega) @ axes.T
    raw += np.random.default_rng(2).normal(size=raw.shape) * walk / np.sqrt(0.1)
    gyro = pd.DataFrame({"t": t} | dict(zip("abcd", raw.T, strict=True)))
    if damage is not None:
        damage(gyro)
    attitudes = pd.DataFrame({"t": t} | dict(zip("xyzw", body.as_quat().T, strict=True)))
    mapping = validate_mapping(FOUR | entries, "x")
    return import_streams(read_streams(gyro, attitudes, mapping), mapping), omega


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_four_gyros_are_joined_in_a_mounting_that_is_estimated(mirror):
    found, omega = import_four(mirror, arw_deg_per_sqrt_s=1e-5)
    gyro = found.recording.gyro
    np.testing.assert_array_equal(gyro.apriori_G, np.eye(3))
    np.testing.assert_allclose(gyro.rates, omega, atol=2e-3 * np.abs(omega).max())
    assert any("is the mirror image" in text for text in found.assumed) == (mirror < 0)
    np.testing.assert_allclose(gyro.arw_deg_per_sqrt_s, np.sqrt(0.75) * 1e-5)


def trackers(rng, sigma, dropped=(100.0, 130.0)):
    """Streams of three gyros and two trackers, the second of which drops out for a while."""
    t, omega, body = turning(1800)
    errors = [Rotation.from_rotvec(rng.normal(size=(t.size, 3)) * one) for one in sigma]
    seen = (t < dropped[0]) | (t > dropped[1])
    first = Sensor("one", t, (body * errors[0]).as_quat())
    second = Sensor("two", t[seen] + 0.02, (body * Rotation.from_rotvec(0.02 * omega) * MOUNTING * errors[1])[seen].as_quat())
    return Streams(t, omega + 1e-7 * rng.normal(size=omega.shape), 0.1, np.eye(3), (first, second), "", "s", ()), t


ENTRIES = CORRECT_MAPPING | {"attitude_by": "sensor", "spacing_s": 1.0}


def test_two_trackers_are_joined_with_their_own_noise_and_mounting():
    sigma = np.deg2rad([[0.001, 0.002, 0.008], [0.002, 0.001, 0.01]])
    made, _ = trackers(np.random.default_rng(9), sigma)
    found = import_streams(made, validate_mapping(ENTRIES, "x"))
    references, joined = found.recording.attitudes, found.joined
    assert [sensor.name for sensor in joined.sensors] == ["one", "two"]
    second = joined.sensors[1]
    off = (Rotation.from_matrix(second.mounting.T).inv() * MOUNTING).as_rotvec()
    assert (np.abs(off) < 4.5 * second.mounting_sigma).all()
    assert second.agreement == pytest.approx(1, abs=0.1)
    assert np.diff(references.t_s).min() > 0.9
    alone = (references.t_s > 99.95) & (references.t_s < 130.05)  # where the second drops out
    np.testing.assert_allclose(np.rad2deg(references.sigma[alone][0]), [0.001, 0.002, 0.008], rtol=0.25)
    assert (np.rad2deg(references.sigma[~alone]) < 0.003).all()
    result = gyrocal.calibrate(found.recording)
    assert result.p_value > 1e-3
    assert (np.abs(result.parameters.vector - np.eye(4, 3).ravel()) < 4.5 * result.sigma).all()


def test_rests_of_a_body_that_turns_steadily_are_none():
    rng = np.random.default_rng(0)
    rates = np.tile(np.deg2rad([0.0, 0.06, 0.0]), (600, 1)) + rng.normal(size=(600, 3)) * 1e-7
    assert rests.find_rests(rates, 0.1, np.full(600, np.deg2rad(0.06))) == []
    still = np.where(np.arange(600) < 100, 0.0, np.deg2rad(0.06))
    ((first, stop),) = rests.find_rests(
        np.where(still[:, None] > 0, rates * 10 + rng.normal(size=(600, 3)) * 1e-3, rates), 0.1, still
    )
    assert 0 <= first <= 10
    assert 90 <= stop <= 100


def test_walk_of_white_rates():
    rng = np.random.default_rng(4)
    rates = rng.normal(size=(20000, 3)) * 1e-3 / np.sqrt(0.01)
    np.testing.assert_allclose(estimates.estimate_walk_at_rest([rates], 0.01), 1e-3, rtol=0.05)
    np.testing.assert_allclose(estimates.estimate_walk_in_motion(rates, 0.01), 1e-3, rtol=0.05)
