"""From explanations to an answer: what is named, what is a group, and what is unknown."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate

from diagnosis.inference.attribution import (
    REMAINDER,
    average_checks,
    compute_bayes_factor_bound,
    infer_attribution,
    rank_weak_effects,
    weigh_unlisted,
)
from diagnosis.inference.search import BASELINE_EXPLANATION, Explanation, Search
from diagnosis.model.linear import SelectedCandidate
from diagnosis.settings import DiagnosisSettings
from tests.diagnosis.linear_models import linear_model


@pytest.mark.parametrize(("angle", "verdict"), [(90.0, "named"), (0.0, "group")])
def test_what_cannot_be_separated_is_a_group(angle, verdict):
    rng = np.random.default_rng(7)
    Q = np.linalg.qr(rng.standard_normal((100, 4)))[0] * 8
    turn = np.deg2rad(angle)
    columns = [Q[:, [0]], np.cos(turn) * Q[:, [0]] + np.sin(turn) * Q[:, [1]], Q[:, [2]], Q[:, [3]]]
    y = 2 * Q[:, 0] + rng.standard_normal(100) * 0.5
    model = linear_model(columns, y)
    answer = infer_attribution(model, Search(model).explanations())
    assert answer.verdict == verdict
    assert {label for label, _ in answer.slots[0].group} == ({"e0"} if verdict == "named" else {"e0", "e1"})


def test_an_unlisted_rival_that_explains_better_is_unknown():
    rng = np.random.default_rng(8)
    Q = np.linalg.qr(rng.standard_normal((100, 3)))[0] * 8
    columns = [Q[:, [0]], Q[:, [1]], 0.8 * Q[:, [0]] + 0.6 * Q[:, [2]]]
    y = 2 * columns[2][:, 0] + 0.5 * rng.standard_normal(100)
    model = linear_model(columns, y, changes={2: {"listed": False}})
    answer = infer_attribution(model, Search(model).explanations())
    assert answer.verdict == "unknown"
    assert answer.unknown > 0.9
    assert answer.slots == ()
    clear = replace(model, y=2 * Q[:, 0])  # and not always
    assert infer_attribution(clear, Search(clear).explanations()).verdict == "named"


def three(probabilities, listed=(True, True, True)):
    """A model of three candidates, and explanations by their keys with given probabilities."""
    rng = np.random.default_rng(9)
    changes = {number: {"listed": own} for number, own in enumerate(listed)}
    model = linear_model([rng.standard_normal((10, 1)) for _ in range(3)], rng.standard_normal(10), changes=changes)
    found = [
        Explanation(tuple(SelectedCandidate(k, 0, 0) for k in key), 0.0, float(np.log(p)))
        for key, p in probabilities.items()
        if p > 0
    ]
    return model, sorted(found, key=lambda one: -one.log_posterior)


def test_probability_of_a_cause_is_that_of_all_explanations_it_is_part_of():
    answer = infer_attribution(*three({(0,): 0.90, (0, 1): 0.08, (1,): 0.02}))
    assert answer.verdict == "named"
    (slot,) = answer.slots
    assert slot.probability == pytest.approx(0.98)
    assert slot.group == (("e0", slot.probability),)
    assert [one.labels for one in answer.ranked] == [("e0",), ("e0", "e1"), ("e1",)]
    assert [one.probability for one in answer.ranked] == pytest.approx([0.90, 0.08, 0.02])
    assert not any(one.unlisted for one in answer.ranked)


def test_alternatives_stand_in_one_place_of_the_explanation():
    answer = infer_attribution(*three({(0, 1): 0.6, (0, 2): 0.39, (1,): 0.01}))
    assert answer.verdict == "group"
    by_label = {slot.group[0][0]: slot for slot in answer.slots}
    assert by_label["e0"].group == (("e0", pytest.approx(0.99)),)
    assert [label for label, _ in by_label["e1"].group] == ["e1", "e2"]


def test_alternatives_of_small_shares_and_too_many_of_them_are_left_out():
    model, found = three({(0,): 0.7, (1,): 0.29, (2,): 0.01})
    assert [label for label, _ in infer_attribution(model, found).slots[0].group] == ["e0", "e1"]
    (slot,) = infer_attribution(model, found, DiagnosisSettings(group_share=0.001)).slots
    assert [label for label, _ in slot.group] == ["e0", "e1", "e2"]
    assert slot.group[1:] == (("e1", pytest.approx(0.29)), ("e2", pytest.approx(0.01)))
    (slot,) = infer_attribution(model, found, DiagnosisSettings(group_share=0.001, largest_group=1)).slots
    assert slot.group == (("e0", pytest.approx(0.7)),)


@pytest.mark.parametrize(("share", "verdict"), [(0.49, "group"), (0.51, "unknown")])
def test_what_is_unlisted_counts_together(share, verdict):
    """No explanation with something unlisted is the likeliest, all of them together count."""
    model, found = three({(0,): 1 - share, (1,): share / 2, (0, 2): share / 2}, listed=(True, False, False))
    answer = infer_attribution(model, found)
    assert answer.unknown == pytest.approx(share)
    assert answer.verdict == verdict
    assert infer_attribution(model, found, DiagnosisSettings(unknown=0.6)).verdict == "group"


def test_an_effect_of_every_likely_explanation_stays_although_the_rest_is_unlisted():
    model, found = three({(0, 1): 0.5, (0, 2): 0.47, (1,): 0.03}, listed=(True, False, False))
    answer = infer_attribution(model, found)
    assert answer.verdict == "partial"
    assert answer.unknown == pytest.approx(1.0)
    assert [slot.group for slot in answer.slots] == [(("e0", pytest.approx(0.97)),)]
    # A remainder may still stand in its place if it is a random process.
    own = weigh_unlisted(of_kind(model, True), answer, 1.0, PRIORS)
    assert own.slots[0].probability == pytest.approx(0.97 / (1 + 0.5 * 0.25))
    assert weigh_unlisted(model, answer, 1e-12, PRIORS) == answer
    model, found = three({(0, 1): 0.6, (2,): 0.4}, listed=(True, False, False))
    assert infer_attribution(model, found).slots == ()


def test_the_likeliest_number_of_effects_comes_before_the_likeliest_set():
    """One pair is ahead, but that there is a single effect is more probable: which one is open."""
    answer = infer_attribution(*three({(0, 1): 0.4, (0,): 0.35, (2,): 0.25}))
    assert [slot.group[0][0] for slot in answer.slots] == ["e0"]


PRIORS = DiagnosisSettings(unlisted_share=0.2, another=0.1, unknown=1.0)
BESIDE = 0.02 / 0.98  # prior odds of something unlisted beside the effects


def of_kind(model, process, **changes):
    return replace(model, candidates=tuple(replace(one, process=process, **changes) for one in model.candidates))


def test_something_unlisted_beside_an_effect_has_its_prior_probability():
    model, found = three({(0,): 0.99, (1,): 0.01})
    answer = weigh_unlisted(model, infer_attribution(model, found), None, PRIORS)
    assert answer.unknown == pytest.approx(0.02)
    assert answer.slots[0].probability == pytest.approx(0.99)
    assert answer.verdict == "named"
    assert sum(one.probability for one in answer.ranked) == pytest.approx(1)


def test_a_remainder_may_stand_in_the_place_of_a_random_process():
    model, found = three({(0, 1): 1.0})
    model = of_kind(model, True)
    answer = weigh_unlisted(model, infer_attribution(model, found), None, PRIORS)
    assert [slot.probability for slot in answer.slots] == pytest.approx([0.8, 0.8])
    assert answer.verdict == "group"
    chances = {one.labels: one.probability for one in answer.ranked}
    assert chances["e0", "e1"] == pytest.approx(0.8 * 0.8 * 0.98)
    assert chances["e0", "e1", REMAINDER] == pytest.approx(0.8 * 0.8 * 0.02)
    assert chances["e1", REMAINDER] == pytest.approx(0.8 * 0.2)
    assert chances[(REMAINDER,)] == pytest.approx(0.04)
    assert sum(one.probability for one in answer.ranked if one.unlisted) == pytest.approx(answer.unknown)


def test_odds_of_something_unlisted_follow_the_p_value():
    """By hand: at p = 0.001 the factor is (1000 - 1 - 6.9078) / 47.717 = 20.791, and one half where p is one."""
    for p, factor in ((1.0, 0.5), (0.001, 20.791)):
        model, found = three({(0,): 1.0})
        answer = weigh_unlisted(model, infer_attribution(model, found), p, PRIORS)
        assert answer.unknown / (1 - answer.unknown) == pytest.approx(factor * BESIDE, rel=1e-3)
        assert answer.slots[0].probability == 1.0
        answer = weigh_unlisted(of_kind(model, True), infer_attribution(model, found), p, PRIORS)
        assert answer.slots[0].probability == pytest.approx(1 / (1 + factor / 4), rel=1e-3)


@pytest.mark.parametrize(("log_odds", "shown"), [(-2.0, 1.0), (1.0, 1 / np.e), (5.0, np.exp(-5.0))])
def test_a_remainder_does_not_make_what_the_samples_show(log_odds, shown):
    model, found = three({(0,): 1.0})
    answer = weigh_unlisted(of_kind(model, True, log_odds=log_odds), infer_attribution(model, found), None, PRIORS)
    assert answer.slots[0].probability == pytest.approx(1 / (1 + shown / 4))


def test_the_bayes_factor_is_that_of_a_distribution_of_p_values():
    """The density of p-values under an imitation is one over the factor: that of α p^(α − 1) with any α alike."""
    exponents, weights = np.polynomial.legendre.leggauss(60)
    alpha = 0.5 + exponents / 2
    for p in (1e-8, 1e-3, 0.05, 0.17, 0.5, 0.99, 1 - 1e-5, 1.0):
        assert 1 / compute_bayes_factor_bound(p) == pytest.approx(np.sum(weights / 2 * alpha * p ** (alpha - 1)), rel=1e-6)
    # Its area up to p is the integral of p^α, (p − 1)/ln p.
    area, _ = scipy.integrate.quad(
        lambda x: np.exp(-x) / compute_bayes_factor_bound(np.exp(-x)), -np.log(0.2), 400.0, epsabs=1e-9, limit=500
    )
    assert area == pytest.approx((0.2 - 1) / np.log(0.2) - (np.exp(-400) - 1) / -400, rel=1e-5)
    small = np.geomspace(1e-16, 0.3, 50)
    assert all(1 / compute_bayes_factor_bound(p) < 1 / (-np.e * p * np.log(p)) for p in small)  # Sellke, Bayarri and Berger
    assert 1 / compute_bayes_factor_bound(0.0) == 1 / compute_bayes_factor_bound(1e-300)


def test_checks_are_averaged_over_what_may_be_the_case():
    _, found = three({(0,): 0.7, (1,): 0.28, (2,): 0.01, (0, 1): 0.5}, (True, True, True))
    found = [one for one in found if len(one.members) == 1]
    p_values = {frozenset({0}): 1e-6, frozenset({1}): 0.5}
    asked = []

    def check(one):
        asked.append(one.key)
        return p_values[one.key]

    assert average_checks([BASELINE_EXPLANATION, *found], check, lambda one: True) == pytest.approx(0.5 * 0.28 / 0.98, rel=1e-4)
    assert asked == [frozenset({0}), frozenset({1})]  # the third has too little to be asked
    only = average_checks([BASELINE_EXPLANATION, *found], check, lambda one: one.key == frozenset({0}))
    assert only == pytest.approx(1e-6)


def test_what_the_checks_reject_is_unknown():
    model, found = three({(0,): 0.99, (1,): 0.01})
    answer = weigh_unlisted(model, infer_attribution(model, found), 1e-6)
    assert (answer.verdict, answer.slots) == ("unknown", ())
    assert answer.unknown > 0.99
    assert answer.ranked[0].labels == ("e0", REMAINDER)


def test_the_baseline_shares_the_probability_but_is_never_named():
    model, found = three({(0,): 0.6, (1,): 0.4})
    nothing = replace(BASELINE_EXPLANATION, log_posterior=float(np.log(3.0)))
    answer = infer_attribution(model, [nothing, *found])
    assert [slot.group[0][0] for slot in answer.slots] == ["e0"]
    assert answer.slots[0].probability == pytest.approx(0.15)


@pytest.mark.parametrize("p_value", [0.5, 1e-2])
def test_without_a_gap_m0_is_as_likely_as_its_evidence(p_value):
    """M0 has the prior odds one against the rest, and what no candidate shows its share of them."""
    settings = DiagnosisSettings()
    model, explanations = three({(0,): 0.10, (1,): 0.05, (2,): 0.02}, (True, True, False))
    found = rank_weak_effects(model, explanations, p_value, settings)
    hidden = settings.unlisted_share / compute_bayes_factor_bound(p_value)
    norm = 1 + 0.17 + hidden
    assert sum(one.probability for one in found) == pytest.approx(1.0)
    assert [one.probability for one in found if not one.labels] == pytest.approx([1 / norm])
    assert sum(one.probability for one in found if one.unlisted) == pytest.approx((0.02 + hidden) / norm)
    assert [one.probability for one in found] == sorted((one.probability for one in found), reverse=True)
