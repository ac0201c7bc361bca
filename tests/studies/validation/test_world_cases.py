import json

import numpy as np
import pandas as pd
import pytest

from gyrocal.errors import InputError
from simulator.effects import EFFECTS, Setting, setting
from studies.montecarlo import engine
from studies.montecarlo.study import load_config
from studies.validation.world import cases
from studies.validation.world import study as world_study
from studies.validation.world.answers import merge_axes, score_answer
from studies.validation.world.cases import KIND_ORDER, MIX, MOST_LISTED, NOVEL, draw_case_kind, draw_world_case
from studies.validation.world.instruments import INSTRUMENT_PLANS, draw_instrument
from studies.validation.world.novelty import compute_novelty
from studies.validation.world.report import report
from studies.validation.world.size_search import search_size
from studies.validation.world.sources import find_source
from studies.validation.world.timed_diagnosis import TimedDiagnosis
from studies.validation.world.world import WORLD_SNR, Spec
from tests.studies.validation.world_plans import small_world

SOURCES = ("known", "fresh", "exam/001", "exam/002")


@pytest.mark.parametrize("field", ["families", "plans", "grades"])
def test_sources_share_nothing(field):
    names = [name for source in SOURCES for name in getattr(find_source(source), field)]
    assert len(names) == len(set(names))


def test_a_source_that_is_not_there_is_refused():
    with pytest.raises(InputError, match="no such source"):
        find_source("exam/999")


def test_a_plan_that_suits_no_grade_is_drawn_anew(monkeypatch):
    asked = []

    def refuse(spec, case, name, grade):
        asked.append((name, grade))
        return "a world" if len(asked) == 3 else None

    monkeypatch.setattr(cases, "_draw_world", refuse)
    assert cases.draw_world(Spec("known", 2), 3) == "a world"
    assert len(set(asked)) > 1
    asked.extend([None] * 3)
    with pytest.raises(InputError, match="case 3: no plan"):
        cases.draw_world(Spec("known", 2), 3)


def test_sources_share_no_random_stream():
    draws = {Spec(name, 5).rng(3, "plan").random() for name in SOURCES}
    assert len(draws) == len(SOURCES)


def test_kinds_come_in_their_shares_in_every_block():
    size = sum(MIX)
    for block in range(3):
        kinds = [draw_case_kind(Spec("known", 2), size * block + place) for place in range(size)]
        assert tuple(kinds.count(kind) for kind in KIND_ORDER) == MIX


@pytest.mark.usefixtures("small_plans_only")
@pytest.mark.parametrize("kind", KIND_ORDER)
def test_a_case_is_the_same_again_and_has_what_its_kind_says(kind):
    one = draw_world_case(Spec("known", 2), 3, kind)
    other = draw_world_case(Spec("known", 2), 3, kind)
    assert one.truth() == other.truth()
    assert np.array_equal(one.recording().gyro.rates, other.recording().gyro.rates)
    assert np.array_equal(one.recording().attitudes.quaternions, other.recording().attitudes.quaternions)
    assert all(snr >= 0.9 * WORLD_SNR[0] for snr in one.snr)
    listed = [setting.effect for setting in one.settings if setting.effect in EFFECTS]
    outside = [setting.effect for setting in one.settings if setting.effect in find_source("known").families]
    assert len(listed) in {"none": [0], "single": [1], "pair": [2], "unlisted": [0], "mixed": range(1, MOST_LISTED + 1)}[kind]
    assert len(outside) == (kind in ("unlisted", "mixed"))
    assert len(listed) + len(outside) == len(one.settings)
    assert not outside or one.novelty > NOVEL


def test_instruments_take_turns_and_show_as_strongly_as_is_wanted():
    cases = [draw_instrument(5, case) for case in range(4 * len(INSTRUMENT_PLANS))]
    assert [one.plan for one in cases] == list(INSTRUMENT_PLANS) * 4
    assert [one.setting is None for one in cases] == [False] * 3 * len(INSTRUMENT_PLANS) + [True] * len(INSTRUMENT_PLANS)
    assert all(not one.snr < 7.9 for one in cases)  # 8 but for the nonlinearity of one step
    again = draw_instrument(5, 3)
    assert again.setting == cases[3].setting
    assert np.array_equal(again.recording.attitudes.quaternions, cases[3].recording.attitudes.quaternions)


@pytest.mark.parametrize("name", ["rate_deadzone", "scale_quadratic"])
def test_of_what_follows_the_motion_the_attitude_counts_alone(name):
    """Its jerks are those of the motion, which nobody knows who has the samples only."""
    world = small_world("free")
    one = setting(name, "y", EFFECTS[name].prior[1])
    seen = world.evidence.attitude(world.difference([one]))
    assert world.strength(one) == pytest.approx(np.linalg.norm(seen))
    assert world.strength(one) < np.linalg.norm(world.evidence.combine_evidence(world.difference([one])))


def test_a_listed_effect_is_not_new():
    world = small_world("free")
    for axis in "xyz":
        drift = setting("bias_drift", axis, 20000.0)
        assert world.strength(drift) > 10
        assert compute_novelty(world, drift) < 0.05 * world.strength(drift)


def test_a_size_is_found_for_a_law_of_any_power():
    for power in (0.5, 1.0, 2.0):
        size, reached = search_size(lambda s, power=power: (3 * abs(s)) ** power, -1.0, 20.0, (1e-6, 1e6), WORLD_SNR)
        assert size < 0
        assert reached == pytest.approx(20.0, rel=0.1)
    assert search_size(lambda s: 0.0, 1.0, 20.0, (1e-6, 1e6), WORLD_SNR) is None


def said(*causes, verdict="named", present=True):
    """An answer with causes as (effect, axis, probability, further labels of the group)."""
    stated = [
        {"effect": effect, "axis": axis, "probability": p, "group": [f"{effect}:{axis}", *more], "size": 1.0, "sigma": 0.1}
        for effect, axis, p, *more in causes
    ]
    gap = {"present": present, "p_value": 0.0 if present else 0.5}
    return {"verdict": verdict, "causes": stated, "gap": gap, "unknown_probability": 0.1, "closure": None, "budget": []}


def there(*labels, listed=True):
    parts = [label.partition(":") for label in labels]
    return [{"effect": effect, "axis": axis or None, "listed": listed} for effect, _, axis in parts]


DRIFT, STEP = ("bias_drift", "x", 0.95), ("bias_step", "y", 0.95)
MINE = there("unlisted_mine:z", listed=False)
OUTCOMES = [
    ("none", [], said(verdict="none", present=False), "right"),
    ("none", [], said(DRIFT), "alarm"),
    ("none", [], said(verdict="unknown", present=False), "alarm"),
    ("single", there("bias_drift:x"), said(verdict="none", present=False), "missed"),
    ("single", there("bias_drift:x"), said(DRIFT), "right"),
    ("single", there("bias_drift:y"), said((*DRIFT, "bias_drift:y"), verdict="group"), "group"),
    ("single", there("bias_step:y"), said(DRIFT), "wrong name"),
    ("single", there("bias_step:y"), said(("bias_drift", "x", 0.6)), "other"),
    ("single", there("bias_step:y"), said(STEP, verdict="unknown"), "unknown"),
    ("pair", there("bias_drift:x", "bias_step:y"), said(STEP, DRIFT), "right"),
    ("pair", there("bias_drift:x", "bias_step:y"), said(STEP), "part"),
    ("pair", there("bias_drift:x", "bias_step:z"), said(STEP, DRIFT), "wrong name"),
    ("unlisted", MINE, said(DRIFT), "wrong name"),
    ("unlisted", MINE, said(DRIFT, verdict="group"), "group"),
    ("unlisted", MINE, said(DRIFT, verdict="unknown"), "unknown"),
    ("mixed", [*there("bias_drift:x"), *MINE], said(DRIFT), "part"),
    ("mixed", [*there("bias_drift:x"), *MINE], said(DRIFT, STEP), "wrong name"),
    ("mixed", [*there("bias_drift:x"), *MINE], said(verdict="unknown"), "unknown"),
]


@pytest.mark.parametrize(("kind", "truth", "found", "outcome"), OUTCOMES)
def test_outcomes(kind, truth, found, outcome):
    assert score_answer(kind, truth, found)["outcome"] == outcome


def test_an_effect_about_all_axes_is_one():
    each = [(f"{name}", axis, 0.9) for name in ("rate_quantization",) for axis in "xyz"]
    assert [one["axis"] for one in merge_axes(said(*each)["causes"])] == [None]
    assert score_answer("single", there("rate_quantization"), said(*each))["outcome"] == "right"
    drifts = [("bias_drift", axis, 0.9) for axis in "xyz"]  # which cannot act on all axes at once
    assert len(merge_axes(said(*drifts)["causes"])) == 3


def fake(recording):
    answer = said(verdict="none", present=False) | {
        "posterior": [{"effects": [], "probability": 0.9}],
        "calibration": {"G": np.eye(3), "bias_deg_s": np.zeros(3), "sigma_G": np.ones((3, 3)), "sigma_bias_deg_s": np.ones(3)},
    }
    return TimedDiagnosis(answer, 1.0, 100.0)


@pytest.mark.usefixtures("small_plans_only")
def test_a_small_study_runs_and_resumes(tmp_path, monkeypatch):
    monkeypatch.setattr(world_study, "diagnose_timed", fake)
    config = load_config(world_study.STUDY, None, {"cases": 4, "entropy": 2})
    outcome = engine.run(world_study.STUDY, config, tmp_path, backend="serial")
    assert not outcome.failures
    rows = outcome.load()
    assert (rows["outcome"][rows["kind"] != "none"] == "missed").all()
    for name in ("truth", "causes", "posterior", "size_sigmas", "calibration_sigmas"):
        assert rows[name].map(json.loads).notna().all()
    made = report(config, rows)
    assert made.tables["counts"].data["cases"].sum() == 4
    (tmp_path / "table.parquet").unlink()
    again = engine.run(world_study.STUDY, config, tmp_path, backend="serial")
    assert again.resumed == 4
    pd.testing.assert_frame_equal(again.load(), rows)


def test_an_effect_outside_the_library_acts_after_a_listed_one_of_its_stage():
    """Exam 001 lost a case to this: the order of a stage was that of the registry alone."""
    world = small_world("free")
    family = next(one for one in find_source("known").families.values() if one.stage == "telemetry")
    axis, parameters = family.draw(np.random.default_rng(3), world.surroundings)
    both = [setting("stale_samples", None, 2.0, {"fraction": 0.01}), Setting(family.name, axis, 0.3, parameters)]
    assert EFFECTS["stale_samples"].stage == family.stage
    rates, _ = world.simulate_observations(both)
    assert np.array_equal(rates, world.simulate_observations(both[::-1])[0])
