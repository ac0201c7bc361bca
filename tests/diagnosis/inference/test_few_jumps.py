"""Random processes against a few jumps: densities by hand, true processes that are not doubted, states that are found."""

from itertools import combinations

import numpy as np
import pytest
import scipy.stats

from diagnosis.inference import few_jumps
from diagnosis.inference.few_jumps import log_evidence

COUNT = 60
EVEN = np.full(COUNT, 1 / COUNT)
STEPS = np.tril(np.ones((COUNT, COUNT)))


def walk(size):
    """Columns of a random walk of a step that shows a size."""
    return size * STEPS


def log_odds(y, weights, C):
    """Of a few jumps against a process of columns C."""
    process = scipy.stats.multivariate_normal(np.zeros(COUNT), np.eye(COUNT) + C @ C.T).logpdf(y)
    nothing = scipy.stats.multivariate_normal(np.zeros(COUNT), np.eye(COUNT)).logpdf(y)
    return log_evidence(STEPS.T @ y, STEPS.T @ STEPS, weights) - (process - nothing)


def test_the_evidence_is_a_lower_bound_of_all_sets_of_jumps(monkeypatch):
    """Of eight places and two jumps at most, all sets can be summed, with weights as in the module."""
    monkeypatch.setattr(few_jumps, "MOST", 2)
    rng, places = np.random.default_rng(2), 8
    D, others = rng.standard_normal((COUNT, places)), rng.standard_normal((COUNT, 2))
    weights = rng.dirichlet(np.ones(places))
    y = 6 * D[:, 3] - 4 * D[:, 5] + rng.standard_normal(COUNT)
    S = np.eye(COUNT) + others @ others.T
    usual = np.sqrt(np.median(np.sum(D * np.linalg.solve(S, D), axis=0)))

    def density(covariance):
        return scipy.stats.multivariate_normal(np.zeros(COUNT), covariance).logpdf(y)

    terms = []
    for k in (1, 2):
        for chosen in combinations(range(places), k):
            A = D[:, chosen]
            prior = np.log(0.5) + np.log(k) + np.log(weights[list(chosen)]).sum()
            kinds = A, A @ (-1.0) ** np.arange(k)[:, None]
            of_kinds = [
                np.logaddexp.reduce([density(S + (size / usual) ** 2 * one @ one.T) for size in few_jumps.SIZES])
                for one in kinds
            ]
            terms.append(prior + np.logaddexp(*of_kinds) - np.log(2 * few_jumps.SIZES.size))
    inverse = np.linalg.inv(S)
    found = log_evidence(D.T @ inverse @ y, D.T @ inverse @ D, weights)
    assert found <= np.logaddexp.reduce(terms) - density(S) + 1e-9
    assert found == pytest.approx(np.max(terms) - density(S), abs=1e-8)


@pytest.mark.parametrize("size", [0.3, 1.0, 5.0])
def test_a_true_process_is_not_doubted_more_often_than_stated(size):
    """P(B ≥ b) ≤ 1/b, whatever the process."""
    rng, cases = np.random.default_rng(3), 150
    C = walk(size)
    odds = [log_odds(C @ rng.standard_normal(COUNT) + rng.standard_normal(COUNT), EVEN, C) for _ in range(cases)]
    for beyond in (3.0, 10.0, 30.0):
        expected = cases / beyond
        assert np.sum(np.array(odds) >= np.log(beyond)) <= expected + 4 * np.sqrt(expected)


@pytest.mark.parametrize("levels", [[(20, 10.0), (35, -10.0)], [(10, 8.0), (22, -8.0), (30, 8.0), (47, -8.0)]])
def test_a_state_that_is_on_or_off_is_more_likely_to_have_jumped(levels):
    rng = np.random.default_rng(4)
    y = sum(size * STEPS[:, place] for place, size in levels) + rng.standard_normal(COUNT)
    assert min(log_odds(y, EVEN, walk(size)) for size in (0.3, 1.0, 3.0, 10.0)) > 3


def test_a_state_of_two_levels_is_told_by_its_one_size():
    """The last of its jumps has another size: without one size for all, both are as likely."""
    rng, places = np.random.default_rng(6), [6, 13, 19, 28, 33, 41, 50]
    turns, noise = (-1.0) ** np.arange(len(places)), rng.standard_normal(COUNT)
    two = STEPS[:, places] @ (5.0 * turns) + noise
    many = STEPS[:, places] @ (5.0 * turns * np.array([1, 2, 0.5, 1, 3, 2, 0.7])) + noise
    assert log_odds(two, EVEN, walk(3.0)) > 4
    assert log_odds(two, EVEN, walk(3.0)) - log_odds(many, EVEN, walk(3.0)) > 3


def test_jumps_where_they_are_expected_cost_less():
    rng = np.random.default_rng(5)
    places = [12, 25, 41]
    y = STEPS[:, places] @ np.array([5.0, -9.0, 7.0]) + rng.standard_normal(COUNT)
    expected = np.full(COUNT, 0.5 / COUNT)
    expected[places] += 0.5 / 3
    assert log_odds(y, expected, walk(2.0)) > log_odds(y, EVEN, walk(2.0)) + 4


def test_jumps_at_all_of_known_moments_pay_for_no_places():
    """Half of the prior is theirs: by the density, written down."""
    rng = np.random.default_rng(8)
    places = np.arange(4, COUNT, 8)
    y = STEPS[:, places] @ rng.normal(0.0, 2.0, places.size) + rng.standard_normal(COUNT)
    A, usual = STEPS[:, places], np.sqrt(np.median(np.diag(STEPS.T @ STEPS)))
    flat = scipy.stats.multivariate_normal(np.zeros(COUNT), np.eye(COUNT)).logpdf(y)
    each = [
        scipy.stats.multivariate_normal(np.zeros(COUNT), np.eye(COUNT) + (size / usual) ** 2 * A @ A.T).logpdf(y)
        for size in few_jumps.SIZES
    ]
    known = np.logaddexp.reduce(each) - np.log(len(each)) - flat
    anywhere = log_evidence(STEPS.T @ y, STEPS.T @ STEPS, EVEN)
    found = log_evidence(STEPS.T @ y, STEPS.T @ STEPS, EVEN, [places])
    assert found == pytest.approx(np.logaddexp(known, anywhere) - np.log(2.0), abs=1e-8)
    assert found > anywhere + 5
