"""The study of promises: its statistics tell right from wrong, its cases are of all plans and grades."""

from collections import Counter

import numpy as np
import pandas as pd
import pytest

from studies.montecarlo.study import Streams, load_config
from studies.report.entry import write
from studies.validation.promises import cases
from studies.validation.promises.plans import PLAN_NAMES, SENSOR_GRADES, build_graded_scenario, select_plan_and_grade
from studies.validation.promises.study import (
    CONTROL_LINES,
    KEPT,
    STUDY,
    TOO_CAUTIOUS,
    TOO_SURE,
    check_nees,
    compute_statement_coverage,
    list_statements,
    report,
)

QUICK = 14  # short slews, MEMS
COVARIANCE = "calibrate, series"


def drawn_rows(scale, count=400, promise=COVARIANCE, dof=12):
    """Rows of a covariance that is stated so many times too large."""
    rng = np.random.default_rng(3)
    places = [select_plan_and_grade(number) for number in range(count)]
    rows = [cases.build_chi2_row(promise, rng.chisquare(dof) / scale, dof) for _ in places]
    return pd.DataFrame([{"plan": p, "grade": g, **row} for (p, g), row in zip(places, rows, strict=True)])


@pytest.fixture(scope="module")
def rows():
    return cases.collect_statements(QUICK, Streams(1998, QUICK))


@pytest.mark.parametrize(("scale", "verdict"), [(1.0, KEPT), (0.7, TOO_SURE), (1.4, TOO_CAUTIOUS)])
def test_a_covariance_that_is_wrong_is_found_out_on_either_side(scale, verdict):
    found = drawn_rows(scale)
    said = list_statements(found)
    assert set(compute_statement_coverage(said, [])["verdict"]) == {verdict}
    assert set(check_nees(found)["verdict"]) == {verdict}


def test_sixteen_cases_are_of_all_plans_and_grades_in_which_the_noise_is_as_named():
    assert {select_plan_and_grade(number) for number in range(16)} == {
        (plan, grade) for plan in PLAN_NAMES for grade in SENSOR_GRADES
    }
    for plan in PLAN_NAMES:
        for grade, (arw, sigma) in SENSOR_GRADES.items():
            own = build_graded_scenario(plan, grade, "trackers")
            assert own.gyro.arw_deg_per_sqrt_s == arw
            assert own.reference.tracker[1].sigma_deg[0] == own.reference.sigma_deg[0] == sigma


def test_a_case_has_every_promise_once_and_none_is_far_off(rows):
    assert set(Counter(row["promise"] for row in rows).values()) == {1}
    families = {row["promise"].partition(",")[0].partition(":")[0] for row in rows}
    assert families >= {"calibrate", "predict", "trackers", "calibrate_gyros", "batch", "filter", "smoother", "full filter"}
    assert "alignment" in families
    for row in rows:
        assert row["promise"] in CONTROL_LINES or row["nees"] < row["dof"] + 6 * np.sqrt(2 * row["dof"]), row


def test_a_wrong_angle_random_walk_breaks_the_promises(monkeypatch, rows):
    def quieter(own, at, references, streams, name, right=cases.record_plan):
        made = right(own, at, references, streams, name)
        return cases.replace(made, gyro=cases.replace(made.gyro, arw=made.gyro.arw / 3))

    monkeypatch.setattr(cases, "record_plan", quieter)
    found = {row["promise"]: row["nees"] for row in cases.collect_statements(QUICK, Streams(1998, QUICK))}
    for row in rows:
        if row["promise"] in ("calibrate, series", "calibrate, gyro by gyro", "calibrate_gyros, four"):
            assert found[row["promise"]] > 2 * row["nees"], row["promise"]


def test_the_report_has_a_line_and_a_check_for_every_promise(tmp_path, rows):
    table = pd.DataFrame([{"case": 0, "plan": "short slews", "grade": "MEMS", **row} for row in rows])
    config = load_config(STUDY, changes={"cases": 1})
    made = report(config, table)
    names = " ".join(check.name for check in made.checks)
    assert all(row["promise"] in names for row in rows)
    write(made, "Study promises", tmp_path)
    assert (tmp_path / "coverage.svg").stat().st_size > 0
    assert "too sure" in (tmp_path / "report.md").read_text()  # N's covariance
