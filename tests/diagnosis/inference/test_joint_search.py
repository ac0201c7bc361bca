"""The joint search against sets built on purpose, and its places against the posteriors of sets one by one."""

import numpy as np
import pytest
from scipy.special import logsumexp

from diagnosis.inference.joint_search import JointSearch, infer_set
from diagnosis.inference.search import Search
from diagnosis.model.linear import SelectedCandidate
from diagnosis.posterior import build_credible_group
from diagnosis.settings import DEFAULT
from tests.diagnosis.linear_models import linear_model

ROWS = 240


def smooth(count):
    """(ROWS, count) columns of slow courses, as those of a random process."""
    t = np.linspace(0, np.pi, ROWS)[:, None]
    return np.cos(t * np.arange(1, count + 1)) * np.linspace(1, 0.3, count)


def test_a_pair_is_found_although_a_decoy_explains_more_than_either():
    rng = np.random.default_rng(4)
    a, b = rng.standard_normal((2, ROWS, 1))
    decoy = a + b + 0.35 * rng.standard_normal((ROWS, 1))
    others = [rng.standard_normal((ROWS, 1)) for _ in range(8)]
    y = (3 * a + 3 * b)[:, 0] + rng.standard_normal(ROWS)
    assert JointSearch(Search(linear_model([decoy, a, b, *others], y))).find().key == {1, 2}


def test_two_shapes_take_the_place_of_a_random_error_that_enters_first():
    rng = np.random.default_rng(5)
    slow, t = smooth(12), np.linspace(-1, 1, ROWS)
    drift, wave = t[:, None], np.cos(1.5 * np.pi * t)[:, None]
    search = Search(
        linear_model(
            [slow, drift, wave],
            (2 * drift + 1.5 * wave)[:, 0] + rng.standard_normal(ROWS),
            changes={0: {"listed": False, "process": True}},
        )
    )
    assert search.score_singles()[0].key == {0}
    assert JointSearch(search).find().key == {1, 2}


def test_a_place_has_the_posterior_of_the_sets_that_differ_in_it():
    rng = np.random.default_rng(6)
    a, b, c = rng.standard_normal((3, ROWS, 1))
    near = b + 0.3 * c  # hardly told from b
    y = (1.5 * a + 0.35 * b)[:, 0] + rng.standard_normal(ROWS)
    joint = JointSearch(Search(linear_model([a, b, near], y)))
    best = joint.find()
    assert best.key in ({0, 1}, {0, 2})
    member = next(one for one in best.members if one.candidate != 0)
    place = joint.compute_place(best, member)
    sets = {frozenset(explanation.key): explanation.log_posterior for explanation in joint.explanations}
    logs = np.array([sets[frozenset({0, 1})], sets[frozenset({0, 2})], sets[frozenset({0})]])
    expected = np.exp(logs - logsumexp(logs))
    assert [place.shares[1], place.shares[2], place.rival] == pytest.approx(expected, abs=0.02)
    assert place.shares.get(0, 0.0) == 0.0


def test_a_random_process_is_stated_by_its_character():
    """However clear it is; its probability is that of all processes there, and an effect with a shape has its name."""
    rng = np.random.default_rng(7)
    slow = smooth(12)
    y = slow @ (4 * rng.standard_normal(12)) + rng.standard_normal(ROWS)
    inferred = infer_set(Search(linear_model([slow], y, changes={0: {"process": True}})), DEFAULT)
    assert not inferred.slots[0].named
    assert inferred.slots[0].group_probability == inferred.slots[0].probability == pytest.approx(1)
    assert inferred.slots[0].label == inferred.ranked[0].labels[0] == "gyro slow random"
    shaped = infer_set(Search(linear_model([slow[:, :1]], 4 * slow[:, 0] + rng.standard_normal(ROWS))), DEFAULT)
    assert shaped.slots[0].named
    assert shaped.slots[0].probability > 0.99


def test_random_errors_that_together_outweigh_a_shape_are_stated_and_the_shape_stays_beside_them():
    columns = [np.ones((ROWS, 1)) for _ in range(4)]
    random = {k: {"effect": f"bias_{k}", "axis": "y", "process": True} for k in (1, 2, 3)}
    model = linear_model(columns, np.zeros(ROWS), changes={0: {"effect": "bias_step", "axis": "y"}, **random})
    member = SelectedCandidate(0, 0, 0)
    slot, unlisted = build_credible_group(model.candidates, member, {0: 0.40, 1: 0.30, 2: 0.2, 3: 0.08}, DEFAULT)
    assert (slot.named, slot.label) == (False, "gyro slow random:y")
    assert (slot.probability, slot.group_probability, unlisted) == pytest.approx((0.58, 0.98, 0.42))
    assert [label for label, _ in slot.group] == ["bias_1:y", "bias_2:y", "bias_3:y", "bias_step:y"]
    slot, unlisted = build_credible_group(model.candidates, member, {0: 0.60, 1: 0.30, 2: 0.08}, DEFAULT)
    # Of random errors of one side and axis three in ten are on no list.
    assert (slot.named, slot.probability, slot.group_probability) == pytest.approx((True, 0.60, 0.60 + 0.7 * 0.38))
    assert unlisted == pytest.approx(0.02 + 0.3 * 0.38)
    assert slot.group[0][0] == "bias_step:y"


def test_the_set_says_whether_something_without_a_name_is_in_the_model():
    rng = np.random.default_rng(8)
    a, b = rng.standard_normal((2, ROWS, 1))
    noise = rng.standard_normal(ROWS)
    for y, changes, causes, rest in (
        (2 * a[:, 0], {}, 1, 0),
        (2 * a[:, 0] + 2 * b[:, 0], {1: {"listed": False}}, 1, 1),
        (2 * b[:, 0], {1: {"listed": False}}, 0, 1),
    ):
        inferred = infer_set(Search(linear_model([a, b], y + noise, changes=changes)), DEFAULT)
        assert (len(inferred.slots), len(inferred.remainder)) == (causes, rest)
        assert (inferred.unknown > 0.9) == bool(rest)


def test_noise_alone_has_no_set():
    rng = np.random.default_rng(9)
    columns = [rng.standard_normal((ROWS, 1)) for _ in range(6)]
    found = [JointSearch(Search(linear_model(columns, rng.standard_normal(ROWS)))).find().key for _ in range(40)]
    assert sum(map(bool, found)) <= 4  # each alone has a prior odds of one to many


def test_a_member_without_a_name_is_never_a_cause(monkeypatch):
    """Where listed effects are likelier in its place in the end, it still has no name that a size could be stated for."""
    rng = np.random.default_rng(10)
    a, near = rng.standard_normal((2, ROWS, 1))
    model = linear_model([a, a + 0.01 * near], 3 * a[:, 0] + rng.standard_normal(ROWS), changes={1: {"listed": False}})
    held = Search(model).find_explanation(("e1",))
    monkeypatch.setattr(JointSearch, "find", lambda joint: joint._optimise(held.members))
    monkeypatch.setattr(JointSearch, "prefer_listed", lambda joint, best: best)
    inferred = infer_set(Search(model), DEFAULT)
    assert (inferred.slots, [one.candidate for one in inferred.remainder]) == ((), [1])
