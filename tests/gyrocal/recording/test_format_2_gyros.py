"""Folders of format 2 with more gyros than three are joined when they are loaded, or refused."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from gyrocal import InputError, load, save
from gyrocal.recording.parts import build_empty_attitudes
from tests.builders import piecewise_recording

SKEWED = np.array([[1, 0, 0], [0, 1, 0], [0.1, 0, 0.995], [0.6, 0.64, 0.48], [0.0, 0.8, -0.6]])  # of no symmetry
NAMES = ("1", "2", "3", "4", "5")
SWITCHED = {"m2": ("1", "2", "4", "5"), "m5": ("3", "4", "5")}


def write_folder(folder, switched=None, axes=SKEWED, arw=0.0, offset=0.0):
    """Write a recording of the gyros along some axes; of one that was off the table holds nothing. Return that of three."""
    body = piecewise_recording(arw=arw)
    save(body, folder)
    names = NAMES[: len(axes)]
    raw = body.gyro.rates @ axes.T + offset
    text = (folder / "recording.toml").read_text().replace("format = 1", "format = 2")
    G = np.linalg.pinv(axes).tolist()
    text = text.replace(
        "apriori_G = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]", f"names = {list(names)}\napriori_G = {G}"
    )
    for one in body.intervals:
        on = (switched or {}).get(one.name)
        if on is not None:
            inside = (body.gyro.t_s >= one.start_s) & (body.gyro.t_s < one.stop_s)
            raw[np.ix_(inside, np.array([name not in on for name in names]))] = np.nan
            text = text.replace(f'name = "{one.name}"', f'name = "{one.name}"\ngyros = {list(on)}')
    (folder / "recording.toml").write_text(text)
    table = pd.DataFrame(np.rad2deg(raw), columns=[f"rate_{name}_deg_s" for name in names])
    (folder / "gyro.parquet").unlink()
    table.assign(t_s=body.gyro.t_s).to_csv(folder / "gyro.csv", index=False)
    return body


@pytest.mark.parametrize("switched", [None, SWITCHED], ids=["all on", "switched"])
def test_more_gyros_are_joined_interval_by_interval(tmp_path, switched):
    body = write_folder(tmp_path, switched, arw=1e-6)
    found = load(tmp_path)
    np.testing.assert_allclose(found.gyro.rates, body.gyro.rates, atol=1e-15)
    np.testing.assert_array_equal(found.gyro.apriori_G, np.eye(3))
    assert found.intervals == body.intervals
    power = np.trace(np.linalg.inv(SKEWED.T @ SKEWED)) / 3
    if switched is None:
        assert found.gyro.arw == pytest.approx(1e-6 * np.sqrt(power))
    else:
        assert found.gyro.arw > 1e-6 * np.sqrt(power)
    save(found, tmp_path / "again")
    assert (tmp_path / "again" / "recording.toml").read_text().startswith("format = 1\n")


def test_three_named_gyros_stay_as_they_are(tmp_path):
    body = write_folder(tmp_path, axes=SKEWED[:3])
    found = load(tmp_path)
    np.testing.assert_allclose(found.gyro.rates, body.gyro.rates @ SKEWED[:3].T, atol=1e-15)
    np.testing.assert_allclose(found.gyro.apriori_G @ SKEWED[:3], np.eye(3), atol=1e-14)


@pytest.mark.parametrize(
    ("switched", "words"),
    [
        ({"m3": ("1", "2")}, "interval m3: row .* has fewer than three gyros that see all axes .* import csv --gyros"),
        ({"m3": ("1", "2", "3", "7")}, "interval m3: no gyro 7; there are 1, 2, 3, 4, 5"),
    ],
)
def test_sets_that_do_not_measure_all_directions_are_refused(tmp_path, switched, words):
    write_folder(tmp_path, switched)
    with pytest.raises(InputError, match=words):
        load(tmp_path)


def test_a_recording_of_other_than_three_rates_or_without_references_is_refused():
    one = piecewise_recording()
    for changes, words in (
        ({"gyro": {"rates": one.gyro.rates @ SKEWED.T}}, "join_gyros makes three of more gyros"),
        ({"gyro": {"rates": np.full(one.gyro.rates.shape, np.nan)}}, "finite"),
        ({"gyro": {"apriori_G": np.ones((3, 3))}}, "must not lie in one plane"),
        ({"attitudes": vars(build_empty_attitudes())}, "attitude: no rows"),
    ):
        with pytest.raises(InputError, match=words):
            replace(one, **{name: replace(getattr(one, name), **values) for name, values in changes.items()})
