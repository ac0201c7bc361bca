"""The benchmark compares like with like, and writes all it promises. How fast anything is, is not tested."""

import json
import subprocess
import sys

import numpy as np
import pytest

from benchmarks import c_kernel, cases, diagnosis, measure, references, report
from benchmarks.goals import Goal, judged
from benchmarks.measure import LEFT_OUT, Candidate, interleaved
from benchmarks.streams import disagreement, run_packed
from gyrocal import Arcs, GyroParameters
from tests import ROOT

RNG = np.random.default_rng(7)
PARAMETERS = GyroParameters(np.eye(3) + 1e-3 * RNG.normal(size=(3, 3)), 1e-5 * RNG.normal(size=3))
needs_compiler = pytest.mark.skipif(c_kernel.compiler() is None, reason="no C compiler")


@pytest.fixture(scope="module")
def arcs():
    """Two arcs of very different length; no length is a multiple of a tile."""
    n = 1531
    raw = np.cumsum(RNG.normal(size=(n, 3)), axis=0) * 3e-4
    return Arcs(raw, RNG.uniform(0.2, 0.5, n), np.arange(n), np.array([0, 1400]), np.array([1400, n]), np.array([0, 1]))


@needs_compiler
def test_every_c_variant_agrees_with_the_kernel(arcs, tmp_path):
    expected = run_packed(arcs, PARAMETERS)
    variants = [*c_kernel.QUICK_VARIANTS, c_kernel.Variant(8, 2, 4, 1)]
    for variant, library in c_kernel.build(variants, tmp_path).items():
        call = c_kernel.prepared(library, c_kernel.pack(arcs, variant.lanes), PARAMETERS.G, PARAMETERS.bias)
        assert disagreement(call(), expected) < 1e-12, variant
        assert disagreement(call(), expected) < 1e-12, "a second call starts afresh"


@needs_compiler
def test_loading_the_c_kernel_leaves_the_process_arithmetic_alone(tmp_path):
    c_kernel.build(c_kernel.QUICK_VARIANTS[:1], tmp_path)
    smallest = np.array([np.finfo(float).smallest_subnormal])
    assert (smallest / 1 * np.array([1.0]) > 0).all()
    assert (np.array([np.finfo(float).tiny]) / 4 > 0).all()


@needs_compiler
def test_c_kernel_refuses_steps_beyond_its_series(arcs, tmp_path):
    library = c_kernel.build(c_kernel.QUICK_VARIANTS[:1], tmp_path).popitem()[1]
    far = GyroParameters(np.eye(3) * 100, np.zeros(3))
    with pytest.raises(ValueError, match="series"):
        c_kernel.prepared(library, c_kernel.pack(arcs, 32), far.G, far.bias)


def test_without_a_compiler_the_reason_is_told(monkeypatch, tmp_path):
    monkeypatch.setenv("CC", "no-such-compiler")
    assert c_kernel.compiler_version() is None
    with pytest.raises(RuntimeError, match="no C compiler"):
        c_kernel.build(c_kernel.QUICK_VARIANTS, tmp_path)


def test_textbook_loop_and_rows_agree_with_the_kernel(arcs):
    expected = run_packed(arcs, PARAMETERS)
    R, Theta = references.textbook(arcs, PARAMETERS)
    np.testing.assert_allclose(R, expected.R, rtol=0, atol=1e-12)
    np.testing.assert_allclose(Theta, expected.Theta, rtol=0, atol=1e-12 * np.abs(expected.Theta).max())
    assert disagreement(references.rows(arcs, PARAMETERS), expected) < 1e-12
    np.testing.assert_allclose(references.scipy_rotation(arcs, PARAMETERS), expected.R, rtol=0, atol=1e-12)


def test_candidates_take_turns():
    turns = []
    ms = interleaved(
        {name: Candidate(lambda name=name: turns.append(name), rounds) for name, rounds in {"a": 6, "b": 1, "c": 3}.items()}
    )
    # Two calls a turn, the first to warm the caches; the one that has a single round is called once.
    assert "".join(turns) == "aaaaccaaaaccaaaabcc"
    assert set(ms) == {"a", "b", "c"}
    assert all(0 <= value < 1e3 for value in ms.values())


def test_goals_are_judged_both_ways():
    assert Goal(1.2).met(1.2)
    assert not Goal(1.2).met(1.21)
    assert Goal(4000, most=False).met(4001)
    assert not Goal(4000, most=False).met(3999)
    document = {
        "ratios": {"kernel_vs_c_48k": None, "least_squares_vs_davenport": 20.0},
        "cpu_ms_per_case": 2.0,
        "peak_rss_mb": {"100": 200.0, "10000": 210.0},
        "growth": {
            "cases": [{"cases": 1, "process_s": 1.0}],
            "diagnoses": [{"samples": 10**6, "cpu_s": 19.0, "peak_rss_mb": 1001.0}],
        },
        "mission_loop": {"wall_s_30_days": 61.0},
        "start_up_cpu_s": {"calibrate_cold": 16.0, "calibrate_warm": 1.0},
    }
    met = {name: row["met"] for name, row in judged(document).items()}
    assert [met[f"{name}_cpu_s"] for name in ("calibrate_cold", "calibrate_warm", "help")] == [False, True, None]
    assert met["kernel_vs_c_48k"] is None
    assert met["least_squares_vs_davenport"] is None
    assert met["cpu_ms_per_case"] is False
    assert met["peak_rss_mb_10000"] is True
    assert met["peak_rss_10000_over_100"] is False
    assert met["mission_30_days_s"] is False
    assert met["diagnosis_cpu_s_1000k"] is True
    assert met["diagnosis_peak_rss_mb_1000k"] is False
    assert met["diagnosis_cpu_s_10000k"] is None


def test_the_recording_of_a_timed_diagnosis_has_its_step_about_x():
    made = diagnosis.recording(2000, 40)
    step = diagnosis.with_step(made).gyro.rates - made.gyro.rates
    assert (made.gyro.t_s.size, made.attitudes.t_s.size) == (2000, 40)
    assert 0 < np.count_nonzero(step[:, 0]) < 2000
    assert not step[:, 1:].any()


@pytest.mark.long
def test_what_runs_in_a_process_of_its_own_measures(tmp_path, monkeypatch):
    cost = cases.run(2, tmp_path)
    assert cost["cpu_ms_per_case_mean"] > 0
    assert cost["peak_rss_mb"] > 0
    assert np.isfinite(np.load(tmp_path / "part0.npy")).all()
    monkeypatch.setattr(measure, "COMMAND_NAMES", ("calibrate",))
    assert set(measure.compute_start_up_ratios(measure.measure_start_ups(0))) == {
        "help_vs_numpy",
        "wrong_option_vs_numpy",
        "no_recording_vs_numpy",
    }


def check_document(folder):
    """The document of a run has all keys, the figure of the growth is beside it, and nothing is of the machine's folders."""
    text = (folder / "benchmark.json").read_text()
    assert not any(path in text for path in (str(ROOT), str(folder), sys.executable))
    document = json.loads(text)
    ratios = document["ratios"]
    assert {
        "kernel_vs_c_48k",
        "kernel_vs_c_4800k",
        "pack_vs_kernel_48k",
        "pack_vs_kernel_4800k",
        "load_vs_kernel_4800k",
        "load_csv_vs_kernel_4800k",
        "case_vs_c_48k",
        "textbook_vs_kernel",
        "gtsam_vs_kernel",
        "least_squares_vs_davenport",
        "mission_plain_vs_compiled",
    } <= set(ratios)
    for name, value in ratios.items():
        assert value is None or value > 0
        assert (value is None) == (name in document["reasons"])
    assert document["cpu_ms_per_case"] > 0
    assert set(document["peak_rss_mb"]) == {"100", "10000"}
    assert {"cpu", "cores", "python", "packages", "compiler"} <= set(document["machine"])
    assert set(document["goals"]) >= set(ratios)
    assert (folder / "growth.csv").read_text().startswith("of,n,quantity,value\n")
    assert "<svg" in (folder / "growth.svg").read_text()
    return document


def test_the_committed_run_is_written_with_every_key(tmp_path):
    report.write(json.loads((ROOT / "results" / "benchmarks" / "benchmark.json").read_text()), tmp_path)
    check_document(tmp_path)


@pytest.mark.long
def test_a_quick_run_writes_every_key(tmp_path):
    command = [sys.executable, "-m", "benchmarks", "--quick", "--out", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    reasons = check_document(tmp_path)["reasons"]
    assert reasons["kernel_vs_c_4800k"] == LEFT_OUT or c_kernel.compiler() is None
