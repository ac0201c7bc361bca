"""What is refused before it is read: pipes, devices, and tables that claim more than a recording can be."""

import os

import pandas as pd
import pytest

from gyrocal import InputError, load, save
from gyrocal.recording import parquet, tables
from tests.builders import piecewise_recording

FILES = ("recording.toml", "gyro.parquet", "attitude.parquet", "housekeeping.parquet")


@pytest.fixture
def folder(tmp_path):
    recording = piecewise_recording(series_s=100.0)
    save(recording, tmp_path)
    pd.DataFrame({"t_s": recording.gyro.t_s, "gyro_temperature_c": 20.0}).to_parquet(tmp_path / "housekeeping.parquet")
    return tmp_path


def refusal(folder):
    with pytest.raises(InputError) as caught:
        load(folder)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")], ids=["pipe", "device"])
@pytest.mark.parametrize("name", FILES)
def test_a_pipe_or_a_device_is_refused_and_not_waited_for(name, make, folder):
    (folder / name).unlink()
    make(folder / name)
    assert refusal(folder).startswith(f"{folder / name}: not a regular file")


def test_rows_are_counted_before_they_are_read(folder, monkeypatch):
    rows = len(pd.read_parquet(folder / "gyro.parquet"))
    monkeypatch.setattr(tables, "MOST_VALUES", 4 * rows)
    load(folder)
    monkeypatch.setattr(tables, "MOST_VALUES", 4 * rows - 1)
    monkeypatch.setattr(parquet, "read", lambda *arguments, **options: pytest.fail("it was read"))
    assert f"gyro.parquet: {rows} rows of 4 columns are more than can be read" in refusal(folder)
