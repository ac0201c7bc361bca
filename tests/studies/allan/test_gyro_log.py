"""``gyrocal allan`` of a gyro without reference attitudes."""

import json

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from gyrocal import InputError, calibrate, load, save
from gyrocal.importing import import_gyro_log
from studies.cli.main import main


@pytest.fixture
def log(tmp_path):
    white = np.random.default_rng(1).normal(size=(3000, 3)) * 0.05
    frame = pd.DataFrame(white, columns=["gx", "gy", "gz"])
    frame.insert(0, "ms", 10 * np.arange(3000))
    frame.to_csv(tmp_path / "log.csv", index=False)
    return tmp_path / "log.csv"


def run(*words):
    return CliRunner().invoke(main, ["allan", *map(str, words)])


def test_a_csv_table_of_a_gyro_at_rest_is_enough(log, tmp_path):
    done = run(
        log, "--time", "ms:ms", "--gyro", "gx,gy,gz:deg/s", "--json", tmp_path / "a.json", "--report", tmp_path / "a.html"
    )
    assert done.exit_code == 0, done.output
    assert "Assumed: a gyro time tag is the start of its sample." in done.output
    for axis in json.loads((tmp_path / "a.json").read_text())["axes"].values():
        walk = axis["terms"]["angle random walk"]
        assert abs(walk["value"] - 0.05 * 0.1 * 60) < 4 * walk["sigma"]


def test_a_recording_without_references_shows_its_noise_and_is_not_calibrated(log, tmp_path):
    recording, _ = import_gyro_log(log, {"time": "ms:ms", "gyro": "gx,gy,gz:deg/s", "arw_deg_per_sqrt_s": 0.005})
    save(recording, tmp_path / "rec")
    with pytest.raises(InputError, match="neither attitude"):
        load(tmp_path / "rec")
    assert run(tmp_path / "rec").exit_code == 0
    assert load(tmp_path / "rec", without_references=True).gyro.arw == recording.gyro.arw
    with pytest.raises(InputError, match="no reference attitudes"):
        calibrate(recording)
    assert "for a CSV table" in str(run(tmp_path / "rec", "--time", "t:s").output)
