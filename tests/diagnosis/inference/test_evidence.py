"""Evidence against the multivariate normal density and numerical integration, and the bound on how far it exaggerates."""

import numpy as np
import pytest
import scipy.integrate
import scipy.stats

from diagnosis.inference import evidence
from diagnosis.inference.evidence import average_evidence, log_bayes


def test_log_bayes_is_the_ratio_of_normal_densities():
    rng = np.random.default_rng(1)
    X, y, s = rng.standard_normal((12, 3)), rng.standard_normal(12) * 2, 0.7
    plain = scipy.stats.multivariate_normal.logpdf(y, np.zeros(12), np.eye(12))
    with_it = scipy.stats.multivariate_normal.logpdf(y, np.zeros(12), np.eye(12) + s**2 * X @ X.T)
    ours = log_bayes((X.T @ X)[None], (X.T @ y)[None], np.array([s]))[0, 0]
    assert ours == pytest.approx(with_it - plain, abs=1e-10)


def test_many_columns_are_scored_as_by_their_eigenvectors(monkeypatch):
    """A strong process has hundreds of columns, some of which nothing shows; it goes by a tridiagonal form."""
    rng = np.random.default_rng(16)
    X = rng.standard_normal((200, 90)) * np.geomspace(30, 1e-4, 90)
    X[:, 7] = X[:, 3]  # no amplitude of its own
    y, scales = X @ rng.standard_normal(90) + rng.standard_normal(200), np.geomspace(1e-3, 10, 8)
    gram, correlation = np.stack([X.T @ X, 4 * X.T @ X]), np.stack([X.T @ y, 2 * X.T @ y])
    ours = log_bayes(gram, correlation, scales)
    monkeypatch.setattr(evidence, "MANY", 91)
    np.testing.assert_allclose(ours, log_bayes(gram, correlation, scales), rtol=1e-11, atol=1e-9)


@pytest.mark.parametrize("mean", [-3.0, 0.4])
@pytest.mark.parametrize("scale", [0.2, 3.0])
def test_evidence_of_an_amplitude_that_is_positive_is_its_integral(mean, scale):
    """∫ over a > 0 of the likelihood ratio under the prior 2 N(0, s²), by quadrature."""
    rng = np.random.default_rng(3)
    x = rng.standard_normal(20)
    y = mean * x / (x @ x) + 0.3 * rng.standard_normal(20)

    def ratio(a):
        return np.exp(a * (x @ y) - 0.5 * a**2 * (x @ x)) * 2 * scipy.stats.norm.pdf(a, scale=scale)

    peak = max(0.0, (x @ y) / (x @ x + 1 / scale**2))
    spread = (x @ x + 1 / scale**2) ** -0.5
    value, _ = scipy.integrate.quad(ratio, max(0.0, peak - 12 * spread), peak + 12 * spread, epsabs=0, epsrel=1e-10, limit=400)
    ours = log_bayes(np.array([[[x @ x]]]), np.array([[x @ y]]), np.array([scale]), positive=True)[0, 0]
    assert ours == pytest.approx(np.log(value), abs=1e-8)


@pytest.mark.parametrize("positive", [False, True])
def test_averaged_evidence_is_the_likelihood_ratio_of_what_it_averages_over(positive):
    """Drawn from the prior over options, scales and amplitudes, 1/B has the mean one: it is the ratio the other way round."""
    rng = np.random.default_rng(4)
    X = rng.standard_normal((20, 5))
    gram, scales, weights = np.einsum("nk,nk->k", X, X)[:, None, None], np.geomspace(0.1, 3, 6), np.array([1, 1, 2, 3, 3]) / 10
    inverse = []
    for _ in range(4000):
        amplitude = rng.choice(scales) * rng.standard_normal()
        y = (abs(amplitude) if positive else amplitude) * X[:, rng.choice(5, p=weights)] + rng.standard_normal(20)
        inverse.append(np.exp(-average_evidence(log_bayes(gram, (X.T @ y)[:, None], scales, positive), np.log(weights))))
    assert abs(np.mean(inverse) - 1) < 4 * np.std(inverse) / np.sqrt(4000)
    assert np.std(inverse) / np.sqrt(4000) < 0.03
