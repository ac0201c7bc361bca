import json

import numpy as np
import pandas as pd
import pytest

from simulator.effects import EFFECTS, setting
from studies.montecarlo import engine
from studies.montecarlo.study import load_config
from studies.validation.wide import study as wide
from studies.validation.wide.cases import MIX, NOVEL, ORDER, draw, kind_of
from studies.validation.wide.families import FAMILIES
from studies.validation.wide.kinds import GRADES, KINDS
from studies.validation.wide.novelty import novelty
from studies.validation.wide.placing import scaled
from studies.validation.wide.report import report
from studies.validation.wide.split import part
from studies.validation.wide.world import SNR, Spec
from tests.studies.validation.wide_plans import small_world

CHEAP = 4


@pytest.mark.parametrize(
    ("field", "everything", "fewest"), [("families", FAMILIES, 36), ("plans", KINDS, 8), ("grades", GRADES, 5)]
)
def test_the_split_leaves_nothing_out_shares_nothing_and_scores_many(field, everything, fewest):
    setting_, scored = (set(getattr(part(name), field)) for name in ("setting", "scored"))
    assert not setting_ & scored
    assert setting_ | scored == set(everything)
    assert len(scored) >= fewest


def test_the_parts_share_no_random_stream():
    draws = [Spec(name, 5).rng(3, "plan").random() for name in ("setting", "scored")]
    assert draws[0] != draws[1]


def test_kinds_come_in_their_shares_in_every_block():
    for block in range(3):
        kinds = [kind_of(Spec("setting", 2), 20 * block + place) for place in range(20)]
        assert tuple(kinds.count(kind) for kind in ORDER) == MIX


QUICK = dict(zip(ORDER, (1, 3, 6, 10), strict=True))  # of the first twenty cases, one of each kind that is soon drawn


@pytest.mark.parametrize(("kind", "case"), QUICK.items())
def test_a_case_is_the_same_again_and_has_what_its_kind_says(kind, case):
    assert kind_of(Spec("setting", 2), case) == kind
    one, other = draw(Spec("setting", 2), case), draw(Spec("setting", 2), case)
    assert one.truth() == other.truth()
    assert np.array_equal(one.recording().gyro.rates, other.recording().gyro.rates)
    assert np.array_equal(one.recording().attitudes.quaternions, other.recording().attitudes.quaternions)
    assert len(one.settings) == {"none": 0, "single": 1, "pair": 2, "unlisted": 1}[kind]
    assert all(snr >= 0.9 * SNR[0] for snr in one.snr)
    names = {setting.effect for setting in one.settings}
    if kind == "unlisted":
        assert names <= set(part("setting").families)
        assert one.novelty > NOVEL
    else:
        assert names <= set(EFFECTS)


@pytest.mark.parametrize("name", ["rate_deadzone", "scale_quadratic"])
def test_of_what_follows_the_motion_the_attitude_counts_alone(name):
    """Its jerks are those of the motion, which nobody knows who has the samples only."""
    world = small_world("free")
    one = setting(name, "y", EFFECTS[name].prior[1])
    seen = world.evidence.attitude(world.difference([one]))
    assert world.strength(one) == pytest.approx(np.linalg.norm(seen))
    assert world.strength(one) < np.linalg.norm(world.evidence.seen(world.difference([one])))


def test_a_listed_effect_is_not_new():
    world = small_world("free")
    for axis in "xyz":
        drift = setting("bias_drift", axis, 20000.0)
        assert world.strength(drift) > 10
        assert novelty(world, drift) < 0.05 * world.strength(drift)


def test_a_size_is_found_for_a_law_of_any_power():
    for power in (0.5, 1.0, 2.0):
        size, reached = scaled(lambda s, power=power: (3 * abs(s)) ** power, -1.0, 20.0, (1e-6, 1e6), SNR)
        assert size < 0
        assert reached == pytest.approx(20.0, rel=0.1)
    assert scaled(lambda s: 0.0, 1.0, 20.0, (1e-6, 1e6), SNR) is None


def test_outcomes():
    seen = {"present": True, "verdict": "named", "exact": False, "in_group": False, "wrong_name": True}
    sure, unsure = ({"causes": [{"probability": p}]} for p in (0.95, 0.6))
    assert wide.outcome("none", seen, sure) == "alarm"
    assert wide.outcome("none", seen | {"present": False}, sure) == "right"
    assert wide.outcome("single", seen | {"present": False}, sure) == "missed"
    assert wide.outcome("single", seen | {"exact": True, "wrong_name": False}, sure) == "right"
    assert wide.outcome("pair", seen | {"in_group": True, "wrong_name": False}, sure) == "group"
    assert wide.outcome("unlisted", seen, sure) == "wrong name"
    assert wide.outcome("unlisted", seen, unsure) == "other"
    assert wide.outcome("unlisted", seen | {"verdict": "unknown"}, sure) == "unknown"


def fake(recording):
    return {
        "verdict": "none",
        "gap": {"present": False, "p_value": 0.5},
        "causes": [],
        "closure": None,
        "unknown_probability": 0.1,
        "p_values": {"attitude": 0.5},
        "posterior": [{"effects": [], "probability": 0.9}],
        "calibration": {"G": np.eye(3).tolist(), "baseline_G": np.eye(3).tolist()},
        "runtime_s": 0.0,
        "size": len(recording.gyro.t_s),
    }


def test_a_small_study_runs_and_resumes(tmp_path, monkeypatch):
    monkeypatch.setattr(wide, "diagnosed", fake)
    changes = {"cases": CHEAP, "entropy": 2, "part": "setting"}
    config = load_config(wide.STUDY, None, changes)
    outcome = engine.run(wide.STUDY, config, tmp_path, backend="serial", chunk=2)
    assert not outcome.failures
    rows = outcome.load()
    assert (rows["outcome"][rows["kind"] != "none"] == "missed").all()
    for name in ("truth", "causes", "p_values", "posterior", "answer", "size_sigmas"):
        assert rows[name].map(json.loads).notna().all()
    made = report(config, rows)
    assert made.tables["counts"].data["cases"].sum() == CHEAP
    (tmp_path / "table.parquet").unlink()
    again = engine.run(wide.STUDY, config, tmp_path, backend="serial", chunk=2)
    assert again.resumed == CHEAP
    pd.testing.assert_frame_equal(again.load(), rows)
