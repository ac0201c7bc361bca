"""The raw sensor tables from scenario to page: command line, JSON, words, figures and the study of R's heads."""

import html
import json

import numpy as np
import pandas as pd
import pytest

from diagnosis.diagnose import diagnose
from gyrocal import load, save
from simulator import scenario
from simulator.effects.sensor import parse
from simulator.simulate import simulate
from studies import catalogue
from studies.robertson import heads as sensor_story

MONTHS = scenario.load("trmm_months")
DAYS = ("d09", "m1", "m2", "m3", "m4", "m5", "m6", "d25", "d37", "d57", "d73")
FEW = MONTHS.model_copy(update={"interval": tuple(one for one in MONTHS.interval if one.name in DAYS)})


@pytest.mark.usefixtures("blank_figures")
def test_both_answers_are_one_in_terminal_json_and_page(run_cli, tmp_path, monkeypatch):
    rec = tmp_path / "rec"
    save(simulate(FEW, seed=1, effects=[parse("dss_head:2=0.28156")]), rec)
    found = diagnose(load(rec))
    assert found.verdict == "named"
    assert [cause.label for cause in found.causes] == ["dss_head:2"]
    assert found.sensors.present
    assert found.present
    assert found.closure is found.sensors.closure
    np.testing.assert_allclose(found.causes[0].size, 0.28156, atol=3 * found.causes[0].sigma)
    monkeypatch.setattr("diagnosis.diagnose.diagnose", lambda *_, **options: found)
    target, page = tmp_path / "d.json", tmp_path / "d.html"
    result = run_cli("diagnose", str(rec), "--json", str(target), "--report", str(page))
    assert result.exit_code == 0
    assert "does not explain the data" in " ".join(result.output.split())
    document = json.loads(target.read_text())
    assert document["causes"][0]["effect"] == "dss_head"
    assert set(document["causes"][0]["parameters"]) == {"e1_deg", "e2_deg", "e3_deg"}
    own = document["sensors"]
    assert own["rejected"][0]["effects"] == ["dss_misalignment", "esa_bias"]
    assert own["rejected"][0]["after"] > own["closure"]["after"] + 0.05
    assert {one["signal"] for one in document["where"]} >= {"DSS-1", "DSS-2"}
    assert "Residuals of DSS-2 over the Sun's two angles" in html.unescape(page.read_text())


def test_an_orthogonal_fit_of_rs_truth_finds_r3():
    """And of R (3) put on top of the heads it finds another misalignment, about x by more than R (3)'s own."""
    few = FEW.model_copy(update={"interval": tuple(one for one in FEW.interval if not one.name.startswith("m"))})
    wanted = {one.effect: sensor_story.compute_sensor_amplitudes(one) for one in map(parse, sensor_story.ALIGNMENT)}
    found = sensor_story.fit_orthogonal_calibration(few, sensor_story.list_true_settings("R", few))
    for name, amplitudes in wanted.items():
        np.testing.assert_allclose(found[name], amplitudes, atol=2e-4)
    np.testing.assert_allclose(wanted["dss_misalignment"], np.rad2deg([-0.00273, -0.00199, 0.00199]), atol=1e-3)
    on_top = sensor_story.fit_orthogonal_calibration(
        few, [parse(text) for text in (*sensor_story.TRUE_HEAD_EFFECTS, *sensor_story.ALIGNMENT)]
    )
    assert on_top["dss_misalignment"][0] - wanted["dss_misalignment"][0] > 0.15


def test_the_study_of_the_heads(tmp_path, monkeypatch):
    few = FEW.model_copy(update={"interval": tuple(one for one in FEW.interval if not one.name.startswith("m"))})
    monkeypatch.setattr(sensor_story, "TRUTHS", ("heads", "misalignment", "nominal", "noise"))
    config = sensor_story.StoryConfig(cases=1, scenario=few, entropy=5)
    rows = pd.DataFrame(sensor_story.run_case(config, 0, sensor_story.Streams(5, 0))).assign(case=0)
    assert rows["right"].all(), rows[["truth", "verdict", "named"]]
    heads = rows.set_index("truth").loc["heads"]
    assert heads["after"] < 1.05 < heads["orthogonal"] < heads["before"]
    assert heads["orthogonal_p"] < 1e-6
    assert heads["log_ratio"] > 50
    assert catalogue.find_entry("heads") is sensor_story.ENTRY
    assert list(sensor_story.average_gaps(rows)["truth"]) == ["heads", "misalignment", "nominal", "noise"]
