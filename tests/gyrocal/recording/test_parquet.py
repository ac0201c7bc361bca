"""Damage of a recording's tables is seen, wherever it is; replacing a recording is all or nothing."""

import errno
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gyrocal import InputError, Recording, load, save
from gyrocal.recording import parquet


def recording(seed=0, count=60):
    rng = np.random.default_rng(seed)
    rates, still = rng.normal(0.0, 1e-3, (count, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    return Recording.from_arrays(np.arange(count), rates, [0, 20, 40], still, sigma=1e-4, arw=1e-6, title=f"seed {seed}")


def test_random_damage_is_refused_or_changes_nothing(tmp_path):
    save(recording(), tmp_path)
    path, rng = tmp_path / "gyro.parquet", np.random.default_rng(7)
    whole, expected = path.read_bytes(), load(tmp_path).gyro
    refused = 0
    for place in rng.integers(0, len(whole), 250):
        damaged = bytearray(whole)
        damaged[place] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            found = load(tmp_path).gyro
        except InputError:
            refused += 1
        else:
            np.testing.assert_array_equal(found.rates, expected.rates)
            np.testing.assert_array_equal(found.t_s, expected.t_s)
    assert 150 < refused < 250


def test_a_wrong_column_under_a_right_checksum_is_seen(tmp_path):
    """What damage of the footer does: every page is whole, but another one is read."""
    path = tmp_path / "a.parquet"
    frame = pd.DataFrame({"t_s": [1.0, 2.0], "rate": [3.0, 4.0]})
    table = parquet.pa.Table.from_pandas(frame, preserve_index=False)
    stated = {parquet.CONTENT: parquet.hash_table(table)}
    swapped = table.select(["t_s", "t_s"]).rename_columns(["t_s", "rate"])
    parquet.pq.write_table(swapped.replace_schema_metadata(stated), path)
    with pytest.raises(ValueError, match="damaged"):
        parquet.read(path)
    parquet.pq.write_table(swapped, path)  # of another program, which states nothing
    assert list(parquet.read(path)["rate"]) == [1.0, 2.0]


@pytest.mark.parametrize("failing", [1, 2])
def test_a_recording_that_cannot_be_replaced_stays(tmp_path, monkeypatch, failing):
    save(recording(1), tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    calls = []

    def full(frame, file):
        calls.append(frame)
        if len(calls) == failing:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        parquet_write(frame, file)

    parquet_write = parquet.write
    monkeypatch.setattr(parquet, "write", full)
    with pytest.raises(OSError, match="No space") as caught:
        save(recording(2), tmp_path)
    assert caught.value.filename == str(tmp_path / ("gyro.parquet", "attitude.parquet")[failing - 1])
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_recording_that_stopped_halfway_is_none(tmp_path, monkeypatch):
    save(recording(1), tmp_path)
    real = os.replace

    def killed(source, target):
        if Path(target) == tmp_path / "attitude.parquet":
            raise KeyboardInterrupt
        real(source, target)

    monkeypatch.setattr(os, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        save(recording(2), tmp_path)
    with pytest.raises(InputError, match=r"recording\.toml: no such file"):
        load(tmp_path)
