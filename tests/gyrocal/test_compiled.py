"""The cache of compiled code: never of other sources, never damaged, never in the way."""

import hashlib
import importlib
import re
import sys
import tempfile
from pathlib import Path

import numba
import pytest

from gyrocal import jit_cache
from tests import ROOT

KERNEL = """
from gyrocal.jit_cache import compile_cached
from {package}.constants import FACTOR

@compile_cached
def scaled(x):
    return FACTOR * x
"""


@pytest.fixture
def started(tmp_path, monkeypatch):
    """A function that changes the constant of a small package, starts afresh as a new process does, and returns the kernel."""
    package = f"kernels_{tmp_path.name.rpartition('-')[2]}"
    folder = tmp_path / package
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "kernel.py").write_text(KERNEL.format(package=package))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.syspath_prepend(tmp_path)

    def start(factor):
        (folder / "constants.py").write_text(f"FACTOR = {factor}\n")
        for name in [name for name in sys.modules if name.startswith(package)]:
            del sys.modules[name]
        jit_cache.find_cache_folder.cache_clear()
        importlib.invalidate_caches()
        return importlib.import_module(f"{package}.kernel").scaled

    yield start
    jit_cache.find_cache_folder.cache_clear()


def entries(kernel):
    return sorted(path for path in Path(kernel.stats.cache_path).iterdir())


def test_a_constant_of_another_file_is_seen_and_what_is_stale_goes(started):
    kernel = started(3.0)
    assert kernel(2.0) == 6.0
    first = Path(kernel.stats.cache_path)
    again = started(3.0)
    assert again(2.0) == 6.0
    assert sum(again.stats.cache_hits.values()) == 1
    changed = started(5.0)
    assert changed(2.0) == 10.0
    assert [path.name for path in first.parent.iterdir()] == [Path(changed.stats.cache_path).name]


def test_a_damaged_entry_is_compiled_again(started):
    kernel = started(3.0)
    assert kernel(2.0) == 6.0
    (entry,) = entries(kernel)
    whole = entry.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    signature = kernel.signatures[0]
    for damaged in (b"", whole[:-1], whole[:40], bytes(flipped), b"junk" * 100, flipped[:32] + b"c"):
        entry.write_bytes(damaged)
        assert kernel._cache.load_overload(numba.types.void(*signature), kernel.targetctx) is None
    again = started(3.0)
    assert again(2.0) == 6.0
    assert entry.read_bytes()[:32] == hashlib.sha256(entry.read_bytes()[32:]).digest()


def test_threads_change_no_code_and_other_settings_may(started, monkeypatch):
    """joblib tells its workers how many threads they have, which would else compile all anew."""
    kernel = started(3.0)
    assert kernel(2.0) == 6.0
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    again = started(3.0)
    assert again(2.0) == 6.0
    assert sum(again.stats.cache_hits.values()) == 1
    monkeypatch.setenv("NUMBA_FASTMATH", "1")
    other = started(3.0)
    assert other(2.0) == 6.0
    assert sum(other.stats.cache_hits.values()) == 0


def test_sources_that_change_under_a_process_are_not_taken_for_what_it_runs(started, tmp_path):
    kernel = started(3.0)
    (constants,) = tmp_path.rglob("constants.py")
    constants.write_text("FACTOR = 5.0\n")
    assert kernel(2.0) == 6.0
    assert entries(kernel) == []


def test_a_folder_that_cannot_be_written_is_replaced(started, tmp_path, monkeypatch):
    started(3.0)
    (folder,) = tmp_path.glob("kernels_*")
    for path in (folder / "__pycache__").iterdir():
        path.rmdir()
    (folder / "__pycache__").rmdir()
    (folder / "__pycache__").write_text("in the way")
    monkeypatch.setattr(numba.config, "CACHE_DIR", "/dev/null/a")
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null/b")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    kernel = started(3.0)
    assert kernel(2.0) == 6.0
    (private,) = tmp_path.glob("gyrocal-*")
    assert Path(kernel.stats.cache_path).is_relative_to(private)
    private.chmod(0o777)  # others could put code there
    kernel = started(3.0)
    assert kernel.stats.cache_path is None
    assert kernel(2.0) == 6.0


@pytest.mark.parametrize("edited", range(len(jit_cache.PACKAGE_LAYERS)))
def test_an_edit_changes_the_hash_of_its_layer_and_of_those_above(edited, tmp_path, monkeypatch):
    for layer in jit_cache.PACKAGE_LAYERS:
        (tmp_path / layer).write_text("")
    monkeypatch.setattr(jit_cache, "_list_sources", lambda package: iter([tmp_path / package]))
    before = [jit_cache.hash_sources(layer) for layer in jit_cache.PACKAGE_LAYERS]
    (tmp_path / jit_cache.PACKAGE_LAYERS[edited]).write_text("FACTOR = 5.0")
    after = [jit_cache.hash_sources(layer) for layer in jit_cache.PACKAGE_LAYERS]
    assert [a != b for a, b in zip(after, before, strict=True)] == [k >= edited for k in range(len(jit_cache.PACKAGE_LAYERS))]


def test_every_compiled_function_is_kept_this_way():
    raw = re.compile(r"numba\.(njit|jit|vectorize|guvectorize)\(")
    found = [
        path for layer in jit_cache.PACKAGE_LAYERS for path in (ROOT / layer).rglob("*.py") if raw.search(path.read_text())
    ]
    assert found == [ROOT / "gyrocal" / "jit_cache.py"]
