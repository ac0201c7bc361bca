"""Evidence against the multivariate normal density, and the search against sets built on purpose."""

import numpy as np
import pytest
import scipy.stats

from diagnosis.inference.attribution import attribute
from diagnosis.inference.evidence import Conditioning, Option, averaged, log_bayes, scales_of
from diagnosis.inference.search import Member, Search
from diagnosis.model.candidates import Bank, Candidate
from diagnosis.model.localization import benjamini_hochberg, holm


def _bank(columns, listed=None, prior=None):
    """A bank with one candidate for each array of columns."""
    candidates, start = [], 0
    for k, part in enumerate(columns):
        option = Option(start, part.shape[1], 0.0, {})
        share = -np.log(len(columns)) if prior is None else prior[k]
        own = True if listed is None else listed[k]
        candidates.append(Candidate(f"e{k}", None, own, share, (option,), np.geomspace(0.3, 30, 9), ""))
        start += part.shape[1]
    W = np.hstack(columns)
    return Bank(W, W, tuple(candidates))


def test_log_bayes_is_the_ratio_of_normal_densities():
    rng = np.random.default_rng(1)
    X, y, s = rng.standard_normal((12, 3)), rng.standard_normal(12) * 2, 0.7
    plain = scipy.stats.multivariate_normal.logpdf(y, np.zeros(12), np.eye(12))
    with_it = scipy.stats.multivariate_normal.logpdf(y, np.zeros(12), np.eye(12) + s**2 * X @ X.T)
    ours = log_bayes((X.T @ X)[None], (X.T @ y)[None], np.array([s]))[0, 0]
    assert ours == pytest.approx(with_it - plain, abs=1e-10)


def test_evidence_given_another_is_that_of_both_less_that_of_the_other():
    rng = np.random.default_rng(2)
    X, Z, y = rng.standard_normal((15, 2)), rng.standard_normal((15, 3)), rng.standard_normal(15) * 2
    given = Conditioning(Z, y)
    reduced = given.reduced(X)
    gram, correlation = X.T @ X - reduced.T @ reduced, X.T @ y - reduced.T @ given.y
    conditional = log_bayes(gram[None], correlation[None], np.array([1.0]))[0, 0]
    assert given.log_bayes + conditional == pytest.approx(Conditioning(np.hstack([X, Z]), y).log_bayes, abs=1e-10)


def test_averaged_evidence_seldom_exaggerates():
    """P(B ≥ c) ≤ 1/c under the baseline."""
    rng = np.random.default_rng(3)
    X = rng.standard_normal((40, 6))
    scales = np.geomspace(0.1, 10, 8)
    values = []
    for _ in range(3000):
        y = rng.standard_normal(40)
        table = log_bayes(np.einsum("nk,nk->k", X, X)[:, None, None], (X.T @ y)[:, None], scales)
        values.append(np.exp(averaged(table, np.full(6, -np.log(6)))))
    values = np.array(values)
    for c in (5, 20):
        bound = scipy.stats.binom.ppf(0.9999, 3000, 1 / c)
        assert (values >= c).sum() <= bound
    assert (values >= 5).any()  # it can


def test_scales_hold_only_what_is_visible_and_plausible():
    assert scales_of(0.0, (1.0, 2.0)).size == 0
    assert scales_of(1e-6, (1.0, 2.0)).size == 0  # nothing plausible could be seen
    scales = scales_of(10.0, (0.01, 5.0))
    assert scales.min() == pytest.approx(0.1)
    assert scales.max() == pytest.approx(5.0)


def test_the_best_pair_is_found_although_the_best_single_is_not_in_it():
    rng = np.random.default_rng(4)
    a, b = rng.standard_normal((2, 200, 1))
    decoy = a + b + 0.35 * rng.standard_normal((200, 1))  # nearest to the sum of both
    others = [rng.standard_normal((200, 1)) for _ in range(8)]
    y = (3 * a + 3 * b)[:, 0] + rng.standard_normal(200)
    search = Search(_bank([decoy, a, b, *others]), y)
    assert search.singles()[0].key == {0}
    assert search.explanations()[0].key == {1, 2}


def test_conditional_scores_are_those_of_the_columns_themselves():
    """The search's products against conditioning on the columns one by one."""
    rng = np.random.default_rng(5)
    columns = [rng.standard_normal((30, k)) for k in (1, 2, 6)]
    y = rng.standard_normal(30) * 1.5
    bank = _bank(columns)
    search = Search(bank, y)
    member = Member(1, 0, 3)
    given = search.given((member,))
    C = columns[1] * bank.candidates[1].scales[3]
    for k in (0, 2):
        expected = [
            Conditioning(np.hstack([C, columns[k] * s]), y).log_bayes - Conditioning(C, y).log_bayes
            for s in bank.candidates[k].scales
        ]
        assert np.allclose(search.tables(k, given)[0], expected, atol=1e-9)


def test_null_statistic_of_many_is_that_of_each():
    rng = np.random.default_rng(6)
    columns = [rng.standard_normal((30, k)) for k in (1, 2, 6)]
    bank = _bank(columns)
    Y = rng.standard_normal((30, 4))
    together = Search(bank, Y[:, 0]).null_statistic(bank.X.T @ Y)
    for k in range(4):
        search = Search(bank, Y[:, k])
        expected = np.log(sum(np.exp(e.log_evidence + bank.candidates[next(iter(e.key))].log_prior) for e in search.singles()))
        assert together[k] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("angle", "verdict"), [(90.0, "named"), (0.0, "group")])
def test_what_cannot_be_separated_is_a_group(angle, verdict):
    rng = np.random.default_rng(7)
    Q = np.linalg.qr(rng.standard_normal((100, 4)))[0] * 8
    turn = np.deg2rad(angle)
    columns = [Q[:, [0]], np.cos(turn) * Q[:, [0]] + np.sin(turn) * Q[:, [1]], Q[:, [2]], Q[:, [3]]]
    y = 2 * Q[:, 0] + rng.standard_normal(100) * 0.5
    bank = _bank(columns)
    answer = attribute(bank, Search(bank, y).explanations())
    assert answer.verdict == verdict
    assert {label for label, _ in answer.slots[0].group} == ({"e0"} if verdict == "named" else {"e0", "e1"})


def test_an_unlisted_rival_that_explains_better_is_unknown():
    rng = np.random.default_rng(8)
    Q = np.linalg.qr(rng.standard_normal((100, 3)))[0] * 8
    columns = [Q[:, [0]], Q[:, [1]], 0.8 * Q[:, [0]] + 0.6 * Q[:, [2]]]
    y = 2 * columns[2][:, 0] + 0.5 * rng.standard_normal(100)
    bank = _bank(columns, listed=[True, True, False])
    answer = attribute(bank, Search(bank, y).explanations())
    assert answer.verdict == "unknown"
    assert answer.unknown > 0.9
    assert attribute(bank, Search(bank, 2 * Q[:, 0]).explanations()).verdict == "named"  # and not always


def test_holm_and_benjamini_hochberg_by_hand():
    p = np.array([0.01, 0.04, 0.03, 0.005])
    assert np.allclose(holm(p), [0.03, 0.06, 0.06, 0.02])
    assert benjamini_hochberg(np.array([0.001, 0.6, 0.02, 0.9]), 0.05).tolist() == [True, False, True, False]
    assert not benjamini_hochberg(np.array([0.2, 0.6]), 0.05).any()
