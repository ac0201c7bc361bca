"""The on-board study: same answer as the ground, memory that samples do not change, verdicts and report."""

import numpy as np
import pytest

from studies.estimation import onboard
from studies.estimation.onboard import INDEPENDENT, OPENED, OWN, STUDY, THROUGH, WITHOUT
from studies.montecarlo.statistics import CONSISTENT
from studies.montecarlo.study import Streams, load_config
from tests.studies.rows import run_study

CONFIG = load_config(STUDY, changes={"cases": 2, "memory_samples": [400, 2000]})


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    return run_study(STUDY, CONFIG, tmp_path_factory.mktemp("onboard"))


def test_the_ground_finds_the_same(rows):
    part = rows[(rows["way"] == OPENED) & (rows["covariance"] == OWN)]
    assert len(part) == 2
    for name in ("apart", "apart_sigma"):
        assert part[name].max() < 1e-9
    assert part["covariance_apart"].max() < 1e-9
    assert part["G_error_ppm"].min() > 10  # and neither finds the truth to that


def test_memory_stays_and_a_kept_stream_does_not(rows):
    table = onboard.tabulate_memory(rows)
    assert list(table["samples"]) == [400, 2000]
    assert table["object_bytes"].nunique() == 1
    assert table["object_bytes"].max() < 8192
    assert abs(table["cost_peak_kib"].diff().iloc[-1]) < 18
    assert table["cost_kept_kib"].diff().iloc[-1] > 1600 * 24 / 1024


def test_what_is_no_cost_is_the_same_again(rows):
    again = STUDY.case(CONFIG, 1, Streams(CONFIG.entropy, 1))
    before = rows[rows["case"] == 1].to_dict("records")
    assert len(again) == len(before) == 7
    for one, other in zip(again, before, strict=True):
        assert {key: value for key, value in one.items() if not key.startswith("cost_")}.items() <= other.items()


def test_leaving_out_the_filters_sensitivity_shows(rows):
    nees = rows.groupby(["way", "covariance"])["nees"].mean()
    assert nees[WITHOUT, OWN] > 5 * 12
    assert nees[THROUGH, INDEPENDENT] < nees[THROUGH, OWN]


def test_verdicts_follow_the_rows(rows):
    perfect = rows.copy()
    chosen = perfect["part"] == "accuracy"
    perfect.loc[chosen, "nees"] = 12.0
    table = onboard.build_verdict_table(perfect)
    assert (table["verdict"] == CONSISTENT).all()
    made = onboard.report(CONFIG, perfect)
    lines = {check.name: check.verdict for check in made.checks if check.unit == "NEES/dof"}
    assert lines == {
        f"{OPENED}, {OWN}": "pass",
        f"{THROUGH}, {OWN}": "pass",
        f"{THROUGH}, {INDEPENDENT}": "fail",
        f"{WITHOUT}, {OWN}": "fail",
    }


def test_a_difference_from_the_ground_is_reported_as_one(rows):
    wrong = rows.copy()
    wrong.loc[wrong["way"] == OPENED, "apart_sigma"] = 2e-9
    assert onboard.report(CONFIG, wrong).check("from the ground's calibration, largest").verdict == "fail"


def test_the_gyro_of_the_scenario_is_used():
    """Ten times less noise of the gyro, better parameters; and dispersed true parameters are found as well."""
    found = {}
    for arw in (2.6e-4, 2.6e-5):
        config = load_config(STUDY, changes={"memory_samples": [], "overrides.gyro.arw_deg_per_sqrt_s": arw})
        made = STUDY.case(config, 0, Streams(config.entropy, 0))
        found[arw] = made[0]["G_sigma_ppm"]
    assert found[2.6e-5] < 0.9 * found[2.6e-4]
    path = "dispersions.gyro.true_G.0.1"
    config = load_config(STUDY, changes={"memory_samples": [], path: {"kind": "normal", "sigma": 5e-3, "mode": "offset"}})
    made = STUDY.case(config, 0, Streams(config.entropy, 0))
    assert np.isfinite(made[0]["nees"])
    assert made[0]["G_error_ppm"] < 500
