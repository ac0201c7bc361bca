"""Every study's report is the committed one where it is made again of the committed rows, and any rows have a report."""

import pandas as pd
import pytest

from gyrocal import InputError
from studies import catalogue
from studies.montecarlo import engine
from studies.montecarlo.study import load_config
from studies.report import entry as report
from tests import ROOT

FOLDERS = [
    ROOT / "results" / "studies" / name
    for name in (*("consistency", "iterations", "noise", "observability", "psi", "timestep"),)
]


def committed_rows(folder):
    rows = pd.read_parquet(folder / "table.parquet")
    return rows[rows["error"] == ""].reset_index(drop=True)


@pytest.mark.usefixtures("blank_figures")
@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_a_report_made_again_of_committed_rows_is_the_committed_one(folder, tmp_path):
    entry = catalogue.find_entry(folder.name)
    report.write(entry.report(engine.load_stored_config(entry.study, folder), committed_rows(folder)), folder.name, tmp_path)
    kept = {"table.parquet", "manifest.json", "tolerance.csv"}  # the last one by the engine
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in folder.iterdir()} - kept
    for path in tmp_path.glob("*.csv"):
        # Six digits are written, and other processors differ in the last of them.
        pd.testing.assert_frame_equal(pd.read_csv(path), pd.read_csv(folder / path.name), rtol=3e-6)


# Rows of a study that was stopped early, or whose other cases failed.
FEW = {
    "iterations": "case == 0 and factor == 10",
    "psi": "case == 0",
    "timestep": "case == 0 and step_s == 0.5",
}


@pytest.mark.usefixtures("blank_figures")
@pytest.mark.parametrize("name", FEW)
def test_whatever_is_left_of_a_study_has_a_report(name, tmp_path):
    folder = ROOT / "results" / "studies" / name
    entry = catalogue.find_entry(name)
    rows = committed_rows(folder).query(FEW[name]).dropna(axis=1, how="all").reset_index(drop=True)
    made = entry.report(engine.load_stored_config(entry.study, folder), rows)
    report.write(made, name, tmp_path)
    assert made.checks


UNIFORM = {"kind": "uniform", "low": 0.1, "high": 0.2}
REFUSED = [
    ("consistency", {"sampler": "sobol"}, "sampler"),
    ("consistency", {"dispersions.gyro.true_G.0.0": UNIFORM}, "must be normal"),
    ("noise", {"cases": 6}, "the grid has 43 points, one a case; change them by arw_deg_per_sqrt_s and sigma_deg"),
    ("noise", {"sigma_deg": [0.01, 0.005]}, "rising numbers above zero"),
    ("observability", {"dispersions.orbit.raan_deg": UNIFORM}, "not dispersed"),
    ("psi", {"steps_s": [0.5], "cases": 90}, "the grid has 18 points, one a case; change them by slew_angles_deg and"),
    ("psi", {"slew_angles_deg": []}, "one or more"),
    ("iterations", {"iterations": 3}, "must be between 4 and 100"),
]


@pytest.mark.parametrize(("name", "changes", "message"), REFUSED)
def test_settings_that_cannot_be_used_are_refused_in_one_line(name, changes, message):
    with pytest.raises(InputError, match=message) as refusal:
        load_config(catalogue.find_entry(name).study, changes=changes)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("name", catalogue.STUDY_NAMES)
def test_every_study_of_the_list_is_loaded(name):
    assert catalogue.find_entry(name).summary
