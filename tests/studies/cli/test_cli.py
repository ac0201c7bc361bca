"""The commands as a user types them."""

import json
import re
import subprocess
import sys
from typing import get_args
from xml.etree import ElementTree

import click
import numpy as np
import pytest

import gyrocal
from gyrocal import NAMES, load
from simulator import scenario as scenarios
from simulator.mission_mode.config import DAY
from simulator.mission_mode.effects import MISSION_EFFECTS
from simulator.mission_mode.mounting import Mounting
from studies.cli import compare, mission
from studies.cli import reproduce as reproduce_command
from studies.cli.main import COMMAND_NAMES, main, read_help
from studies.compare import compare as comparison
from studies.montecarlo import engine
from studies.montecarlo.session import StudyInterrupted
from studies.natanson import paper_tables, reproduce
from studies.reproduction import get_work_folder
from studies.robertson.calendar import PERIODS
from studies.robertson.runs import DAYS
from tests import ROOT


def test_the_list_of_commands_says_what_each_says_itself(run_cli):
    listed = run_cli("--help").stdout
    for name in COMMAND_NAMES:
        own = main.get_command(click.Context(main), name).get_short_help_str(10_000)
        assert own == click.Command(name, help=read_help(name)).get_short_help_str(10_000)
        assert re.search(rf"^  {name} +{re.escape(own[:20])}", listed, flags=re.MULTILINE)


def test_simulate_then_calibrate(run_cli, tmp_path):
    known = str(tmp_path / "truth.json")
    made = run_cli("simulate", "trmm", str(tmp_path / "rec"), "--seed", "4", "--truth", known)
    assert made.exit_code == 0
    assert "6 intervals, 47790 gyro samples, 12 reference attitudes" in made.stdout
    result = run_cli("calibrate", str(tmp_path / "rec"), "--json", str(tmp_path / "result.json"), "--truth", known)
    assert result.exit_code == 0
    assert "error in sigma" in result.stdout
    np.testing.assert_allclose(json.loads((tmp_path / "truth.json").read_text())["G"], scenarios.load("trmm").gyro.true_G)
    document = json.loads((tmp_path / "result.json").read_text())
    assert document["converged"]
    truth = np.array(gyrocal.load(tmp_path / "rec").gyro.apriori_G)
    assert np.abs(np.array(document["G"]) - truth).max() > 1e-4
    assert document["parameters"] == list(NAMES)


def test_study_runs_resumes_and_reruns(run_cli, tmp_path):
    arguments = ["study", "paper", "--cases", "3", "--set", "steps_s=[0.5]", "--out", str(tmp_path / "paper")]
    suite = tmp_path / "paper.xml"
    first = run_cli(*arguments, "--backend", "serial", "--json", str(tmp_path / "paper.json"), "--junit", str(suite))
    assert first.exit_code == 0, first.stderr
    assert "3 cases, none failed" in first.stdout
    assert json.loads((tmp_path / "paper.json").read_text())["failures"] == {}
    assert int(ElementTree.parse(suite).getroot()[0].get("tests")) > 1
    hashed = json.loads((tmp_path / "paper" / "manifest.json").read_text())["files"]
    assert set(hashed) == {p.name for p in (tmp_path / "paper").iterdir() if p.is_file()} - {"manifest.json", ".lock"}
    assert "3 of them from an earlier run" in run_cli(*arguments, "--backend", "serial").stdout
    again = run_cli(*arguments, "--rerun", "2", "--json", str(tmp_path / "again.json"))
    assert json.loads((tmp_path / "again.json").read_text())["same"] is True
    assert "bit for bit" in again.stdout
    assert load(tmp_path / "paper" / "cases" / "case-000002").gyro.t_s.size == 47790


def test_ctrl_c_has_its_own_status(run_cli, monkeypatch, tmp_path):
    def interrupted(*arguments, **options):
        raise StudyInterrupted("interrupted; 3 of 9 cases are done; the same command resumes")

    monkeypatch.setattr(engine, "run", interrupted)
    result = run_cli("study", "paper", "--out", str(tmp_path))
    assert result.exit_code == 130
    assert result.stderr.count("\n") == 1
    assert "resumes" in result.stderr


@pytest.mark.usefixtures("blank_figures")
def test_a_reproduction_that_was_stopped_goes_on_and_writes_everything(run_cli, tmp_path, monkeypatch):
    folder = tmp_path / "a"
    arguments = ("reproduce", "--paper", "natanson", "--cases", "2", "--jobs", "1", "--out", str(folder))
    with monkeypatch.context() as patch:
        patch.setattr(reproduce, "compare_with_flight", pressed)  # when all cases are there
        assert run_cli(*arguments).exit_code == 1
    (rows,) = (folder / "work").rglob("table.parquet")
    config = paper_tables.PaperTablesConfig(cases=2)
    assert rows.parent == get_work_folder(folder, paper_tables.STUDY, config)
    (rows.parent / "parts" / "part-000001.parquet").unlink()
    result = run_cli(*arguments)
    assert result.exit_code == 0, result.stderr
    assert not (folder / "work").exists()
    summary = json.loads((tmp_path / "a" / "summary.json").read_text())
    assert summary["flight_gap_rms_deg"]["published"] <= 0.022
    assert summary["minus_y_rate_rpo"]["favoured"] == -1
    assert 0.0062 > summary["clean_gap_rms_deg"]["assumed"] > 0.003
    assert {"nees", "coverage", "second_iteration_max"} <= set(summary)
    manifest = json.loads((tmp_path / "a" / "manifest.json").read_text())
    assert manifest["resumed"] == 1
    expected = {f"table{k}.csv" for k in (2, 3, 4, 5)} | {"tables.md"}
    assert expected <= set(manifest["files"])


@pytest.mark.usefixtures("blank_figures")
def test_another_scenario_is_reproduced_without_the_flight(run_cli, tmp_path):
    options = ("--set", "interval.1.stop_s=13500.0", "--set", "gyro.arw_deg_per_sqrt_s=1e-4", "--cases", "2", "--jobs", "1")
    result = run_cli("reproduce", "--paper", "natanson", *options, "--out", str(tmp_path))
    assert result.exit_code == 0, result.stderr
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert "clean_gap_rms_deg" not in summary
    assert {"nees", "coverage", "printed_digits"} <= set(summary)
    assert json.loads((tmp_path / "manifest.json").read_text())["config"]["overrides"]["interval.1.stop_s"] == 13500.0
    assert "| before, 1 roll | – |" in (tmp_path / "tables.md").read_text()


def pressed(*arguments):
    raise KeyboardInterrupt


HEAVY = "numba", "scipy", "pandas", "matplotlib", "pyarrow"
LOADED = """
import sys, click
from studies.cli.main import main
for command in sys.argv[1:]:
    main.get_command(click.Context(main), command)
print([name for name in {names!r} if name in sys.modules])
"""


def test_no_command_module_loads_what_is_heavy():
    """Of what is looked for, only click is there, which shows that the look finds what is loaded."""
    arguments = [sys.executable, "-c", LOADED.format(names=(*HEAVY, "click")), *COMMAND_NAMES]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True, cwd=ROOT)
    assert (done.stdout, done.stderr) == ("['click']\n", "")


def test_what_the_options_list_is_what_there_is():
    assert (tuple(MISSION_EFFECTS), get_args(Mounting), PERIODS) == (
        mission.EFFECT_NAMES,
        mission.MOUNTING_NAMES,
        mission.PERIODS,
    )
    assert (mission.DAY, reproduce_command.DAYS) == (DAY, DAYS)
    assert (compare.BASELINE, compare.FEWEST_FLIGHTS) == (comparison.BASELINE, comparison.FEWEST_FLIGHTS)
