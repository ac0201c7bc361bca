"""The drawing of cases, and what counts as right."""

import json

import numpy as np
import pytest

from simulator.effects import EFFECTS, Setting, setting
from studies.withheld import cases, judgement
from studies.withheld.cases import WithheldConfig
from studies.withheld.drawing import MIX, SNR, Placed, draw_case, draw_kind
from studies.withheld.families import FAMILIES
from studies.withheld.judgement import judge_causes, measure_unexplained_power
from studies.withheld.plans import PLANS
from tests.studies.withheld.conftest import make_case

ENTROPY = 5


def state(effect, axis, size=1.0, p=0.95, **parameters):
    """A stated cause."""
    group = [Setting(effect, axis, 0.0).label()]
    stated = {"effect": effect, "axis": axis, "size": size, "sigma": 0.1, "parameters": parameters}
    return {**stated, "probability": p, "group": group}


def test_case_depends_on_entropy_and_number_only():
    first = draw_case(ENTROPY, 1)
    draw_case(ENTROPY, 7)
    again, other = draw_case(ENTROPY, 1), draw_case(ENTROPY + 1, 1)
    assert again.settings == first.settings
    np.testing.assert_array_equal(again.world.record(again.settings).gyro.rates, first.world.record(first.settings).gyro.rates)
    assert other.world.plan.plain.gyro.arw != first.world.plan.plain.gyro.arw


def test_kinds_have_exact_shares():
    count = sum(MIX.values())
    kinds = [draw_kind(ENTROPY, case) for case in range(2 * count)]
    assert {kind: kinds.count(kind) for kind in MIX} == {kind: 2 * number for kind, number in MIX.items()}


@pytest.mark.parametrize("kind", ["pair", "withheld", "mixed"])
def test_effects_of_a_kind(kind):
    number = next(case for case in range(40) if draw_kind(ENTROPY, case) == kind)
    drawn = draw_case(ENTROPY, number)
    names = [one.effect for one in drawn.settings]
    assert sum(name in FAMILIES for name in names) == (kind == "mixed")
    assert len(names) == {"pair": 2, "withheld": 1}.get(kind, len(names))
    assert all(0.7 * SNR[0] < one.snr < 1.4 * SNR[1] for one in drawn.effects)
    assert (drawn.allowed_names is None) == (kind != "withheld")
    if kind == "withheld":
        assert set(EFFECTS) - set(drawn.allowed_names) == set(names)
    assert drawn.world.plan.kind in PLANS


@pytest.mark.parametrize("name", [name for name, one in FAMILIES.items() if set(one.needs) <= {"turns"}])
def test_family_acts_on_its_side(turning, name):
    family = FAMILIES[name]
    size = 0.3 if family.unit == "share" else 30.0 if family.unit in ("ppm", "deg/h") else 0.01
    one = Setting(name, "y" if family.axes else None, size, {"phase_deg": 40.0, "share": 0.4, "pace": 0.6})
    change = turning.change(one)
    assert change.raw.any() == (not family.on_references)
    assert change.reference.any() == family.on_references
    again = turning.change(one)
    np.testing.assert_array_equal(change.raw, again.raw)


# ---- the rule of 2 % -------------------------------------------------------------------------------------------------------


def test_short_lag_is_a_delay(turning):
    lag = setting("rate_lag", None, 0.05)
    assert measure_unexplained_power(turning, lag, state("time_offset", None, 0.05)) < 1e-3


def test_step_is_no_drift(turning):
    """The negative control: the same side and axis, and another waveform."""
    step = setting("bias_step", "x", 1.0, {"time_s": 1000.0})
    assert measure_unexplained_power(turning, step, state("bias_drift", "x")) > 0.1
    assert measure_unexplained_power(turning, step, state("bias_step", "x", time_s=1000.0)) < 1e-9
    assert measure_unexplained_power(turning, step, state("bias_step", "x", time_s=1300.0)) > 0.02


def test_an_error_without_a_name_is_right_on_its_side_and_axis(turning):
    walk = Placed(setting("bias_random_walk", "y", 5.0, {"gaps": "hold"}), 20.0, 0.0)
    drawn = make_case(turning, "single", walk)
    there = {**state("bias_markov", "y"), "group": ["bias_markov:y", "bias_random_walk:y"]}
    elsewhere = {**state("bias_markov", "z"), "group": ["bias_markov:z"]}
    for one in (there, elsewhere):
        del one["effect"]
    right, wrong = judge_causes(drawn, [there, elsewhere])
    assert (right["named"], right["right"], right["hits"], wrong["right"], wrong["hits"]) == (False, True, [0], False, [])
    assert judgement.score_truth(drawn, {"gyro slow random:y": 0.2, "unknown": 0.1}) == 0.2
    assert judgement.score_truth(drawn, {"gyro slow random:z": 0.0, "unknown": 0.1}) == 1.0
    unlisted = make_case(turning, "unlisted", walk)
    assert judgement.score_truth(unlisted, {"gyro slow random:y": 0.2, "unknown": 0.7}) == 0.2


def test_judgement_and_outcome(turning):
    placed = Placed(setting("bias_step", "x", 1.0, {"time_s": 2000.0}), 20.0, 0.0)
    drawn = make_case(turning, "single", placed)
    right, wrong_axis = judge_causes(drawn, [state("bias_step", "x", time_s=2000.0), state("bias_drift", "z")])
    assert (right["right"], right["hits"], wrong_axis["right"], wrong_axis["near"]) == (True, [0], False, [])
    near = judge_causes(drawn, [state("bias_drift", "x")])
    (listed,) = judge_causes(drawn, [{**state("bias_drift", "z"), "group": ["bias_drift:z", "bias_step:x"]}])
    assert [one["in_set"] for one in (right, wrong_axis, listed)] == [True, False, True]
    assert not listed["right"]
    decide = judgement.decide_outcome
    assert decide("single", True, 1, [right], "named") == "right"
    assert decide("single", True, 1, [right, wrong_axis], "named") == "wrong"
    assert decide("pair", True, 2, [right], "named") == "part"
    assert decide("withheld", True, 1, near, "named") == "localised"
    assert decide("withheld", True, 1, [wrong_axis], "named") == "wrong"
    stated = {key: value for key, value in state("bias_markov", "x").items() if key != "effect"}
    (by_side,) = judge_causes(drawn, [stated])
    assert decide("unlisted", True, 1, [by_side], "group") == "localised"
    assert decide("none", False, 0, [], "none") == "right"
    assert decide("unlisted", True, 1, [right], "unknown") == "unknown"


def test_effects_with_one_symptom_are_one_answer(turning):
    drawn = make_case(turning, "withheld", Placed(setting("rate_truncation", "x", 0.01), 0.0, 20.0))
    group = {"group": ["rate_quantization:x", "rate_truncation:x"], "group_probability": 0.95}
    (judged,) = judge_causes(drawn, [{**state("rate_quantization", "x", p=0.475), **group}])
    assert (judged["right"], judged["hits"], judged["p"]) == (True, [0], 0.95)
    assert {"rate_truncation", "rate_quantization"}.isdisjoint(drawn.allowed_names)


# ---- a run -----------------------------------------------------------------------------------------------------------------


def test_row_of_a_diagnosed_case():
    number = next(case for case in range(40) if draw_kind(ENTROPY, case) == "none")
    row = cases.run_case(WithheldConfig(entropy=ENTROPY), number, None)
    assert row["kind"] == "none"
    assert row["outcome"] in ("right", "alarm")
    assert row["diagnose_s"] > 0
    assert row["peak_mb"] > 50
    assert json.loads(row["truth"]) == []
