"""Allan deviations of logs in which samples repeat."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from gyrocal import InputError, Recording, calibrate, load, save
from gyrocal.allan.terms import RANDOM_WALK
from gyrocal.importing import import_gyro_log
from studies.allan.analysis import estimate_noise_terms
from studies.allan.report import list_remarks
from studies.cli.main import main

NOISE, SAMPLE_S = np.deg2rad(0.05), 0.01


def build_rest(rates):
    """A recording of a body at rest with a reference at either end."""
    ends = np.array([0.0, len(rates) * SAMPLE_S])
    still = np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))
    tags = np.arange(len(rates)) * SAMPLE_S
    return Recording.from_arrays(tags, rates, ends, still, sigma=np.deg2rad(0.1), arw=NOISE * np.sqrt(SAMPLE_S))


def draw_white_noise(seed, count=9000):
    return np.random.default_rng(seed).normal(size=(count, 3)) * NOISE


@pytest.mark.parametrize("ratio", [1.25, 3])
def test_the_note_gives_the_angle_random_walk_of_a_gyro_that_is_read_too_often(ratio):
    white = draw_white_noise(round(100 * ratio))
    found = estimate_noise_terms(build_rest(white[(np.arange(len(white)) / ratio).astype(int)]))
    (note,) = [line for line in list_remarks(found) if "repeat the one before" in line]
    factor = float(re.search(r"angle random walk is (\S+) times", note)[1])
    for axis in found.axes:
        assert [one.term for one in axis.fit.estimates if one.seen] == [RANDOM_WALK]
        assert not axis.lines
        walk = axis.fit.estimate(RANDOM_WALK)
        assert abs(factor * walk.value - NOISE * np.sqrt(ratio * SAMPLE_S)) < 4 * factor * walk.sigma


@pytest.mark.parametrize("share", [0.002, 0.6])
def test_lost_samples_that_are_held_leave_the_angle_random_walk(share):
    rng = np.random.default_rng(round(1000 * share))
    white = draw_white_noise(7)
    fresh = rng.uniform(size=len(white)) > share
    fresh[0] = True
    held = white[np.maximum.accumulate(np.where(fresh, np.arange(len(white)), 0))]
    found = estimate_noise_terms(build_rest(held))
    for axis in found.axes:
        assert [one.term for one in axis.fit.estimates if one.seen] == [RANDOM_WALK]
        assert not axis.lines
        walk = axis.fit.estimate(RANDOM_WALK)
        assert abs(walk.value - NOISE * np.sqrt(SAMPLE_S)) < 4 * walk.sigma


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
