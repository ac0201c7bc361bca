"""The benchmark compares like with like, and writes all it promises. How fast anything is, is not tested."""

import json
import subprocess
import sys

import numpy as np
import pytest

from benchmarks import c_kernel, mission_loop, references
from benchmarks.measure import GOALS, LEFT_OUT
from benchmarks.streams import compute_disagreement, run_packed
from gyrocal import Arcs, GyroParameters
from tests import ROOT

RNG = np.random.default_rng(7)
PARAMETERS = GyroParameters(np.eye(3) + 1e-3 * RNG.normal(size=(3, 3)), 1e-5 * RNG.normal(size=3))
needs_compiler = pytest.mark.skipif(c_kernel.find_compiler() is None, reason="no C compiler")


@pytest.fixture(scope="module")
def arcs():
    """Two arcs of very different length; no length is a multiple of a tile."""
    n = 1531
    raw = np.cumsum(RNG.normal(size=(n, 3)), axis=0) * 3e-4
    return Arcs(raw, RNG.uniform(0.2, 0.5, n), np.arange(n), np.array([0, 1400]), np.array([1400, n]), np.array([0, 1]))


@needs_compiler
def test_c_agrees_with_the_kernel(arcs, tmp_path):
    expected = run_packed(arcs, PARAMETERS)
    call = c_kernel.prepare_call(c_kernel.build(tmp_path), c_kernel.pack(arcs), PARAMETERS.G, PARAMETERS.bias)
    assert compute_disagreement(call(), expected) < 1e-12
    assert compute_disagreement(call(), expected) < 1e-12, "a second call starts afresh"


def test_textbook_loop_agrees_with_the_kernel(arcs):
    expected = run_packed(arcs, PARAMETERS)
    R, Theta = references.propagate_textbook(arcs, PARAMETERS)
    np.testing.assert_allclose(R, expected.R, rtol=0, atol=1e-12)
    np.testing.assert_allclose(Theta, expected.Theta, rtol=0, atol=1e-12 * np.abs(expected.Theta).max())


@pytest.mark.long
def test_a_quick_run_writes_every_key(tmp_path):
    """Also none of the machine's folders."""
    command = [sys.executable, "-m", "benchmarks", "--quick", "--out", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "benchmark.json").read_text()
    assert not any(path in text for path in (str(ROOT), str(tmp_path), sys.executable))
    document = json.loads(text)
    for name, value in document["ratios"].items():
        assert (value is None) == (name in document["reasons"])
    assert document["cpu_ms_per_case"] > 0
    assert set(document["goals"]) == set(GOALS)
    assert document["reasons"]["kernel_vs_c_4800k"] == LEFT_OUT or c_kernel.find_compiler() is None


def test_compiled_and_plain_fly_the_same():
    document = mission_loop.run(days=0.01, plain_seconds=30.0, rounds=1)
    assert document["difference_deg"] < mission_loop.AGREEMENT_DEG
    assert document["plain_vs_compiled"] > 1.0
