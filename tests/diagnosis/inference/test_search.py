"""The search against sets built on purpose, and its products against conditioning on the columns one by one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats

from diagnosis.inference.amplitudes import fit
from diagnosis.inference.joint_search import JointSearch
from diagnosis.inference.null import compute_null_p
from diagnosis.inference.search import Search
from diagnosis.model.linear import Candidate, Fold, LinearModel, ParameterChoice, SelectedCandidate
from diagnosis.settings import DiagnosisSettings
from tests.diagnosis.linear_models import SCALES, linear_model


def normal_ratio(y, C):
    """log of the density of y ~ N(0, I + C Cᵀ) over that of N(0, I)."""
    zero, unit = np.zeros(y.size), np.eye(y.size)
    plain = scipy.stats.multivariate_normal.logpdf(y, zero, unit)
    return scipy.stats.multivariate_normal.logpdf(y, zero, unit + C @ C.T) - plain


def test_evidence_of_a_set_is_that_of_its_columns():
    rng = np.random.default_rng(5)
    columns = [rng.standard_normal((30, k)) for k in (1, 2, 6)]
    y = rng.standard_normal(30) * 1.5
    search = Search(linear_model(columns, y))
    given = search.condition_on((SelectedCandidate(1, 0, 3),))
    C = columns[1] * SCALES[3]
    assert given.log_bayes == pytest.approx(normal_ratio(y, C), abs=1e-9)
    for k in (0, 2):
        expected = [normal_ratio(y, np.hstack([C, columns[k] * s])) - normal_ratio(y, C) for s in SCALES]
        assert np.allclose(search.tables(k, given)[0], expected, atol=1e-8)
    # With one scale and one option each there is nothing to average over: the set is one covariance.
    rng = np.random.default_rng(7)
    columns = [rng.standard_normal((25, k)) for k in (1, 2, 1)]
    y = rng.standard_normal(25) * 2
    one = {number: {"scales": np.array([s])} for number, s in enumerate((0.5, 1.5, 0.8))}
    found = Search(linear_model(columns, y, changes=one)).optimise_members(
        (SelectedCandidate(0, 0, 0), SelectedCandidate(1, 0, 0), SelectedCandidate(2, 0, 0))
    )
    C = np.hstack([0.5 * columns[0], 1.5 * columns[1], 0.8 * columns[2]])
    assert found.log_evidence == pytest.approx(normal_ratio(y, C), abs=1e-8)


def test_prior_of_a_set_counts_every_further_effect():
    rng = np.random.default_rng(8)
    columns = [rng.standard_normal((40, 1)) for _ in range(4)]
    settings = DiagnosisSettings(another=0.2)
    search = Search(linear_model(columns, rng.standard_normal(40), most_effects=2, changes={2: {"log_odds": 3.0}}), settings)
    one, two = search.find_explanation(("e0",)), search.find_explanation(("e0", "e2"))
    share = -np.log(4)
    assert one.log_posterior - one.log_evidence == pytest.approx(share + np.log(0.8))
    assert two.log_posterior - two.log_evidence == pytest.approx(2 * share + 3.0 + np.log(0.2))
    assert search.find_explanation(("e0", "nothing")) is None


def test_null_statistic_of_many_is_that_of_each():
    rng = np.random.default_rng(9)
    columns = [rng.standard_normal((30, 1)), rng.standard_normal((30, 2)), [rng.standard_normal((30, k)) for k in (1, 6)]]
    Y = rng.standard_normal((30, 4))
    model = linear_model(columns, Y[:, 0], changes={0: {"positive": True}})
    together = Search(model).compute_null_statistic(model.X.T @ Y)
    for k in range(4):
        search = Search(replace(model, y=Y[:, k]))
        singles = search.score_singles()
        expected = np.log(sum(np.exp(e.log_evidence + model.candidates[next(iter(e.key))].log_prior) for e in singles))
        assert together[k] == pytest.approx(expected, abs=1e-9)
        assert search.compute_observed_statistic() == pytest.approx(expected, abs=1e-9)


def test_p_value_is_uniform_under_m0_and_small_with_an_effect():
    rng = np.random.default_rng(13)
    columns = [rng.standard_normal((50, k)) for k in (1, 1, 2, 8)]
    nuisance = rng.standard_normal((50, 5))
    p = []
    for seed in range(60):
        model = linear_model(columns, rng.standard_normal(50), nuisance)
        p.append(compute_null_p(Search(model), seed, 99))
    assert scipy.stats.kstest(p, "uniform").pvalue > 1e-3
    strong = linear_model(columns, 8 * columns[0][:, 0] + rng.standard_normal(50), nuisance)
    # Beyond what the draws resolve it is the bound on the evidence.
    assert compute_null_p(Search(strong), 0, 99) < 1e-20


@pytest.mark.parametrize(("observed", "expected"), [(0.5, 3 / 10), (2.0, 1 / 10), (4.0, np.exp(-4.0))])
def test_p_value_counts_the_observation_among_the_draws(observed, expected):
    """By hand: of nine draws two are above 0.5, none above 2, and from e⁻⁴ < 1/10 on the bound says more than they do."""
    draws = np.array([1.0, 1.5, *np.zeros(7)])
    model = SimpleNamespace(y=np.zeros(3), X=np.zeros((3, 1)), candidates=(), projected=lambda noise: noise)
    drawn = False

    def statistic(correlation):
        nonlocal drawn
        drawn = True
        return draws

    search = SimpleNamespace(model=model, compute_observed_statistic=lambda: observed, compute_null_statistic=statistic)
    assert compute_null_p(search, seed=0, draws=9) == pytest.approx(expected, rel=1e-12)
    assert drawn == (observed < 4)  # where the bound decides, nothing is drawn


def test_what_a_scan_has_chosen_alarms_by_the_bound_on_its_evidence():
    """Options chosen for the data, with their share of all that were tried: no more false alarms, and a strong one is seen."""
    rng = np.random.default_rng(15)
    tried, share, alarms = 400, 0.05, 0
    every = np.linalg.qr(rng.standard_normal((500, tried)))[0] * 10.0
    other = rng.standard_normal((500, 1))

    def tested(y, seed):
        best = np.argsort(-np.abs(every.T @ y))[:5]
        model = linear_model([other, [every[:, [k]] for k in best]], y)
        entry = model.candidates[1]
        options = tuple(replace(option, log_weight=-float(np.log(tried))) for option in entry.options)
        model = replace(model, candidates=(model.candidates[0], replace(entry, options=options, scanned=True)))
        return Search(model), compute_null_p(Search(model), seed, 199, share)

    for seed in range(150):
        alarms += tested(rng.standard_normal(500), seed)[1] < 0.02
    assert alarms <= 9  # 3 are expected at most
    search, p = tested(rng.standard_normal(500) + 1.4 * every[:, 3], 0)
    average = search.compute_observed_statistic(scanned=True) - search.model.candidates[1].log_prior
    assert np.log(p) == pytest.approx(-average - np.log(share))  # p itself is below any absolute tolerance
    assert p < 1e-6


ROWS = 14
SCALE = 0.7


def candidate(name, start, count, shifted):
    read = (lambda amplitudes: (1.0, {})) if count == 1 and shifted else (lambda amplitudes: (float(amplitudes[0]), {}))
    option = ParameterChoice(start, count, 0.0, {})
    return Candidate(name, None, True, np.log(1 / 3), (option,), np.array([SCALE]), "", read=read, shifted=shifted)


@pytest.fixture
def model():
    """A plain group of two columns, a shift alone, and a group of two columns with a shift; the last is at work."""
    rng = np.random.default_rng(5)
    X = rng.standard_normal((ROWS, 6)) * np.array([1, 1, 3, 1, 1, 3])
    y = X[:, 3:5] @ [0.8, -0.4] + X[:, 5] + rng.standard_normal(ROWS)
    candidates = (candidate("plain", 0, 2, False), candidate("either", 2, 1, True), candidate("both", 3, 3, True))

    def folds(W):
        for part in range(7):
            out = np.arange(ROWS) // 2 == part
            yield Fold(y[~out], W[~out], y[out], W[out], np.array([f"{part}"] * 2), {f"{part}": 2.0})

    return LinearModel(y, X, X, candidates, ROWS, lambda values: values, split="two rows at a time", folds=folds)


def density(y, columns, shift):
    covariance = np.eye(ROWS) + SCALE**2 * columns @ columns.T
    return scipy.stats.multivariate_normal.logpdf(y, shift, covariance)


def test_evidence_and_amplitudes_of_shifts_are_those_of_normal_densities(model):
    search, X, y = Search(model), model.X, model.y
    none = density(y, X[:, :0], np.zeros(ROWS))
    expected = {
        ("plain",): density(y, X[:, :2], np.zeros(ROWS)),
        ("either",): density(y, X[:, :0], X[:, 2]),
        ("both",): density(y, X[:, 3:5], X[:, 5]),
        ("either", "both"): density(y, X[:, 3:5], X[:, 2] + X[:, 5]),
        ("plain", "either", "both"): density(y, X[:, [0, 1, 3, 4]], X[:, 2] + X[:, 5]),
    }
    for labels, value in expected.items():
        assert search.find_explanation(labels).log_evidence == pytest.approx(value - none, abs=1e-9)
        assert search.find_explanation(labels[::-1]).log_evidence == pytest.approx(value - none, abs=1e-9)
    assert [model.candidate(member).label for member in JointSearch(search).find().members] == ["both"]
    members = (SelectedCandidate(1, 0, 0), SelectedCandidate(2, 0, 0))
    either, both = fit(model, members)
    X, y = model.X, model.y
    C = X[:, 3:5]
    expected = np.linalg.solve(C.T @ C + np.eye(2) / SCALE**2, C.T @ (y - X[:, 2] - X[:, 5]))
    np.testing.assert_allclose(both.amplitudes, expected)
    np.testing.assert_allclose(both.contribution, C @ expected + X[:, 5])
    np.testing.assert_allclose(either.contribution, X[:, 2])
    assert (either.size, either.sigma) == (1.0, 0.0)
