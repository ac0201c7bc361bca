"""Round trip of a recording, and one clear line for each kind of bad input."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from gyrocal import InputError, calibrate, load, save
from tests.builders import piecewise_recording

PLAN = ((((0.001, 0, 0), 60.0),), (((0, 0.002, 0), 60.0),))


@pytest.fixture
def folder(tmp_path):
    save(piecewise_recording(PLAN), tmp_path / "rec")
    return tmp_path / "rec"


def test_round_trip(folder):
    original, back = piecewise_recording(PLAN), load(folder)
    np.testing.assert_array_equal(back.gyro.t_s, original.gyro.t_s)
    np.testing.assert_allclose(back.gyro.rates, original.gyro.rates, rtol=4e-16, atol=0)
    np.testing.assert_array_equal(back.attitudes.quaternions, original.attitudes.quaternions)
    np.testing.assert_allclose(back.attitudes.sigma, original.attitudes.sigma, rtol=4e-16)
    assert back.intervals == original.intervals
    assert (back.title, back.epoch, back.time_scale, back.orbit) == (original.title, original.epoch, "UTC", None)


def test_the_axis_that_flies_forward_and_that_noise_was_estimated_are_kept(folder):
    recording = load(folder)
    first, *others = recording.intervals
    save(dataclasses.replace(recording, intervals=(dataclasses.replace(first, forward="-x"), *others)), folder)
    assert [interval.forward for interval in load(folder).intervals] == ["-x", *[None] * len(others)]
    with pytest.raises(InputError, match=r"interval m1: forward \+z must be one of \+x, -x, \+y, -y, none"):
        dataclasses.replace(recording, intervals=(dataclasses.replace(first, forward="+z"), *others))
    assert not recording.gyro.arw_estimated
    assert not recording.attitudes.sigma_estimated
    gyro = dataclasses.replace(recording.gyro, arw_estimated=True, arw_degrees=377.5)
    save(dataclasses.replace(recording, gyro=gyro), folder)
    assert (load(folder).gyro.arw_estimated, load(folder).attitudes.sigma_estimated) == (True, False)
    assert (load(folder).gyro.arw_degrees, load(folder).attitudes.sigma_degrees) == (377.5, np.inf)


def edit_table(name, change):
    def apply(folder):
        frame = pd.read_parquet(folder / f"{name}.parquet")
        change(frame).to_parquet(folder / f"{name}.parquet", index=False)

    return apply


def edit_header(old, new):
    def apply(folder):
        text = (folder / "recording.toml").read_text()
        assert old in text
        (folder / "recording.toml").write_text(text.replace(old, new))

    return apply


def set_value(row, column, value):
    def change(frame):
        frame.loc[row, column] = value
        return frame

    return change


BAD_INPUT = {
    "wrong unit": (
        edit_table("gyro", lambda f: f.rename(columns={"rate_x_deg_s": "rate_x_rad_s"})),
        "rate_x_deg_s is missing; found rate_x_rad_s",
    ),
    "non-unit quaternion": (edit_table("attitude", set_value(1, "q4", 2.0)), "row 1 has norm"),
    "zero sigma": (edit_table("attitude", set_value(1, "sigma_y_deg", 0.0)), "sigma in row 1 is not within"),
    "time backwards": (edit_table("gyro", set_value(9, "t_s", 1.0)), "backwards or repeats at row 9"),
    "wrong sample_s": (edit_header("sample_s = 0.5", "sample_s = 0.6"), "is sample_s right"),
    "too close samples": (edit_table("gyro", set_value(5, "t_s", 2.1)), "rows 4 and 5 are only"),
    "huge rate": (edit_table("gyro", set_value(5, "rate_x_deg_s", 1e100)), "beyond 100000 deg/s"),
    "interval backwards": (edit_header("stop_s = 60.0", "stop_s = -1.0"), "not after start_s"),
    "two tables": (lambda folder: (folder / "gyro.csv").write_text("t_s\n"), "both gyro.parquet and gyro.csv are there"),
    "overlapping intervals": (edit_header("start_s = 360.0", "start_s = 50.0"), "m1 and m2 overlap"),
    "reference outside every interval": (
        edit_table("attitude", lambda f: pd.concat([f, f.tail(1).assign(t_s=900.0)])),
        "row 4: reference at t_s = 900.0 lies outside every interval",
    ),
    "unknown key": (edit_header('kind = "rate"', 'kind = "rate"\nfilter = 3'), "gyro.filter: is not known"),
    "singular G": (
        edit_header("apriori_G = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]", "apriori_G = [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]"),
        "must not lie in one plane",
    ),
    "no recording.toml": (lambda folder: (folder / "recording.toml").unlink(), "no such file; a recording is a folder"),
    "gyro gap": (edit_table("gyro", lambda f: f.drop(index=range(10, 20))), "m1: no gyro samples between 5.0 s and 10.0 s"),
    "rates off by 2 deg/s": (
        edit_table("gyro", lambda f: f.assign(rate_y_deg_s=f.rate_y_deg_s + 2.0)),
        "too large to linearise; are the rates in deg/s",
    ),
}


@pytest.mark.parametrize("kind", BAD_INPUT)
def test_bad_input_ends_in_one_line_and_status_2(kind, folder, run_cli):
    damage, text = BAD_INPUT[kind]
    damage(folder)
    result = run_cli("calibrate", str(folder))
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("gyrocal: ")
    assert text in result.stderr
    with pytest.raises(Exception, match=r".") as caught:  # the library raises the same message
        calibrate(load(folder))
    assert str(caught.value) in result.stderr


def test_correlations_are_three_columns_of_a_covariance(folder):
    (folder / "attitude.parquet").unlink()
    table = piecewise_recording(PLAN).to_frame("attitude").assign(rho_xy=0.9, rho_xz=0.9, rho_yz=0.9)
    for frame, message in (
        (table.drop(columns="rho_xz"), "rho_xy, rho_xz, rho_yz go together"),
        (table.assign(rho_yz=-0.9), "correlations in row 0"),
    ):
        frame.to_csv(folder / "attitude.csv", index=False)
        with pytest.raises(InputError, match=message):
            load(folder)
    table.to_csv(folder / "attitude.csv", index=False)
    read = load(folder).attitudes
    D, s = read.build_error_axes(), read.sigma
    np.testing.assert_allclose((D * s[:, None] ** 2) @ D.transpose(0, 2, 1), read.compute_covariance(), atol=1e-20)
    save(load(folder), folder.parent / "again")
    np.testing.assert_allclose(load(folder.parent / "again").attitudes.correlation, read.correlation, rtol=1e-12)
