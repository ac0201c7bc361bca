"""`gyrocal mission` and `gyrocal reproduce --paper robertson` as a user types them, flown for hours instead of months."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from studies import reproduction
from studies.cli.mission import TABLES
from studies.montecarlo import engine
from studies.robertson import performance, reproduce
from studies.robertson.calendar import YAW_MANEUVER_TIMES
from studies.robertson.figures import MISSION_FIGURE_TITLES
from studies.robertson.runs import KEPT_TABLES, SPIKE_FILTERS, STUDY, MissionStudy, fly_mission, load_flights

SHORT = MissionStudy(days=1.0, seeds=1, slews=2, windows=False)


@pytest.fixture(scope="module")
def short_flight(tmp_path_factory):
    """A study's folder, its flights flown."""
    folder = tmp_path_factory.mktemp("mission")
    engine.run(STUDY, SHORT, folder, backend="serial")
    return folder


@pytest.fixture
def flown_already(short_flight, monkeypatch):
    """Every reproduction goes on from the flights of the short study."""

    def work_folder(folder, study, config):
        work = folder / "work" / "short"
        shutil.copytree(short_flight, work)
        return work

    monkeypatch.setattr(reproduction, "get_work_folder", work_folder)


def test_mission_writes_its_tables(run_cli, tmp_path):
    out, summary_file = tmp_path / "out", tmp_path / "summary.json"
    result = run_cli(
        "mission", str(out), "--days", "0.2", "--tables", "postcalibration", "--every", "10", "--json", str(summary_file)
    )
    assert result.exit_code == 0, result.stderr
    tables = {name: pd.read_parquet(out / f"{name}.parquet") for name in TABLES}
    assert np.diff(tables["telemetry"]["t_s"]) == pytest.approx(10.0)
    assert len(tables["orbits"]) == 4
    assert len(tables["slews"]) == 0
    assert "start_s" in tables["slews"].columns
    (stretch,) = json.loads(summary_file.read_text())["stretches"]
    assert stretch["to_day"] == 0.2
    assert stretch["yaw_updates"] == len(tables["updates"])
    assert stretch["pointing_yaw_deg"] < 0.4
    assert "✗" not in result.stdout.split("Knowledge and")[0]


@pytest.mark.usefixtures("flown_already", "blank_figures")
def test_reproduction_of_robertson_writes_everything_and_repeats_itself(run_cli, tmp_path):
    arguments = ("reproduce", "--paper", "robertson", "--days", "1", "--seeds", "1", "--slews", "2")
    result = run_cli(*arguments, "--out", str(tmp_path / "a"), "--json", str(tmp_path / "summary.json"))
    assert result.exit_code == 0, result.stderr
    manifest = json.loads((tmp_path / "a" / "manifest.json").read_text())
    tables = ("requirements", "table2", "table3", "biases", "orientation", "yaw_maneuvers", "daily", "slews", "updates")
    expected = {
        *(f"{name}.csv" for name in tables),
        *(f"{name}.svg" for name in MISSION_FIGURE_TITLES),
        "report.md",
        "summary.json",
    }
    assert manifest["config"]["days"] == 1.0
    assert manifest["resumed"] == manifest["cases"] == SHORT.cases
    assert not (tmp_path / "a" / "work").exists()
    page = (tmp_path / "a" / "report.md").read_text()
    assert "nan" not in page.lower().replace("natanson", "")
    assert all(f"]({name})" in page for name in expected if name.endswith(".svg"))
    assert all(f"## R Table {k}: " in page for k in (1, 2, 3))
    table = pd.read_csv(tmp_path / "a" / "table3.csv")
    assert {"flight", "simulated", "simulated_minus_flight"} <= set(table.columns)
    assert table.query("period == 'postcalibration'")["simulated"].isna().all()  # not flown: no number
    before = json.loads((tmp_path / "summary.json").read_text())["yaw_update_deg"]["precalibration"]
    assert before["flight"] == 0.24
    assert before["simulated"] == pytest.approx(0.16, abs=0.03)  # its first days; 0.19 over the whole period
    reproduce.run(tmp_path / "b", SHORT, 1, Console(quiet=True))
    again = json.loads((tmp_path / "b" / "manifest.json").read_text())
    assert again["files"] == manifest["files"]  # the same bytes


def test_stored_flights_are_those_flown_and_show_the_symptoms(short_flight):
    """Bit for bit, with its dtypes, in whatever order of the columns."""
    stored = load_flights(SHORT, short_flight / "table.parquet")
    slew = ("slew", next(iter(YAW_MANEUVER_TIMES)), "calibration1", "0")
    for name in (("spikes", "off"), ("months", "0"), slew):
        direct = fly_mission(SHORT, name)
        for table in KEPT_TABLES[name[0]]:
            pd.testing.assert_frame_equal(
                getattr(stored[name], table), getattr(direct, table), check_exact=True, check_like=True
            )
    # Spikes by the faulty S filter, and the yaw maneuver's miss gone with the gyro's calibration.
    short_runs = load_flights(SHORT, short_flight / "table.parquet")
    spikes = {state: short_runs["spikes", state].telemetry["error_pitch_deg"].abs().max() for state in SPIKE_FILTERS}
    assert spikes["restarted"] > 0.1 > 2 * max(spikes["off"], spikes["correct"])
    rolls = performance.build_slew_table(performance.collect_slew_misses(short_runs)).query(
        "maneuver == '+x to -x' and axis == 'roll'"
    )
    before, after = rolls["simulated_deg"]
    assert before == pytest.approx(0.248, abs=0.05)
    assert abs(after) < 0.03  # white noise of 0.008° a slew
