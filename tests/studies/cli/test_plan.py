"""The command ``gyrocal plan`` as a user types it."""

import json
from dataclasses import replace

import pytest

from diagnosis.plan.result import Extra, Pair, Plan, Visible
from studies.report.plan import build_plan_page
from tests.pages import checked

INF, NAN = float("inf"), float("nan")
FOUND = Plan(
    scenario="A plan",
    false_alarm_rate=0.002,
    threshold=0.5,
    degrees_of_freedom=100,
    effects=(
        Visible("bias_drift", "x", "bias_drift:x", "deg/h per day", "visible", 0.1, 0.1, 0.1, 5.0, (1e-3, 10.0)),
        Visible("bias_drift", "y", "bias_drift:y", "deg/h per day", "visible", 0.105, 0.1, 0.11, 5.0, (1e-3, 10.0)),
        Visible("time_offset", None, "time_offset", "s", "visible", 0.2, 0.2, INF, 5.0, (5e-3, 10.0)),
        Visible(
            "scale_asymmetry", "x", "scale_asymmetry:x", "ppm", "not identifiable", INF, INF, INF, NAN, (10.0, 5e4),
            text="acts like [G]",
        ),
    ),
    pairs=(Pair("rate_lag", "time_offset", 1.0, INF, INF), Pair("noise_flicker:x", "bias_random_walk:x", NAN, NAN, 3.0)),
    extras=(
        Extra("again", 6.0, 0.5, {"bias_drift:x": 0.5}, (), 2, ()),
        Extra("roll", 0.3, 0.9, {"bias_drift:x": 0.9}, (("rate_lag", "time_offset"),), 2, ("scale_asymmetry:x",)),
    ),
    notes=("A note",),
    runtime_s=1.0,
)  # fmt: skip
EXTRA = """
title = "a roll"
[[interval]]
name = "r1"
activity = "roll slew"
start_s = 6000.0
stop_s = 6600.0
mode = "+x"
"""


@pytest.fixture
def asked(monkeypatch):
    """What plan was called with."""
    seen = {}

    def answer(scenario, **options):
        options["progress"]("linear model", 0.0)
        seen.update(options, scenario=scenario)
        return FOUND

    monkeypatch.setattr("diagnosis.plan.pipeline.plan", answer)
    return seen


def refuse(text):
    raise AssertionError(text)


def test_options_reach_the_plan_and_its_answer_tables_json_and_page(run_cli, asked, tmp_path):
    path = tmp_path / "plan.json"
    shown = run_cli("plan", "trmm", "--json", str(path))
    assert shown.exit_code == 0, shown.output
    for text in ("2 of 3 effects can be seen, 2 pairs", "the most helpful extra maneuver is: again", "bias_drift:xy", "[G]"):
        assert text in shown.stdout
    assert "linear model" in shown.stderr
    document = json.loads(path.read_text(), parse_constant=refuse)
    assert document["format"] == 1
    assert document["effects"][3]["size"] is None
    assert document["extras"][1]["resolved"] == [["rate_lag", "time_offset"]]
    extra = tmp_path / "roll.toml"
    extra.write_text(EXTRA)
    arguments = ["--effect", "bias_drift", "--extra", str(extra), "--no-extras", "--seed", "3"]
    assert run_cli("plan", "trmm", *arguments).exit_code == 0
    assert (asked["effects"], asked["seed"]) == (("bias_drift",), 3)
    assert list(asked["extras"]) == ["a roll"]
    page = tmp_path / "plan.html"
    assert run_cli("plan", "trmm", "--report", str(page)).exit_code == 0
    words = checked(page.read_text()).words
    for text in ("2 of 3 effects can be seen", "bias_drift:xy", "roll", "A note.", "SNR to separate", "gyrocal "):
        assert text.lower() in words.lower()
    alone = build_plan_page(replace(FOUND, pairs=(), extras=())).render_html()
    assert "None at a signal-to-noise ratio of" in checked(alone).words
