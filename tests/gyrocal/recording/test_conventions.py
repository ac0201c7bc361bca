"""What numbers on file mean, by files made by hand: a mistake that writing and reading share would come back as it was."""

import numpy as np
import pandas as pd
import pytest

import gyrocal
from gyrocal.recording import sensor_tables

HEADER = """
format = 1
title = "by hand"
epoch = "2000-01-01T00:00:00"
time_scale = "UTC"

[gyro]
sample_s = 1.0
kind = "rate"
arw_deg_per_sqrt_s = 0.18
apriori_G = [[1.0, 0.2, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
apriori_bias_deg_s = [0.0, 0.36, 0.0]

[attitude]
maps = "inertial to body"
quaternion = "scalar last"

[[interval]]
name = "one"
activity = ""
start_s = 0.0
stop_s = 2.0
"""
DEG = np.pi / 180


@pytest.fixture
def by_hand(tmp_path):
    (tmp_path / "recording.toml").write_text(HEADER)
    (tmp_path / "gyro.csv").write_text("t_s,rate_x_deg_s,rate_y_deg_s,rate_z_deg_s\n0,1,2,3\n1,4,5,6\n")
    rows = "0,0.6,0,0,0.8,0.01,0.02,0.03\n2,0,0,-0.28,0.96,0.04,0.05,0.06\n"
    (tmp_path / "attitude.csv").write_text("t_s,q1,q2,q3,q4,sigma_x_deg,sigma_y_deg,sigma_z_deg\n" + rows)
    return tmp_path


def test_what_is_read(by_hand):
    found = gyrocal.load(by_hand)
    np.testing.assert_allclose(found.gyro.rates, DEG * np.array([[1, 2, 3], [4, 5, 6]]), rtol=1e-14)
    np.testing.assert_array_equal(found.attitudes.quaternions, [[0.6, 0, 0, 0.8], [0, 0, -0.28, 0.96]])  # scalar last
    np.testing.assert_allclose(found.attitudes.sigma, DEG * np.array([[0.01, 0.02, 0.03], [0.04, 0.05, 0.06]]), rtol=1e-14)
    assert found.gyro.arw == pytest.approx(np.pi / 1000, rel=1e-14)
    np.testing.assert_allclose(found.gyro.apriori_bias, [0, np.pi / 500, 0], rtol=1e-14)
    assert found.gyro.apriori_G[0, 1] == 0.2  # rows are body axes


def test_a_quaternion_written_with_seven_digits_is_one_and_with_five_is_none(by_hand):
    path = by_hand / "attitude.csv"
    text = path.read_text()
    path.write_text(text.replace("0.6,0,0,0.8,", "0.6,0,0,0.8000004,"))
    assert gyrocal.load(by_hand).attitudes.quaternions[0, 3] == 0.8000004
    path.write_text(text.replace("0.6,0,0,0.8,", "0.6,0,0,0.80001,"))
    with pytest.raises(gyrocal.InputError, match=r"row 0 has norm 1\.000008"):
        gyrocal.load(by_hand)


def test_penetration_angles_are_in_degrees():
    columns = {f"penetration_{i}_deg": [45.0] for i in range(1, 5)} | {f"used_{i}": [True] for i in range(1, 5)}
    tables = sensor_tables.read({"earth_sensor": pd.DataFrame({"t_s": [0.0], **columns})})
    np.testing.assert_allclose(tables.earth.angles, np.pi / 4, rtol=1e-14)
    np.testing.assert_allclose(sensor_tables.build_sensor_frames(tables)["earth_sensor"]["penetration_1_deg"], 45.0, rtol=1e-14)
