"""Recordings as CSV tables, and back."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import simulator
from gyrocal import InputError
from gyrocal.importing import build, column_mapping, csv_files, import_csv, load_mapping, streams
from tests.gyrocal.importing import mems_log


@pytest.fixture(scope="module")
def imported():
    log = mems_log.log(np.random.default_rng(31), seconds=60.0)
    made = column_mapping.validate_mapping(
        {"time": "timestamp_ms:ms", "gyro": "gx,gy,gz:deg/s", "quat": "qw,qx,qy,qz:body-to-world", "title": 'a "log"'}, "here"
    )
    return build.import_streams(streams.read_streams(log.gyro, log.attitude, made), made).recording


def back(folder):
    """The recording that an import makes of what was exported to a folder."""
    read = column_mapping.validate_mapping(load_mapping(folder / "mapping.toml"), "mapping")
    return import_csv(folder / "gyro.csv", folder / "attitude.csv", mapping=read).recording


def test_references_a_turn_apart_come_back_whole_and_refuse_a_wrong_mapping(tmp_path):
    source = simulator.simulate(simulator.override(simulator.load("trmm"), {"gyro.sample_s": 2.0}), seed=1)
    csv_files.write_csv(source, tmp_path)
    again = back(tmp_path)
    assert again.intervals == source.intervals
    np.testing.assert_allclose(again.attitudes.t_s, source.attitudes.t_s, rtol=0, atol=1e-8)
    np.testing.assert_allclose(again.attitudes.quaternions, source.attitudes.quaternions, rtol=0, atol=1e-15)
    read = load_mapping(tmp_path / "mapping.toml")
    for wrong in ({"gyro": read["gyro"].replace("deg/s", "rad/s")}, {"gyro": "rate_y,rate_x,rate_z:deg/s"}):
        with pytest.raises(InputError, match="do not fit each other"):
            import_csv(tmp_path / "gyro.csv", tmp_path / "attitude.csv", **(read | wrong))


@pytest.mark.parametrize(
    ("scale", "epoch", "columns"),
    [
        ("UTC", "2023-11-15T00:13:20.125+02:00", ["unix_ns"]),
        ("GPS", "2023-11-14T22:13:38.125", ["gps_week", "gps_second"]),
        ("trial", "2000-01-01T00:00:00", ["t_s"]),
    ],
)
def test_tables_are_read_as_the_recording_that_they_are_of(imported, tmp_path, scale, epoch, columns):
    source = replace(imported, time_scale=scale, epoch=epoch)
    csv_files.write_csv(source, tmp_path)
    table = pd.read_csv(tmp_path / "gyro.csv")
    assert list(table.columns)[: len(columns)] == columns
    if scale == "UTC":
        assert table["unix_ns"][0] == 1_700_000_000_125_000_000 + round(1e9 * source.gyro.t_s[0])
    if scale == "GPS":  # 22:13:38.125 on Tuesday of week 2288
        assert (table["gps_week"][0], table["gps_second"][0]) == (2288, 2 * 86400 + 80018.125 + source.gyro.t_s[0])
    again = back(tmp_path)
    shift = 0.125 if scale in ("UTC", "GPS") else 0.0  # dated times are since the whole second
    np.testing.assert_allclose(again.gyro.rates, source.gyro.rates, rtol=0, atol=1e-15)
    np.testing.assert_allclose(again.gyro.t_s - shift, source.gyro.t_s, rtol=0, atol=1e-8)
    np.testing.assert_allclose(again.attitudes.t_s - shift, source.attitudes.t_s, rtol=0, atol=1e-8)
    np.testing.assert_allclose(again.attitudes.quaternions, source.attitudes.quaternions, rtol=0, atol=1e-15)
    np.testing.assert_allclose(again.attitudes.sigma, source.attitudes.sigma, rtol=1e-12)
    np.testing.assert_allclose(again.gyro.apriori_bias, source.gyro.apriori_bias, rtol=1e-12)
    assert again.gyro.arw == pytest.approx(source.gyro.arw, rel=1e-12)
    assert again.title == 'a "log"'
