"""Even time tags from those of a host: ties, whole seconds, bursts, jitter, delays, lost samples and gaps."""

import numpy as np
import pandas as pd
import pytest

from gyrocal import InputError
from gyrocal.importing import validate_mapping
from gyrocal.importing.streams import read_streams
from gyrocal.importing.time_base import fit_even_times, is_uneven

ROWS = 6000
SAMPLE = 0.01
TRUE = SAMPLE * np.arange(ROWS)
rng = np.random.default_rng(3)
LONG_GAP = TRUE + np.where(np.arange(ROWS) >= 3000, 37.123, 0.0)
BASE = {"time": "t:s", "gyro": "x,y,z:rad/s", "quat": "w,a,b,c:body-to-world:scalar-first"}


@pytest.mark.parametrize(
    ("tags", "true", "bound"),
    [
        (np.repeat(TRUE[::8], 8), TRUE, 1e-6),
        (np.floor(TRUE + 0.3), TRUE + 0.3, 1e-3),
        (np.repeat(TRUE[9::10], 10) + np.tile(1e-4 * np.arange(10), ROWS // 10), TRUE + 9e-4, 1e-6),
        (TRUE + 0.3 * SAMPLE * rng.normal(size=ROWS), TRUE, 0.03),
        (TRUE + SAMPLE * rng.exponential(0.7, ROWS), TRUE, 0.08),
        (np.repeat(LONG_GAP[::10], 10), LONG_GAP, 1e-3),
    ],
    ids=["batches", "whole seconds", "bursts", "jitter", "late arrival", "gap and batches"],
)
def test_true_times_are_found(tags, true, bound):
    """The greatest error, in samples, of times whose tags are off by up to 100 samples."""
    assert is_uneven(tags)
    found = fit_even_times(tags)
    assert np.abs(found.t_s - true).max() < bound * SAMPLE
    assert found.drift_s == 0.0


def test_a_backlog_is_not_followed():
    """The first tenth of the rows was sent in a quarter of its time; the line of the others holds for them."""
    tags = TRUE + 0.2 * SAMPLE * np.random.default_rng(4).normal(size=ROWS)
    tags[:600] = tags[600] - 0.25 * (TRUE[600] - TRUE[:600])
    found = fit_even_times(tags)
    assert np.abs(found.t_s - TRUE).max() < 0.2 * SAMPLE
    assert "run off the line by 4.5 s in up to 11 % of the rows" in found.errors


@pytest.mark.parametrize("tags", [1.02 * TRUE, TRUE % 30, np.sqrt(TRUE)], ids=["another rate", "starts anew", "no line"])
def test_a_stated_rate_goes_before_the_tags(tags):
    kept = np.arange(ROWS) != 100  # a row without numbers keeps its place
    gyro = build_gyro(tags)
    gyro.loc[~kept, "x"] = np.nan
    found = read(gyro, rate_hz=100.0)
    np.testing.assert_allclose(np.diff(found.t_s), SAMPLE, atol=1e-9)
    assert found.t_s.size == ROWS
    assert found.assumed[0].startswith("the gyro's time tags do not follow the stated 100 Hz, which replaces them: moved by")


@pytest.mark.parametrize(
    "tags",
    [TRUE, TRUE + 0.05 * SAMPLE * rng.normal(size=ROWS), LONG_GAP, TRUE[rng.random(ROWS) > 0.05]],
    ids=["even", "small jitter", "gap", "lost samples"],
)
def test_even_tags_are_left_as_they_are(tags):
    assert not is_uneven(tags)


def build_gyro(tags, **columns):
    motion = np.sin(0.5 * np.arange(len(tags)) * SAMPLE)
    return pd.DataFrame({"t": tags, "x": motion, "y": -motion, "z": 0.5 * motion} | columns)


def read(gyro, **changes):
    attitude = pd.DataFrame({"t": np.arange(60.0), "w": 1.0, "a": 0.0, "b": 0.0, "c": 0.0})
    return read_streams(gyro, attitude, validate_mapping(BASE | changes, "mapping"))


def test_one_or_two_lost_samples_are_filled_and_a_gap_stays():
    kept = np.ones(ROWS, dtype=bool)
    kept[[100, 200, 201, 300, 301, 302]] = False
    gyro = build_gyro(TRUE)
    found = read(gyro[kept])
    assert found.t_s.size == ROWS - 3
    np.testing.assert_allclose(found.raw[200], gyro.loc[200, ["x", "y", "z"]].to_numpy(dtype=float), atol=1e-4)
    assert np.diff(found.t_s).max() == pytest.approx(4 * SAMPLE)
    assert any("3 gyro sample(s) are lost" in text for text in found.assumed)
    many = read(gyro[np.arange(ROWS) % 60 != 30])
    np.testing.assert_allclose(many.t_s, TRUE, atol=1e-9)
    assert many.assumed[0].startswith("1.7 % of the gyro rows: 100 gyro sample(s) are lost")


def test_sample_number_and_rate_make_even_times():
    kept = np.random.default_rng(5).random(ROWS) > 0.3
    tags = (TRUE + SAMPLE * np.random.default_rng(6).normal(size=ROWS))[kept]
    number = (65000 + np.arange(ROWS))[kept] % 65536
    found = read(build_gyro(tags, n=number), sample_number="n")
    nearest = SAMPLE * np.round(found.t_s / SAMPLE)
    assert np.abs(found.t_s - nearest).max() < 0.1 * SAMPLE
    np.testing.assert_allclose(found.t_s[[0, -1]], TRUE[kept][[0, -1]], atol=0.1 * SAMPLE)
    assert found.sample_s == pytest.approx(SAMPLE, rel=1e-4)
    stated = read(build_gyro(np.repeat(TRUE[::3000], 3000)), rate_hz=100.0)
    np.testing.assert_allclose(stated.t_s, TRUE, atol=1e-9)
    np.testing.assert_allclose(read(build_gyro(np.zeros(ROWS)), rate_hz=100.0).t_s, TRUE, atol=1e-9)
    with pytest.raises(InputError, match=r"sample_number: does not grow at row 5: 4, then 4"):
        read(build_gyro(TRUE, n=np.minimum(np.arange(ROWS), 4)), sample_number="n")


def test_several_gyros_in_one_table_are_refused_and_the_remedy_works():
    gyro = pd.concat([build_gyro(TRUE, imu=name, z=k) for k, name in enumerate(("left", "right", "top"))])
    gyro = gyro.sort_values("t", kind="stable")
    with pytest.raises(InputError, match=r"column imu \(left, right, top\) has time tags of its own: .* --rows imu:left"):
        read(gyro)
    np.testing.assert_array_equal(read(gyro, rows="imu:left").t_s, TRUE)
    with pytest.raises(InputError, match="rows: column imu has no 4; it has left, right, top"):
        read(gyro, rows="imu:4")
