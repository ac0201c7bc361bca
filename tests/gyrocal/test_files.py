"""The one way in which files are written: whole or not at all, and never in place of what is no regular file."""

import os
import resource
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from gyrocal import InputError, files, save
from gyrocal.files import open_replacement
from studies.cli.options import check_writable
from studies.montecarlo.files import write_csv, write_json, write_parquet
from studies.report import panels
from tests.gyrocal.recording.test_parquet import recording


def write(path, data=b"new"):
    with open_replacement(path) as file:
        file.write(data)


def test_half_a_file_is_never_seen_and_nothing_stays_after_an_error(tmp_path):
    path = tmp_path / "a.json"
    path.write_bytes(b"old")

    def interrupted():
        with open_replacement(path) as file:
            file.write(b"ne")
            file.flush()
            assert path.read_bytes() == b"old"
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.json"]


def test_what_lies_at_the_temporary_name_is_neither_followed_nor_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(files.secrets, "token_hex", lambda count: "0")
    victim = tmp_path / "victim"
    victim.write_bytes(b"of somebody else")
    trap = tmp_path / "a.json.0.tmp"
    trap.symlink_to(victim)
    with pytest.raises(FileExistsError) as caught:
        write(tmp_path / "a.json")
    assert caught.value.filename == str(tmp_path / "a.json")
    assert victim.read_bytes() == b"of somebody else"
    assert trap.is_symlink()


@pytest.mark.parametrize("to", ["there/a.json", "/dev/null"])
def test_a_link_is_neither_written_through_nor_replaced(tmp_path, to):
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "a.json").write_bytes(b"of somebody else")
    link = tmp_path / "link.json"
    link.symlink_to(to)
    with pytest.raises(OSError, match="symbolic link") as caught:
        write(link)
    assert caught.value.filename == str(link)
    assert os.readlink(link) == to
    assert (tmp_path / "there" / "a.json").read_bytes() == b"of somebody else"
    with pytest.raises(InputError, match=r"link\.json: is a symbolic link"):
        check_writable(link)


@pytest.mark.parametrize("name", ["a.json", "a.csv", "a.parquet", "a.svg", "rec/gyro.parquet"])
def test_every_output_that_does_not_fit_names_its_file_and_leaves_the_old_one(tmp_path, name, monkeypatch):
    """A limit to the size of a file, in place of a full disk: the system refuses to write on."""
    path, table = tmp_path / name, pd.DataFrame({"x": np.random.default_rng(0).normal(size=20_000)})
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"old")
    writers = {
        "a.json": lambda: write_json(path, table["x"].tolist()),
        "a.csv": lambda: write_csv(path, table),
        "a.parquet": lambda: write_parquet(path, table),
        "a.svg": lambda: panels.save(figure, path),
        "rec/gyro.parquet": lambda: save(recording(count=20_000), path.parent),
    }
    figure = Figure()
    figure.subplots().plot(table["x"][:2000])
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # modules imported now would leave broken files
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        with pytest.raises(OSError, match="File too large") as caught:
            writers[name]()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert caught.value.filename == str(path)
    assert path.read_bytes() == b"old"
    assert os.listdir(path.parent) == [path.name]


def test_standard_output_is_written_to():
    code = (
        "from gyrocal.files import open_replacement\nprint('before', flush=True)\n"
        "with open_replacement('/dev/stdout') as f: f.write(b'new')"
    )
    output = subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.PIPE).stdout
    assert output == b"before\nnew"
    assert os.path.islink("/dev/stdout")
