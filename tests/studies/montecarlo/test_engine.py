import json
import os
import random
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gyrocal.calibration.problem import Iterates
from gyrocal.errors import InputError
from simulator.streams import generator
from studies.calibration import timestep
from studies.montecarlo import files
from studies.montecarlo.engine import open_study_folder, rerun, run
from tests import ROOT
from tests.engine_studies import DRAWS, ODD, STEPS, DrawsConfig, OddConfig

DEADLINE_S = 30.0


def serial(study, config, folder, **options):
    return run(study, config, folder, backend="serial", **options)


def parts(folder: Path) -> list[str]:
    return sorted(path.name for path in (folder / "parts").iterdir())


def manifest(folder: Path) -> dict:
    return json.loads((folder / "manifest.json").read_text())


def test_the_table_holds_every_case_in_order_and_counts_warnings(tmp_path, caplog):
    config = DrawsConfig(cases=60, size=3)
    outcome = serial(DRAWS, config, tmp_path)
    table = outcome.load()
    np.testing.assert_array_equal(table["case"], np.arange(60))
    assert (table["error"] == "").all()
    np.testing.assert_array_equal(table["gyro"], [generator(1998, i, "gyro_noise").standard_normal() for i in range(60)])
    assert dict(table.dtypes.astype(str)) | {"positive": "bool", "count": "int64"} == dict(table.dtypes.astype(str))
    assert "60 cases, none failed" in outcome.summary()
    outcome = serial(ODD, OddConfig(cases=3, values=("warn", "number", "warn")), tmp_path / "odd")
    assert outcome.warnings == {"RuntimeWarning: mind the gap": 2}
    assert outcome.failures == {}
    assert caplog.messages == ["RuntimeWarning: mind the gap"]
    assert manifest(tmp_path / "odd")["warnings"] == outcome.warnings


@pytest.fixture
def parts_of(monkeypatch):
    """Sets the number of parts that a study has at least, and so the cases of a part."""
    return lambda count: monkeypatch.setattr("studies.montecarlo.store.PARTS", count)


def test_a_case_that_raises_is_a_row(parts_of, tmp_path):
    parts_of(3)
    outcome = serial(DRAWS, DrawsConfig(cases=8, fail=(2, 5)), tmp_path)
    table = outcome.load()
    assert outcome.failures == {2: "ValueError: case 2 is bad", 5: "ValueError: case 5 is bad"}
    np.testing.assert_array_equal(np.flatnonzero(table["error"]), [2, 5])
    assert table.loc[2].drop(["case", "error"]).isna().all()
    assert table.drop([2, 5]).notna().all(axis=None)
    text = (tmp_path / "failures" / "case-000005.txt").read_text()
    assert text.startswith("Traceback")
    assert 'raise ValueError(f"case {case}\\nis bad")' in text
    assert "8 cases, 2 failed (2 ValueError" in outcome.summary()


@pytest.mark.parametrize(
    ("value", "error"),
    [
        ("list", "TypeError: column x: a number, truth value, text or None is expected, not [1]"),
        ("text", "TypeError: column x: text in this case, number in another"),
        ("reserved", "TypeError: a study's row cannot have a column 'case'"),
        ("exit", "SystemExit: over"),
    ],
)
def test_a_row_that_cannot_be_stored_is_a_failure(value, error, parts_of, tmp_path):
    parts_of(1)
    outcome = serial(ODD, OddConfig(cases=4, values=("number", value, "none", "whole")), tmp_path)
    assert list(outcome.failures) == [1]
    assert outcome.failures[1].startswith(error)
    np.testing.assert_array_equal(outcome.load()["x"], [1.5, np.nan, np.nan, 3.0])


def test_failed_cases_are_run_again_on_demand_only(parts_of, tmp_path):
    parts_of(3)
    crutch = tmp_path / "crutch"
    config = DrawsConfig(cases=9, stumble=(4,), crutch=str(crutch))
    folder = tmp_path / "study"
    assert serial(DRAWS, config, folder).failures == {4: "RuntimeError: no crutch"}
    crutch.touch()
    assert serial(DRAWS, config, folder).failures == {4: "RuntimeError: no crutch"}
    outcome = serial(DRAWS, config, folder, retry_failed=True)
    assert (outcome.failures, outcome.resumed) == ({}, 6)
    assert outcome.table.read_bytes() == serial(DRAWS, config, tmp_path / "whole").table.read_bytes()
    assert not list((folder / "failures").iterdir())


def test_a_case_repeated_alone_is_the_row_of_the_table(tmp_path):
    config = DrawsConfig(cases=8, fail=(3,), label=True)
    table = serial(STEPS, config, tmp_path).load()
    for case in (0, 3, 7):
        again = rerun(STEPS, config, case, tmp_path)
        assert again.same is True
        rows = table[table["case"] == case].reset_index(drop=True)
        for column in again.rows:
            assert again.rows[column].tolist() == rows[column].tolist()
    assert "ValueError" in rerun(DRAWS, config, 3, tmp_path / "nowhere").traceback


def test_a_case_that_differs_is_seen(tmp_path):
    crutch = tmp_path / "crutch"
    config = DrawsConfig(cases=5, stumble=(4,), crutch=str(crutch))
    serial(DRAWS, config, tmp_path / "study")
    crutch.touch()
    assert rerun(DRAWS, config, 4, tmp_path / "study").same is False
    assert rerun(DRAWS, config, 3, tmp_path / "study").same is True
    assert rerun(DRAWS, config, 3, tmp_path / "other").same is None


def test_one_run_at_a_time_computes_only_what_is_missing(parts_of, tmp_path):
    parts_of(8)
    flag = tmp_path / "flag"
    config = DrawsConfig(cases=30, flag=str(flag))
    folder = tmp_path / "study"
    table = serial(DRAWS, config, folder).table.read_bytes()
    for index in (0, 5):
        (folder / "parts" / f"part-{index:06d}.parquet").unlink()
    (folder / "parts" / "part-000000.parquet.tmp").write_bytes(b"half")
    (folder / "parts" / "part-000099.parquet").write_bytes(b"of nobody")
    (folder / "table.parquet").unlink()
    flag.unlink()
    outcome = serial(DRAWS, config, folder)
    assert flag.stat().st_size == 8
    assert outcome.resumed == 22
    assert outcome.table.read_bytes() == table
    assert "part-000000.parquet.tmp" not in parts(folder)
    with open_study_folder(tmp_path), pytest.raises(InputError, match="another run is at work in this folder"):
        serial(DRAWS, DrawsConfig(cases=4), tmp_path)
    serial(DRAWS, DrawsConfig(cases=4), tmp_path)


@pytest.mark.parametrize("damage", ["flipped", "of other cases"])
def test_a_damaged_part_is_computed_again(damage, parts_of, tmp_path, caplog):
    parts_of(8)
    config = DrawsConfig(cases=30)
    table = serial(DRAWS, config, tmp_path).table.read_bytes()
    part = tmp_path / "parts" / "part-000002.parquet"
    data = part.read_bytes()
    if damage == "flipped":  # in the middle of the first page's values
        part.write_bytes(data[:60] + bytes([data[60] ^ 1]) + data[61:])
    else:
        part.write_bytes((tmp_path / "parts" / "part-000003.parquet").read_bytes())
    outcome = serial(DRAWS, config, tmp_path)
    assert outcome.table.read_bytes() == table
    assert outcome.resumed == 26
    assert "part-000002.parquet is damaged" in caplog.messages[0]


def test_another_configuration_is_refused_in_one_line(tmp_path):
    config = DrawsConfig(cases=6)
    table = serial(DRAWS, config, tmp_path).table
    before = table.read_bytes()
    for other, difference in (
        (DrawsConfig(cases=6, entropy=1), r"entropy: 1998 → 1"),
        (DrawsConfig(cases=6, size=3, steps_s=(0.5, 2.0)), r"size: 50 → 3, steps_s.1: 1.0 → 2.0"),
        (DrawsConfig(cases=9), r"cases: 6 → 9"),
    ):
        with pytest.raises(InputError, match=rf"{difference}.*choose another --out, or delete the folder") as caught:
            serial(DRAWS, other, tmp_path)
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=r"study: tests\.engine_studies:DRAWS → tests\.engine_studies:STEPS"):
        rerun(STEPS, config, 0, tmp_path)
    # Also if nothing but the parts is left to tell.
    (tmp_path / "manifest.json").unlink()
    with pytest.raises(InputError, match=r"part-000000\.parquet: belongs to a study with another configuration"):
        serial(DRAWS, DrawsConfig(cases=6, entropy=1), tmp_path)
    assert not (tmp_path / "manifest.json").exists()
    assert table.read_bytes() == before
    assert serial(DRAWS, config, tmp_path).resumed == 6


def test_a_full_disk_loses_nothing(tmp_path, monkeypatch):
    """After three parts none can be put in its place."""
    config, count, rename = DrawsConfig(cases=20), 0, os.replace

    def renamed(source, target):
        nonlocal count
        count += "part-" in str(target)
        if count > 3:
            raise OSError(28, "No space left on device")
        rename(source, target)

    message = "No space left on device; 3 of 20 cases are finished and kept in .*; the same command resumes"
    with monkeypatch.context() as full:
        full.setattr(os, "replace", renamed)
        with pytest.raises(InputError, match=message):
            serial(DRAWS, config, tmp_path)
    assert not list(tmp_path.rglob("*.tmp"))
    outcome = serial(DRAWS, config, tmp_path)
    assert outcome.resumed == 3
    assert outcome.table.read_bytes() == serial(DRAWS, config, tmp_path / "whole").table.read_bytes()


def start(tmp_path: Path, cases: int = 60) -> tuple[subprocess.Popen, DrawsConfig, Path]:
    """A study in a process of its own with two workers, some cases into it."""
    flag, folder = tmp_path / "flag", tmp_path / "study"
    config = DrawsConfig(cases=cases, flag=str(flag), pause_s=0.02, fail=(3,), label=True)
    code = f"""
        import signal
        import sys
        from pathlib import Path
        from gyrocal import GyrocalError
        from studies.montecarlo.engine import run
        from tests.engine_studies import DRAWS, DrawsConfig
        if __name__ == "__main__":
            signal.signal(signal.SIGINT, signal.default_int_handler)  # it is ignored if the tests run in the background
            config = DrawsConfig.model_validate_json({config.model_dump_json()!r})
            try:
                run(DRAWS, config, Path({str(folder)!r}), backend="loky", jobs=2)
            except GyrocalError as error:
                print(error)
                sys.exit(error.exit_status)
    """
    script = tmp_path / "script.py"
    script.write_text(textwrap.dedent(code))
    process = subprocess.Popen(
        [sys.executable, "-W", "error", str(script)],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    reached = random.randint(cases // 6, cases // 2)
    wait_for(lambda: process.poll() is not None or (flag.exists() and flag.stat().st_size >= reached))
    if process.poll() is not None:
        pytest.fail("".join(process.communicate()))
    return process, config, folder


def wait_for(condition) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)  # asking often costs what the others would compute with


def check_resumable(config: DrawsConfig, folder: Path, tmp_path: Path, monkeypatch) -> None:
    Path(config.flag).unlink()
    monkeypatch.setattr(time, "sleep", lambda seconds: None)  # nobody waits for these cases
    outcome = serial(DRAWS, config, folder)
    assert Path(config.flag).stat().st_size == config.cases - outcome.resumed
    assert outcome.resumed < config.cases
    assert outcome.failures == {3: "ValueError: case 3 is bad"}
    assert outcome.table.read_bytes() == serial(DRAWS, config, tmp_path / "whole").table.read_bytes()


def test_resumed_after_kill_9_the_table_is_the_same_bit_for_bit(tmp_path, monkeypatch):
    process, config, folder = start(tmp_path)
    process.kill()
    assert process.wait(DEADLINE_S) == -signal.SIGKILL
    assert manifest(folder)["status"] == "running"
    # No worker outlives its study for long.
    wait_for(lambda: not processes_of(process.pid))
    assert process.communicate() == ("", "")
    check_resumable(config, folder, tmp_path, monkeypatch)


def processes_of(session: int) -> list[str]:
    """Processes of a session, as Linux lists them."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if fields[3] == str(session) and fields[0] != "Z":
            found.append((stat.parent / "cmdline").read_text())
    return found


@pytest.mark.long
def test_ctrl_c_stops_cleanly_and_says_how_to_resume(tmp_path, monkeypatch):
    process, config, folder = start(tmp_path)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the workers too
    output, errors = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 130
    done = manifest(folder)["done"]
    assert output == f"interrupted; {done} of 60 cases are finished and kept in {folder}; the same command resumes\n"
    assert errors == ""
    assert manifest(folder)["status"] == "interrupted"
    wait_for(lambda: not processes_of(process.pid))
    check_resumable(config, folder, tmp_path, monkeypatch)


TURNED = "gyro.true_G.0.1"  # one in it turns the attitude of a slew by radians


def test_a_dispersion_of_a_billion_is_a_failure(tmp_path):
    study = timestep.STUDY
    dispersions = {TURNED: {"kind": "normal", "sigma": 1e9}}
    config = study.config.model_validate_json(json.dumps({"cases": 2, "dispersions": dispersions, "steps_s": [0.5]}))
    outcome = run(study, config, tmp_path, backend="serial")
    assert sorted(outcome.failures) == [0, 1]
    assert all("too large to linearise" in error and "diverged" in error for error in outcome.failures.values())
    assert "2 failed (2 InputError" in outcome.summary()


def iterates(**differences) -> Iterates:
    values = {"x": np.zeros((3, 12)), "theta": np.full((3, 6, 3), 0.01), "P": np.eye(12), "chi2": 6.0}
    return Iterates(**(values | differences))


@pytest.mark.parametrize(
    ("differences", "reason"),
    [
        ({"theta": np.full((3, 6, 3), 0.4)}, "39.7 deg under the parameters to start from"),
        ({"theta": np.full((3, 6, 3), np.nan)}, "nan deg under"),
        ({"x": np.full((3, 12), np.inf)}, "not finite"),
        ({"P": -np.eye(12)}, "not finite"),
    ],
)
def test_iterations_that_diverged_are_not(differences, reason):
    with pytest.raises(InputError, match=f"diverged: .*{reason}"):
        iterates(**differences).check_convergence()


def test_json_is_plain(tmp_path):
    value = {
        "a": np.float64(0.1 + 0.2),
        "b": [np.int64(2), float("nan"), (np.inf, True)],
        "c": np.eye(2),
        "d": np.bool_(False),
        "ψ": None,
        3: "x",
    }
    files.write_json(tmp_path / "a.json", value)
    text = (tmp_path / "a.json").read_text(encoding="utf-8")
    expected = {"a": 0.1 + 0.2, "b": [2, None, [None, True]], "c": [[1.0, 0.0], [0.0, 1.0]], "d": False, "ψ": None, "3": "x"}
    assert json.loads(text) == expected
    assert "ψ" in text
    assert text.endswith("}\n")


def test_tables(tmp_path):
    table = pd.DataFrame({"x": [1 / 3, np.nan], "name": ["a", "b"]})
    files.write_csv(tmp_path / "a.csv", table, 3)
    assert (tmp_path / "a.csv").read_text() == "x,name\n0.333,a\n,b\n"
    files.write_csv(tmp_path / "a.csv", pd.DataFrame({"x": [1 / 3, "b", 12345678]}, dtype=object), 3)
    assert (tmp_path / "a.csv").read_text() == "x\n0.333\nb\n12345678\n"
    files.write_csv(tmp_path / "a.csv", table)  # nine digits unless asked: what is committed is compared by them
    assert (tmp_path / "a.csv").read_text() == "x,name\n0.333333333,a\n,b\n"
    files.write_parquet(tmp_path / "a.parquet", table)
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "a.parquet"), table)
    assert sorted(os.listdir(tmp_path)) == ["a.csv", "a.parquet"]
