"""From tables to recordings: sensors joined, rests, noise, intervals, and what is refused."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import gyrocal
from gyrocal import InputError, attitude, importing
from gyrocal.importing import agreement, motion, noise, rests, validate_mapping
from gyrocal.importing.build import build
from gyrocal.importing.sensors import join_sensors
from gyrocal.importing.streams import Sensor, Streams, read_streams
from studies.validation import mems_log
from tests.builders import piecewise_recording
from tests.gyrocal.importing.mems import CORRECT_MAPPING, WRONG_MAPPINGS, find_refusal, is_mapping_named


@pytest.fixture(scope="module")
def data():
    return mems_log.log(np.random.default_rng(5), seconds=120.0)


@pytest.fixture(scope="module")
def imported(data):
    mapping = validate_mapping(CORRECT_MAPPING, "mapping")
    return build(read_streams(data.gyro, data.attitude, mapping), mapping)


def test_noise_bias_rests_and_intervals_are_found_and_calibrated(imported, data):
    gyro = imported.recording.gyro
    assert np.rad2deg(gyro.arw) == pytest.approx(mems_log.MEMS_ARW_DEG_PER_SQRT_S, rel=0.05)
    assert np.rad2deg(imported.recording.attitudes.sigma) == pytest.approx(mems_log.REFERENCE_SIGMA_DEG, rel=0.15)
    # At rest G ω_raw + b = 0 up to noise; the bias to start from has G = I.
    np.testing.assert_allclose(gyro.apriori_bias, np.linalg.solve(data.G, data.bias), rtol=0.02)
    assert "2 rest(s) found" in imported.assumed
    assert set(imported.assumed) <= set(imported.summary()["value"])
    intervals = imported.recording.intervals
    assert all(b.start_s > a.stop_s for a, b in pairwise(intervals))
    assert max(one.stop_s - one.start_s for one in intervals) < 31
    result = gyrocal.calibrate(imported.recording)
    error = result.parameters.vector - np.concatenate([data.G.ravel(), data.bias])
    assert (np.abs(error) < 4 * result.sigma).all()
    assert result.converged


@pytest.mark.parametrize("kind", [*WRONG_MAPPINGS, "two faults"])
def test_a_wrong_mapping_is_named(data, kind):
    two = {"gyro": "gx,gy,gz:rad/s", "quat": "qw,qx,qy,qz:inertial-to-body"}
    both = "the attitude from body to inertial (body-to-inertial) and the gyro in deg/s, not rad/s"
    changes, wanted = WRONG_MAPPINGS.get(kind, (two, both))
    message = find_refusal(data, changes)
    assert is_mapping_named(message, wanted), message


def test_a_scalar_last_file_read_as_scalar_first(data):
    table = data.attitude[["timestamp_ms", "qx", "qy", "qz", "qw"]].set_axis(["timestamp_ms", "a", "b", "c", "d"], axis=1)
    for direction in ("body-to-world", "world-to-body"):
        turned = table if direction == "body-to-world" else table.assign(a=-table["a"], b=-table["b"], c=-table["c"])
        message = find_refusal(replace(data, attitude=turned), {"quat": f"a,b,c,d:{direction}:scalar-first"})
        assert message.endswith(" % with the quaternion's scalar part last (scalar-last)")


def test_another_bodys_attitudes_fit_nothing(data):
    other = mems_log.log(np.random.default_rng(6), seconds=120.0)
    message = find_refusal(replace(data, attitude=other.attitude), {})
    assert "are they of the same body and time?" in message


def test_unchecked_tables_are_taken_and_it_is_written_down(data):
    mapping = validate_mapping(CORRECT_MAPPING | {"gyro": "gy,gx,gz:deg/s"}, "mapping")
    made = build(read_streams(data.gyro, data.attitude, mapping), mapping, check=False)
    assert any("imported unchecked although" in text and "y,x,z" in text for text in made.assumed)


def test_notes_stand_beside_a_recording_of_the_same_format(imported, tmp_path):
    importing.write(imported, tmp_path)
    again = gyrocal.load(tmp_path)
    np.testing.assert_allclose(again.gyro.rates, imported.recording.gyro.rates, rtol=1e-15)
    notes = gyrocal.recording.read_toml(tmp_path / importing.NOTES_FILE)
    assert notes["mapping"] == CORRECT_MAPPING
    assert notes["assumed"] == list(imported.assumed)


def test_tables_of_different_times_say_which_unit_would_do(data):
    later = data.attitude.assign(timestamp_ms=data.attitude["timestamp_ms"] + 10**7)
    assert "is one of the time tags offset?" in find_refusal(replace(data, attitude=later), {})
    started = data.attitude["timestamp_ms"] - mems_log.UNIX_MS
    g = data.gyro.assign(timestamp_ms=(data.gyro["timestamp_ms"] - mems_log.UNIX_MS) / 1000)
    wrong = replace(data, gyro=g, attitude=data.attitude.assign(timestamp_ms=started))
    assert "with the attitudes' time unit 1000 times finer" in find_refusal(wrong, {"time": "timestamp_ms:s"})


def test_a_delay_of_a_few_samples_is_said_and_not_refused(data):
    mapping = validate_mapping(CORRECT_MAPPING | {"attitude_offset_s": 0.05}, "mapping")
    made = build(read_streams(data.gyro, data.attitude, mapping), mapping)
    assert any("-0.05 s added" in text and "not undone" in text for text in made.assumed)


def test_a_gap_ends_an_interval(data):
    mapping = validate_mapping(CORRECT_MAPPING | {"interval_s": 1000.0}, "mapping")
    holed = data.gyro[(data.gyro.index < 5000) | (data.gyro.index > 5100)]
    made = build(read_streams(holed, data.attitude, mapping), mapping)
    first, second = made.recording.intervals
    assert first.stop_s <= second.start_s
    gyrocal.calibrate(made.recording)


def test_a_large_bias_is_named_by_the_calibration():
    recording = piecewise_recording(series_s=50.0)
    biased = replace(recording, gyro=replace(recording.gyro, rates=recording.gyro.rates + np.deg2rad(0.03)))
    with pytest.raises(InputError, match=r"too large to linearise.*with a bias of -0.03\d*, -0.0\d*, -0.0\d* deg/s"):
        gyrocal.calibrate(biased)


def test_a_wrong_unit_is_named_by_the_calibration(imported):
    gyro = imported.recording.gyro
    with pytest.raises(InputError, match="the gyro in rad/s, not deg/s"):
        gyrocal.calibrate(replace(imported.recording, gyro=replace(gyro, rates=np.deg2rad(gyro.rates))))


# Several sensors and gyros, in closed form.

MOUNTING = Rotation.from_rotvec([0.3, 1.0, -0.4])  # second sensor's axes to the first's


def turning(n=3000, dt=0.1, rng=None):
    """Body-to-inertial rotations at constant rates about an axis that changes, and the rates."""
    t = dt * np.arange(n)
    omega = np.deg2rad(np.column_stack([np.sin(0.05 * t), 2 * np.cos(0.021 * t), np.sin(0.033 * t + 1)]))
    steps = Rotation.from_rotvec(omega * dt).as_matrix()
    bodies = np.empty((n + 1, 3, 3))
    bodies[0] = np.eye(3)
    for k, step in enumerate(steps):
        bodies[k + 1] = bodies[k] @ step
    return t, omega, Rotation.from_matrix(bodies[:-1])


def test_two_sensors_are_one_body():
    rng = np.random.default_rng(8)
    t, _, body = turning()
    own, its = np.deg2rad([0.001, 0.002, 0.008]), np.deg2rad([0.002, 0.001, 0.01])
    errors = [Rotation.from_rotvec(rng.normal(size=(t.size, 3)) * sigma) for sigma in (own, its)]
    first = Sensor("A", t, (body * errors[0]).as_quat())
    second = Sensor("B", t, (body * MOUNTING * errors[1]).as_quat())
    joined = join_sensors((first, second), None)
    angle = (Rotation.from_matrix(joined.mounting["B"]).inv() * MOUNTING).magnitude()
    assert angle < 4 * np.deg2rad(0.01) / np.sqrt(t.size)
    for name, sigma in (("A", own), ("B", its)):
        # Second differences of n samples of white noise: 35/18 of the variance of as many independent ones.
        np.testing.assert_allclose(joined.sigma[name], sigma, rtol=4 * np.sqrt(35 / 18 / 2 / t.size))
    weighted = join_sensors((first, second), {"A": own, "B": its})
    error = attitude.residual(attitude.matrix_from_quaternion(weighted.q), body.as_matrix().transpose(0, 2, 1))
    nees = np.einsum("ni,ij,nj->n", error, np.linalg.inv(weighted.covariance), error)
    assert nees.mean() == pytest.approx(3.0, abs=4 * np.sqrt(6 / t.size))


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
    return build(read_streams(gyro, attitudes, mapping), mapping), omega


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_four_gyros_are_joined_in_a_mounting_that_is_estimated(mirror):
    found, omega = import_four(mirror, arw_deg_per_sqrt_s=1e-5)
    gyro = found.recording.gyro
    assert np.sign(np.linalg.det(gyro.apriori_G)) == mirror
    np.testing.assert_allclose(gyro.rates @ gyro.apriori_G.T, omega, atol=2e-3 * np.abs(omega).max())
    np.testing.assert_allclose(gyro.arw_deg_per_sqrt_s, np.sqrt(0.75) * 1e-5)


def test_the_parity_of_joined_gyros_has_their_noise_and_shows_the_one_that_fails():
    walk = np.deg2rad(1e-5)
    found, _ = import_four(walk=walk)
    assert found.recording.gyro.arw == pytest.approx(np.sqrt(0.75) * walk, rel=0.1)
    assert sum("differs from what the others say" in text for text in found.assumed) == 4
    assert found.warnings == ()

    def step(gyro):
        gyro.loc[1500:, "c"] += 1e-3

    stepped, _ = import_four(walk=walk, damage=step, unchecked=True)
    assert any("the gyros do not agree" in text and "--gyros" in text for text in stepped.warnings)
    without, _ = import_four(walk=walk, damage=step, gyros="1,b,4")
    assert without.warnings == ()
    three, four = (one.recording.gyro for one in (without, found))
    np.testing.assert_allclose(three.rates @ three.apriori_G.T, four.rates @ four.apriori_G.T, atol=1e-4)


def test_rows_without_a_gyro_use_the_others():
    def lose(gyro):
        gyro.loc[100:200, "a"] = np.nan
        gyro.loc[150, "b"] = np.nan

    found, omega = import_four(damage=lose, arw_deg_per_sqrt_s=1e-5)
    assert any("101 gyro row(s) in which a gyro is missing use the others" in text for text in found.assumed)
    gyro = found.recording.gyro
    np.testing.assert_allclose(gyro.rates @ gyro.apriori_G.T, omega, atol=2e-3 * np.abs(omega).max())


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({"gyros": "a,b"}, "three or more different ones are needed, not a,b"),
        ({"gyros": "a,b,5"}, "no gyro 5; there are a, b, c, d, or 1 to 4"),
        (
            {"axes": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]], "gyros": "1,2,3"},
            "do not measure all",
        ),
        ({"arw_deg_per_sqrt_s": [1e-5] * 3}, "3 numbers, but 4 gyros"),
    ],
)
def test_gyros_that_cannot_be_joined_are_refused(entries, words):
    with pytest.raises(InputError, match=words):
        import_four(**entries)


def trackers(rng, sigma, dropped=(100.0, 130.0)):
    """Streams of three gyros and two trackers, the second of which drops out for a while."""
    t, omega, body = turning()
    errors = [Rotation.from_rotvec(rng.normal(size=(t.size, 3)) * one) for one in sigma]
    seen = (t < dropped[0]) | (t > dropped[1])
    first = Sensor("one", t, (body * errors[0]).as_quat())
    second = Sensor("two", t[seen] + 0.02, (body * Rotation.from_rotvec(0.02 * omega) * MOUNTING * errors[1])[seen].as_quat())
    return Streams(t, omega + 1e-7 * rng.normal(size=omega.shape), 0.1, np.eye(3), (first, second), "", "s", ()), t


def test_two_trackers_stay_two_with_their_own_noise_and_mounting():
    sigma = np.deg2rad([[0.001, 0.002, 0.008], [0.002, 0.001, 0.01]])
    made, t = trackers(np.random.default_rng(9), sigma)
    found = build(made, validate_mapping(CORRECT_MAPPING | {"attitude_by": "sensor", "spacing_s": 1.0}, "x"))
    references = found.recording.attitudes
    assert [one.name for one in references.sensors] == ["s1", "s2"]
    assert [one.estimated for one in references.sensors] == [False, True]
    assert "the attitude sensors one, two are named s1, s2" in found.assumed
    for number in range(2):
        own = references.sensor == number
        np.testing.assert_allclose(references.sigma[own][0], sigma[number], rtol=0.25)
        assert np.diff(references.t_s[own]).min() > 0.9
    assert not ((references.t_s > 100.1) & (references.t_s < 130) & (references.sensor == 1)).any()
    assert ((references.t_s > 100.1) & (references.t_s < 130)).sum() > 25
    turned = Rotation.from_matrix(references.sensors[1].M.T).inv() * MOUNTING
    assert turned.magnitude() < 5 * np.deg2rad(0.01) / np.sqrt(t.size)
    result = gyrocal.calibrate(found.recording)
    assert result.p_value > 1e-3
    assert (np.abs(result.parameters.vector - np.eye(4, 3).ravel()) < 4.5 * result.sigma).all()


def test_mountings_that_are_stated_are_kept_or_refused():
    made, _ = trackers(np.random.default_rng(9), np.full((2, 3), np.deg2rad(0.002)))
    made = replace(made, sensors=tuple(replace(one, name=f"st{k}") for k, one in enumerate(made.sensors, 1)))
    stated = {"st1": [0.0, 0.0, 0.0, 1.0], "st2": MOUNTING.as_quat().tolist()}
    entries = CORRECT_MAPPING | {
        "attitude_by": "sensor",
        "mountings": stated,
        "spacing_s": 1.0,
        "mounting_sigma_deg": {"st2": [0.1] * 3},
    }
    sensors = build(made, validate_mapping(entries, "x")).recording.attitudes.sensors
    np.testing.assert_allclose(sensors[1].mounting, MOUNTING.as_quat(), atol=1e-12)
    assert sensors[1].estimated
    np.testing.assert_allclose(np.rad2deg(sensors[1].mounting_sigma), 0.1)
    for changes, words in (
        ({"mountings": stated | {"st2": MOUNTING.inv().as_quat().tolist()}}, "sits .* deg from where it is stated"),
        ({"mountings": {"st1": stated["st1"]}, "mounting_sigma_deg": None}, "mountings: give it for st1, st2"),
        ({"mountings": stated | {"st1": [0.0, 0.0, 0.0, 2.0]}}, "st1 must be a quaternion of norm 1"),
        ({"attitude_by": None}, "goes with attitude_by"),
        ({"mountings": None}, "go with mountings"),
        ({"estimated_mountings": ["st3"]}, "no mounting of st3 is stated"),
    ):
        with pytest.raises(InputError, match=words):
            build(made, validate_mapping(entries | changes, "x"))


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
    np.testing.assert_allclose(noise.estimate_walk_at_rest([rates], 0.01), 1e-3, rtol=0.05)
    np.testing.assert_allclose(noise.estimate_walk_in_motion(rates, 0.01), 1e-3, rtol=0.05)
    assert noise.estimate_walk_at_rest([rates[:20]], 0.01) is None


def test_a_single_axis_leaves_what_it_cannot_tell_in_the_message(data):
    t, omega, _ = turning(600)
    about_z = np.column_stack([np.zeros(600), np.zeros(600), omega[:, 1]])
    angle = np.concatenate([[0.0], np.cumsum(about_z[:-1, 2] * 0.1)])
    q = Rotation.from_rotvec(np.outer(angle, [0, 0, 1.0])).as_quat()
    windows = motion.build_motion(t, -about_z, 0.1, t, q)
    found = agreement.evaluate_agreement(windows, "deg/s", "s", "scalar-last")
    assert not found.fits
    # A sign and a direction are one change each, and turns about one axis do not tell them apart.
    assert " or " in found.sentence
    assert "x,y,-z" in found.sentence
    assert "inertial-to-body" in found.sentence
