"""`gyrocal study blind`: its settings, its processes, and what it leaves in its folder."""

import io
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from rich.console import Console

from gyrocal import InputError
from simulator.effects import EFFECTS
from studies.montecarlo.study import find, load_config
from studies.validation import blind
from studies.validation.blind_check import steps
from studies.validation.blind_check.cases import Spec
from tests.studies.validation.test_blind import Silent

FAST = {"overrides.gyro.sample_s": 4.0, "overrides.reference.every_s": 120.0, "cases": 3, "mix": [1, 1, 0, 1]}


def test_the_study_is_found_by_its_name() -> None:
    assert find("studies.validation.blind:STUDY") == blind.STUDY
    assert blind.ENTRY.study is blind.STUDY


def test_settings_reach_the_first_step() -> None:
    config = load_config(blind.STUDY, None, FAST | {"entropy": 9, "snr": [5.0, 6.0]})
    spec = Spec.model_validate_json(config.spec().model_dump_json())
    assert (spec.entropy, spec.cases, spec.snr, spec.base.gyro.sample_s) == (9, 3, (5.0, 6.0), 4.0)
    assert spec.base.reference.sigma_deg == (0.005, 0.005, 0.008)


def test_withholding_has_so_many_cases_of_each_effect() -> None:
    assert load_config(blind.STUDY, None, {"withhold": 2}).cases == 2 * len(EFFECTS)
    with pytest.raises(InputError, match="not 10"):
        load_config(blind.STUDY, None, {"withhold": 2, "cases": 10})
    assert blind.BlindConfig().cases == 300


def in_process(step: str, work: Path, jobs: int, given: str, shown: Any) -> None:
    with shown as advance:
        advance(0)
    if step == "make":
        steps.make(work, Spec.model_validate_json(given), 1)
    elif step == "diagnose":
        assert given == ""
        steps.diagnose_all(work, 1)
    else:
        steps.score(work, 1)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps, "diagnose", lambda recording, seed, library: Silent())
    monkeypatch.setattr(blind, "_step", in_process)


@pytest.mark.usefixtures("quick")
def test_a_run_leaves_seals_answers_and_scores_but_no_recordings(tmp_path: Path) -> None:
    outcome = blind.run(tmp_path, FAST, Console(file=io.StringIO(), quiet=True), jobs=1)
    assert outcome.cases == 3
    assert not (tmp_path / "work").exists()
    for name in (
        "report.md",
        "seals.json",
        "answers.json",
        "table.parquet",
        "detection.svg",
        "reliability.svg",
        "criteria.csv",
    ):
        assert (tmp_path / name).exists(), name
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["config"]["cases"] == 3
    opened = json.loads((tmp_path / "answers.json").read_text())
    published = json.loads((tmp_path / "seals.json").read_text())["seals"]
    assert all(steps.seal.seal(one["answer"], one["salt"]) == published[case] for case, one in opened.items())
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) < 200_000
    assert sorted(outcome.load()["kind"]) == ["none", "one", "unlisted"]
    assert "false alarms: 0.0 % (0 of 1" in (tmp_path / "report.md").read_text()


@pytest.mark.usefixtures("quick")
def test_recordings_stay_if_asked_for(tmp_path: Path) -> None:
    blind.run(tmp_path, FAST | {"keep_recordings": True, "cases": 1}, Console(file=io.StringIO(), quiet=True), jobs=1)
    assert (tmp_path / "work" / "recordings" / "case-000000" / "gyro.parquet").exists()


def test_steps_are_processes_and_their_error_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"step 'diagnose': .*there are no published seals"):
        blind._step("diagnose", tmp_path, 1, "", nullcontext(lambda count: None))


def test_progress_comes_from_the_process(tmp_path: Path) -> None:
    told: list[int] = []

    @contextmanager
    def shown() -> Iterator[Any]:
        yield told.append

    spec = load_config(blind.STUDY, None, FAST | {"cases": 1}).spec()
    blind._step("make", tmp_path, 1, spec.model_dump_json(), shown())
    assert sum(told) == 1
    assert (tmp_path / "seals.json").exists()


def test_there_are_three_steps() -> None:
    done = subprocess.run([sys.executable, "-m", "studies.validation.blind_check", "peek", "."], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (2, "peek: no such step; there are make, diagnose, score\n")


def test_run_time_table() -> None:
    table = blind.run_time(pd.DataFrame({"runtime_s": [1.0, 3.0]}), {"make": 2.0}).set_index("what")["seconds"]
    assert table["make, wall"] == 2.0
    assert table["a diagnosis, median"] == 2.0
