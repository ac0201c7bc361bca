"""Rows of an attitude table may name their sensor; a recording is read as it was written, and what cannot be meant is said."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import gyrocal
import simulator
from gyrocal import InputError
from gyrocal.recording.trackers import compute_body_covariance
from tests.tracker_cases import AGILE, ESTIMATED


@pytest.fixture(scope="module")
def recording():
    return simulator.simulate(ESTIMATED, noise=False)


def written(folder, recording, old, new):
    """The recording's folder with a piece of recording.toml replaced."""
    gyrocal.save(recording, folder)
    path = folder / "recording.toml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    return folder


def test_a_recording_is_read_as_it_was_written(tmp_path, recording):
    gyrocal.save(recording, tmp_path / "two")
    read = gyrocal.load(tmp_path / "two")
    assert np.abs(read.attitudes.quaternions - recording.attitudes.quaternions).max() < 1e-15
    assert (read.attitudes.sensor == recording.attitudes.sensor).all()
    assert np.allclose(read.attitudes.sigma, recording.attitudes.sigma, rtol=1e-14)
    assert [(one.name, one.estimated) for one in read.attitudes.sensors] == [("st1", False), ("st2", True)]
    assert read.orbit == recording.orbit
    assert read.orbit.raan_deg == 155.0
    assert "of sensors" in repr(read)


def test_the_table_holds_what_each_tracker_measured(recording):
    row = recording.to_frame("attitude").iloc[1]
    tracker = recording.attitudes.sensors[1]
    body = Rotation.from_quat(recording.attitudes.quaternions[1]).inv().as_matrix()  # A, inertial to body
    measured = Rotation.from_quat(row[["q1", "q2", "q3", "q4"]].to_numpy(dtype=float)).inv().as_matrix()
    assert row["sensor"] == "st2"
    assert np.abs(measured - tracker.M @ body).max() < 1e-14


def test_sigmas_are_turned_from_the_sensor_to_the_body():
    recording = simulator.simulate(AGILE, noise=False)
    small, large = np.deg2rad(5e-4), np.deg2rad(5e-3)
    for C, number in zip(compute_body_covariance(recording.attitudes), recording.attitudes.sensor, strict=True):
        boresight = recording.attitudes.sensors[number].M[2]
        assert boresight @ C @ boresight == pytest.approx(large**2, rel=1e-12)
        assert np.trace(C) == pytest.approx(2 * small**2 + large**2, rel=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("format = 2", "format = 1", "needs format = 2"),
        ('maps = "inertial to sensor"', 'maps = "inertial to body"', "need one another"),
        ('name = "st2"', 'name = "st1"', "must differ"),
        ('name = "st2"', 'name = "right"', "digits at the end"),
        ('name = "st2"', 'name = "st3"', r"no \[\[attitude.sensor\]\] st2"),
        ("estimated = false", "estimated = true", "defines the axes"),
        ("estimated = false", "mounting_sigma_deg = [0.1, 0.1, 0.1]", "estimated = true"),
        ("mounting = [0.9537", "mounting = [0.8537", "norm 1"),
    ],
)
def test_what_cannot_be_meant_is_said(tmp_path, recording, old, new, message):
    with pytest.raises(InputError, match=message):
        gyrocal.load(written(tmp_path / "bad", recording, old, new))


def test_rows_must_name_their_sensor_and_be_quaternions(tmp_path, recording):
    gyrocal.save(recording, tmp_path / "rec")
    table = recording.to_frame("attitude")
    (tmp_path / "rec" / "attitude.parquet").unlink()
    for frame, message in (
        (table.drop(columns="sensor"), "column sensor is missing"),
        (table.assign(sensor=None), r"no \[\[attitude.sensor\]\] \(empty\)"),
        (table.assign(q1=2.0), "norm"),
        (table.drop(columns="sigma_x_deg"), "sigma_x_deg is missing"),
        (table.iloc[::-1], "in order"),
        (table.assign(sensor="st1"), "time of st1 repeats"),
    ):
        frame.to_csv(tmp_path / "rec" / "attitude.csv", index=False)
        with pytest.raises(InputError, match=message):
            gyrocal.load(tmp_path / "rec")


def test_sigmas_may_be_stated_once(tmp_path, recording):
    gyrocal.save(recording, tmp_path / "rec")
    (tmp_path / "rec" / "attitude.parquet").unlink()
    table = recording.to_frame("attitude").drop(columns=["sigma_x_deg", "sigma_y_deg", "sigma_z_deg"])
    table.to_csv(tmp_path / "rec" / "attitude.csv", index=False)
    path = tmp_path / "rec" / "recording.toml"
    path.write_text(path.read_text().replace("estimated", "sigma_deg = [1e-3, 2e-3, 1e-2]\nestimated"))
    read = gyrocal.load(tmp_path / "rec")
    assert np.allclose(read.attitudes.sigma_deg, [1e-3, 2e-3, 1e-2])


def test_rows_that_name_sensors_nobody_states_are_refused(tmp_path, recording):
    alone = gyrocal.of_sensor(recording, "st1")
    gyrocal.save(alone, tmp_path / "rec")
    (tmp_path / "rec" / "attitude.parquet").unlink()
    alone.to_frame("attitude").assign(sensor="st1").to_csv(tmp_path / "rec" / "attitude.csv", index=False)
    with pytest.raises(InputError, match="mounting"):  # format 2, by the orbit's elements
        gyrocal.load(tmp_path / "rec")


def test_one_of_the_sensors_alone_is_a_recording_as_any_other(recording):
    alone = gyrocal.of_sensor(recording, "st1")
    assert alone.attitudes.sensor is None
    assert alone.attitudes.t_s.size == (recording.attitudes.sensor == 0).sum()
    assert gyrocal.calibrate(alone).mountings is None
    with pytest.raises(InputError, match="no attitude sensor st3"):
        gyrocal.of_sensor(recording, "st3")


def test_what_knows_one_sensor_says_so(recording):
    with pytest.raises(InputError, match="one sensor in body axes"):
        recording.to_xarray()


def test_sensors_and_rows_must_fit_each_other(recording):
    for changes in ({"sensor": recording.attitudes.sensor + 1}, {"sensor": None}):
        with pytest.raises(InputError, match=r"sensor|repeats"):
            replace(recording, attitudes=replace(recording.attitudes, **changes))
