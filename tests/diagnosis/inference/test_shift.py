"""A shift, the column whose amplitude is one where its candidate is at work: against normal densities."""

import numpy as np
import pytest
import scipy.stats

from diagnosis.inference.amplitudes import fit
from diagnosis.inference.joint_search import JointSearch
from diagnosis.inference.search import Search
from diagnosis.model.linear import Candidate, Fold, LinearModel, ParameterChoice, SelectedCandidate

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
