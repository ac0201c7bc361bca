"""Several recordings of one unit as one: the rows of all, common amplitudes, biases of their own, whole recordings held out."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.inference.amplitudes import fit
from diagnosis.inference.closure import compute_closure
from diagnosis.inference.search import Search
from diagnosis.model.linear import SelectedCandidate
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.unit import SETTINGS as UNIT
from diagnosis.model.unit import build_unit_model, join_recordings
from gyrocal import InputError
from simulator import scenario
from simulator.effects import EFFECTS, setting
from simulator.simulate import simulate

NAMES = ("one", "two", "three")
SIZE = 100.0  # ppm of scale asymmetry, hardly visible in one recording
ASYMMETRY = EFFECTS["scale_asymmetry"]


@pytest.fixture(scope="module")
def plan():
    changes = {"gyro.arw_deg_per_sqrt_s": 2e-4, "reference.every_s": 240.0}
    return scenario.override(scenario.load("trmm_series"), changes)


@pytest.fixture(scope="module")
def recordings(plan):
    effects = [setting("scale_asymmetry", "z", SIZE)]
    return {name: simulate(plan, seed=seed, effects=effects) for seed, name in enumerate(NAMES, 20)}


@pytest.fixture(scope="module")
def unit(recordings):
    return join_recordings(recordings)


def about(recording, plan, bias=0.0):
    return linearise_recording(recording, np.array(plan.gyro.true_G), np.deg2rad(plan.gyro.true_bias_deg_s) + bias)


@pytest.fixture(scope="module")
def model(unit, plan):
    return about(unit.recording, plan)


def test_rows_are_those_of_the_recordings_one_under_the_other(recordings, unit, model, plan):
    each = [about(recording, plan) for recording in recordings.values()]
    whitened = np.concatenate([one.whiten(one.zeta) for one in each])
    np.testing.assert_allclose(model.whiten(model.zeta), whitened, atol=1e-6)
    # Columns are made on coarser steps where there are more samples; the propagation is that of every sample.
    calibration = np.vstack([one.calibration for one in each])
    largest = np.abs(calibration).max(axis=0)
    np.testing.assert_allclose(model.calibration / largest, calibration / largest, atol=1e-3)
    assert unit.owner == tuple(name for name, one in recordings.items() for _ in one.intervals)
    assert unit.recording.intervals[-1].name.startswith("three: ")


def test_recordings_that_overlap_follow_one_another(recordings):
    one = recordings["one"]
    later = replace(one, epoch="1998-01-20T00:00:00Z")
    apart = join_recordings({"one": one, "later": later}).recording
    assert apart.intervals[-1].start_s - one.intervals[-1].start_s > 30 * 86400
    beside = join_recordings({"one": one, "again": one}).recording
    count = one.gyro.t_s.size
    assert beside.gyro.t_s[count] - beside.gyro.t_s[count - 1] == pytest.approx(UNIT.apart_s)


def test_samples_of_another_length_are_refused(recordings, plan):
    coarse = simulate(scenario.override(plan, {"gyro.sample_s": 1.0}), seed=1)
    with pytest.raises(InputError, match="samples of one length"):
        join_recordings({"one": recordings["one"], "coarse": coarse})


def test_what_is_not_seen_in_each_is_found_in_all(recordings, unit, model, plan):
    def evidence(linear):
        return Search(linear).find_explanation(("scale_asymmetry:z",)).log_evidence

    together = build_unit_model(model, unit.owner, [ASYMMETRY], rivals=False)
    alone = []
    for name, recording in recordings.items():
        one = join_recordings({name: recording})
        alone.append(evidence(build_unit_model(about(one.recording, plan), one.owner, [ASYMMETRY], rivals=False)))
    assert evidence(together) > max(alone) + 1
    found = fit(together, (SelectedCandidate(together.find("scale_asymmetry:z"), 0, 0),))[0]
    assert found.size == pytest.approx(SIZE, abs=4 * found.sigma)
    assert found.sigma < 0.25 * SIZE


def test_a_bias_of_each_recording_is_no_gap(recordings, plan):
    """The second recording's bias differs by far more than its sigma."""
    other = recordings["two"].gyro
    moved = replace(recordings["two"], gyro=replace(other, rates=other.rates + np.deg2rad([2e-4, -1e-4, 3e-4])))
    unit = join_recordings({"one": recordings["one"], "two": moved})
    model = about(unit.recording, plan)
    shared = build_unit_model(model, unit.owner, [ASYMMETRY], rivals=False)
    own = build_unit_model(model, unit.owner, [ASYMMETRY], rivals=False, own_bias=True)
    assert shared.y @ shared.y > shared.dof + 20 * np.sqrt(2 * shared.dof)
    assert own.dof == shared.dof - 3
    assert own.y @ own.y < own.dof + 5 * np.sqrt(2 * own.dof)
    np.testing.assert_allclose(own.projected(own.X), own.X, atol=1e-9)


def test_whole_recordings_are_held_out(unit, model):
    linear = build_unit_model(model, unit.owner, [ASYMMETRY], rivals=False)
    folds = list(linear.folds(linear.W))
    assert len(folds) == len(NAMES)
    held = [{name.split(": ")[0] for name in fold.dof} for fold in folds]
    assert sorted(held, key=str) == [{"one"}, {"three"}, {"two"}]
    assert sum(fold.left_y.size for fold in folds) == model.size
    closed = compute_closure(linear, Search(linear).find_explanation(("scale_asymmetry:z",)).members)
    assert closed.split == "a recording at a time"
    assert closed.after < closed.before
