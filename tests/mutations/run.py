"""Tests of a faulty copy of the tree, each in a fresh process that compiles anew what the fault may change.

The copy stays at one place, so that layers below the faulty one keep the code that was compiled of their sources (see
`gyrocal.compiled`: the place and the sources are in its key); that of the faulty package and of those above it is removed
before each run. Processes are forked from one that has loaded the libraries, and nothing of the project.
"""

import importlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests import ROOT, SHARED
from tests.mutations.fault import Fault

LAYERS = ("gyrocal", "simulator", "diagnosis", "studies")
OWN = (*LAYERS, "benchmarks", "tests")
LIBRARIES = ("scipy.stats", "scipy.signal", "scipy.optimize", "scipy.ndimage", "numba", "pandas", "pydantic", "click.testing")
OPTIONS = ("-x", "-q", "-p", "no:cacheprovider", "--no-header")
LONGEST_S = 900.0  # of a run; a fault may loop for ever
SEEN = re.compile(r"^(?:FAILED|ERROR) (\S+::.+?|\S+)(?: - .*)?$", re.MULTILINE)


@dataclass(frozen=True)
class Ran:
    """How a run of tests ended.

    Attributes
    ----------
    by : the first test that failed; empty if none did
    seconds : how long it took
    """

    by: str
    seconds: float


def copied(root: Path) -> Path:
    """A copy of what is versioned of this tree, changes included, beside a link to the recordings it may test with."""
    tree = root / "tree"
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"], cwd=ROOT, capture_output=True, check=True
    )
    for name in listed.stdout.decode().split("\0"):
        if name and (ROOT / name).is_file():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, tree / name)
    if SHARED.exists():
        (root / SHARED.name).symlink_to(SHARED.resolve())
    return tree


def commit() -> str:
    """Commit that the copy is of, with "+changes" if sources or tests are not as committed."""
    asked = ["rev-parse", "--short=10", "HEAD"], ["status", "--porcelain", "--", ":/", ":(top,exclude)results"]
    head, status = (subprocess.run(["git", *one], cwd=ROOT, capture_output=True, text=True, check=True).stdout for one in asked)
    return head.strip() + ("+changes" if status.strip() else "")


@contextmanager
def faulty(tree: Path, fault: Fault) -> Iterator[None]:
    """The tree with a fault, and nothing compiled that could have been made without it."""
    path = tree / fault.file
    before = path.read_text(encoding="utf-8")
    path.write_text(fault.put_into(tree), encoding="utf-8")
    _forget(tree, fault.file)
    try:
        yield
    finally:
        path.write_text(before, encoding="utf-8")
        _forget(tree, fault.file)


def _forget(tree: Path, file: str) -> None:
    """Remove what was compiled of a file, by Python or by numba, also in the layers above."""
    path, package = tree / file, file.partition("/")[0]
    for one in path.parent.glob(f"__pycache__/{path.stem}.*.pyc"):
        one.unlink()
    for layer in LAYERS[LAYERS.index(package) :]:
        for folder in (tree / layer / "__pycache__").glob(f"compiled-*-{layer}-*"):
            shutil.rmtree(folder)


def tested(tree: Path, tests: Sequence[str]) -> Ran:
    """Run tests of a tree until one fails.

    Raises
    ------
    RuntimeError
        No test was run at all.
    """
    begun, output = time.monotonic(), tree.parent / "output"
    sys.stdout.flush()
    process = os.fork()
    if not process:
        _child(tree, tests, output)
    status = None
    while status is None and time.monotonic() - begun < LONGEST_S:
        time.sleep(0.05)
        ended, code = os.waitpid(process, os.WNOHANG)
        status = os.waitstatus_to_exitcode(code) if ended else None
    if status is None:
        with suppress(ProcessLookupError):
            os.killpg(process, signal.SIGKILL)
        os.waitpid(process, 0)
        return Ran(f"no end within {LONGEST_S:g} s", time.monotonic() - begun)
    said = output.read_text(encoding="utf-8", errors="replace")
    if status == pytest.ExitCode.OK:
        return Ran("", time.monotonic() - begun)
    found = SEEN.search(said)
    ended_by_a_test = status in (pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.INTERRUPTED) and found
    if not ended_by_a_test and status >= 0:
        raise RuntimeError(f"pytest ended with {status}:\n{said[-3000:]}")
    return Ran(found[1] if found else f"signal {-status}", time.monotonic() - begun)


def _child(tree: Path, tests: Sequence[str], output: Path) -> None:
    """In the forked process: forget this program's own modules and run the tree's tests instead."""
    code: int = pytest.ExitCode.INTERNAL_ERROR
    try:
        os.setsid()
        os.chdir(tree)
        out = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(out, 1)
        os.dup2(out, 2)
        for name in [name for name in sys.modules if name.partition(".")[0] in OWN]:
            del sys.modules[name]
        sys.path[:] = [str(tree), *(path for path in sys.path if path and Path(path).resolve() != ROOT)]
        sys.path_importer_cache.clear()
        os.environ.pop("NUMBA_CACHE_DIR", None)
        os.environ["PYTHONPATH"] = str(tree)
        code = pytest.main([*OPTIONS, *tests])
    finally:
        sys.stdout.flush()
        os._exit(code)


def loaded() -> None:
    """Load what every run needs, once, and make sure that nothing of the project is."""
    for name in LIBRARIES:
        importlib.import_module(name)
    own = [name for name in sys.modules if name.partition(".")[0] in LAYERS]
    if own:
        raise RuntimeError(f"{own[0]} is loaded already, and would not be the copy's")
