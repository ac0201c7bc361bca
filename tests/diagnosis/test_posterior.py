"""From explanations to an answer: what is named, what is a group, and what is unknown."""

import numpy as np
import pytest
import scipy.integrate

from diagnosis.inference.search import Explanation
from diagnosis.model.linear import SelectedCandidate
from diagnosis.posterior import CredibleGroup, compute_bayes_factor_bound, rank_weak_effects, rank_without_naming
from diagnosis.settings import DiagnosisSettings
from diagnosis.verdict import decide_attitude_verdict
from tests.diagnosis.linear_models import linear_model


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


def test_sets_share_the_probability_and_those_with_something_unlisted_count_together():
    model, found = three({(0,): 0.90, (0, 1): 0.08, (2,): 0.02}, listed=(True, True, False))
    answer = rank_without_naming(model, found)
    assert [one.labels for one in answer.ranked] == [("e0",), ("e0", "e1"), ("e2",)]
    assert [one.probability for one in answer.ranked] == pytest.approx([0.90, 0.08, 0.02])
    assert answer.unknown == pytest.approx(0.02)
    assert (answer.verdict, answer.slots) == ("unknown", ())


@pytest.mark.parametrize(
    ("probabilities", "remainder", "verdict"),
    [((0.95, 0.91), False, "named"), ((0.95, 0.89), False, "group"), ((0.6,), True, "partial"), ((), True, "unknown")],
)
def test_a_verdict_follows_from_the_probabilities_and_the_remainder(probabilities, remainder, verdict):
    model, found = three({(0,): 1.0})
    slots = tuple(CredibleGroup(SelectedCandidate(0, 0, 0), p, p, (("e0", p),)) for p in probabilities)
    assert decide_attitude_verdict(rank_without_naming(model, found), slots, remainder).verdict == verdict


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
