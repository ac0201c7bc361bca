"""Amplitudes against brute-force integration over amplitudes, options and scales of tiny models."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from scipy.special import logsumexp

from diagnosis.inference.amplitudes import fit
from diagnosis.inference.search import Search
from diagnosis.model.linear import SelectedCandidate
from tests.diagnosis.linear_models import linear_model


def brute_force(y, options, weights, scales, positive=False):
    """Posterior mean and sigma of one amplitude, by sums over a fine grid of it, all options and all scales."""
    a = np.linspace(-12, 12, 240_001)  # with zero among them
    total = np.zeros_like(a)
    for x, weight in zip(options, weights, strict=True):
        likelihood = np.exp(a * (x @ y) - 0.5 * a**2 * (x @ x))
        for scale in scales:
            prior = scipy.stats.norm.pdf(a, scale=scale) * (2 * np.heaviside(a, 0.5) if positive else 1)
            total += weight * likelihood * prior / len(scales)
    total /= total.sum()
    mean = total @ a
    return mean, np.sqrt(total @ (a - mean) ** 2)


@pytest.mark.parametrize("positive", [False, True])
@pytest.mark.parametrize("true", [0.15, 0.8])
def test_mean_and_sigma_are_those_of_the_whole_posterior(positive, true):
    rng = np.random.default_rng(1)
    options = [rng.standard_normal(8), rng.standard_normal(8), rng.standard_normal(8)]
    y = true * options[1] + rng.standard_normal(8)
    scales = np.geomspace(0.1, 3.0, 7)
    change = {"scales": scales, "positive": positive}
    model = linear_model([[x[:, None] for x in options]], y, changes={0: change})
    (one,) = fit(model, [SelectedCandidate(0, 1, 3)])
    mean, sigma = brute_force(y, options, np.full(3, 1 / 3), scales, positive)
    assert one.size == pytest.approx(mean, rel=1e-6)
    assert one.sigma == pytest.approx(sigma, rel=1e-6)
    assert one.sigmas[0] == pytest.approx(sigma, rel=1e-6)


def test_columns_of_a_scanned_rival_that_are_no_pairs_have_no_phase_to_align():
    rng = np.random.default_rng(2)
    options, y = [rng.standard_normal((8, 3)) for _ in range(2)], rng.standard_normal(8)
    amplitudes = []
    for scanned in (True, False):
        model = linear_model([options], y, changes={0: {"scanned": scanned, "listed": False}})
        (fitted,) = fit(model, [SelectedCandidate(0, 1, 0)])
        amplitudes.append(fitted.amplitudes)
    np.testing.assert_allclose(amplitudes[0], amplitudes[1], rtol=1e-12)


def test_strong_effects_have_the_amplitudes_of_least_squares():
    rng = np.random.default_rng(3)
    columns = [rng.standard_normal((60, 2)), rng.standard_normal((60, 1))]
    nuisance = rng.standard_normal((60, 4))
    true = np.array([30.0, -20.0, 25.0])
    y = np.hstack(columns) @ true + nuisance @ [5.0, 1.0, 2.0, -8.0] + rng.standard_normal(60)
    wide = {number: {"scales": np.array([1e4])} for number in (0, 1)}
    wide[0]["read"] = lambda amplitudes: (float(np.hypot(*amplitudes)), {"phase_deg": 7.0})
    model = linear_model(columns, y, nuisance, wide)
    first, second = fit(model, [SelectedCandidate(0, 0, 0), SelectedCandidate(1, 0, 0)])
    design = np.hstack([*columns, nuisance])
    expected = np.linalg.lstsq(design, y, rcond=None)[0]
    covariance = np.linalg.inv(design.T @ design)
    np.testing.assert_allclose(first.amplitudes, expected[:2], rtol=1e-5)
    np.testing.assert_allclose(second.amplitudes, expected[2:3], rtol=1e-5)
    assert first.size == pytest.approx(np.hypot(*expected[:2]), rel=1e-5)
    assert first.parameters == {"phase_deg": 7.0}
    # With the other held at its best, as the module says: its own uncertainty widens this by less than a tenth here.
    along = expected[:2] / np.hypot(*expected[:2])
    assert first.sigma == pytest.approx(np.sqrt(along @ covariance[:2, :2] @ along), rel=0.1)
    np.testing.assert_allclose(first.contribution, columns[0] @ first.amplitudes)


def test_a_time_that_is_not_known_widens_size_and_time():
    """Steps at many times in noise: size and time are means over the posterior of the time."""
    rng = np.random.default_rng(4)
    n, times = 60, np.arange(4, 57, 2)
    steps = [(np.arange(n) >= t).astype(float) for t in times]
    y = 0.9 * steps[13] + rng.standard_normal(n)
    scales = np.geomspace(0.3, 3, 5)
    model = linear_model([[x[:, None] for x in steps]], y, changes={0: {"scales": scales}})
    (candidate,) = model.candidates
    options = tuple(
        replace(o, parameters={"time_s": float(t), "time_sigma_s": 3.0}) for o, t in zip(candidate.options, times, strict=True)
    )
    model = replace(model, candidates=(replace(candidate, options=options),))
    score = Search(model).score(0, ())
    (one,) = fit(model, [SelectedCandidate(0, score.option, score.scale)])
    mean, sigma = brute_force(y, steps, np.full(len(steps), 1 / len(steps)), scales)
    assert one.size == pytest.approx(mean, rel=1e-6)
    assert one.sigma == pytest.approx(sigma, rel=1e-6)
    table = [
        logsumexp([scipy.stats.multivariate_normal.logpdf(y, np.zeros(n), np.eye(n) + s**2 * np.outer(x, x)) for s in scales])
        for x in steps
    ]
    share = np.exp(table - logsumexp(table))
    expected = share @ times
    assert one.parameters["time_s"] == pytest.approx(expected, rel=1e-6)
    assert one.parameters["time_sigma_s"] == pytest.approx(np.sqrt(share @ (times - expected) ** 2 + 9.0), rel=1e-6)


def test_size_of_a_random_process_is_the_mean_of_its_scale():
    """Against the posterior of s under y ~ N(0, I + s² X Xᵀ) with a prior even in log s, for the densities themselves."""
    rng = np.random.default_rng(5)
    X = rng.standard_normal((40, 25))
    y = rng.standard_normal(40) + 1.5 * X @ rng.standard_normal(25)
    change = {"process": True, "scales": np.geomspace(0.1, 10, 9)}
    model = linear_model([X], y, changes={0: change})
    score = Search(model).score(0, ())
    (one,) = fit(model, [SelectedCandidate(0, 0, score.scale)])
    sizes = np.geomspace(0.05, 50, 600)
    log = np.array([scipy.stats.multivariate_normal.logpdf(y, np.zeros(40), np.eye(40) + s**2 * X @ X.T) for s in sizes])
    weight = np.exp(log - logsumexp(log))
    mean = weight @ sizes
    assert one.process
    assert one.size == pytest.approx(mean, rel=1e-3)
    assert one.sigma == pytest.approx(np.sqrt(weight @ (sizes - mean) ** 2), rel=1e-2)


def test_of_two_elements_that_explain_as_much_the_size_may_be_that_of_either():
    """Rates about two axes go together, one a third of the other: three times the size of its element explains the same."""
    rng = np.random.default_rng(9)
    x = rng.standard_normal((30, 1))
    y = 4 * x[:, 0] + rng.standard_normal(30)
    both, alone = linear_model([[x, x / 3]], y), fit(linear_model([x], y), [SelectedCandidate(0, 0, 4)])[0]
    entry = both.candidates[0]
    named = [replace(one, parameters={"toward": toward}) for one, toward in zip(entry.options, "xz", strict=True)]
    both = replace(both, candidates=(replace(entry, options=tuple(named)),))
    found = fit(both, [SelectedCandidate(0, 0, 4)])[0]
    assert found.size == pytest.approx(alone.size, rel=1e-9)
    assert found.parameters["toward"] == "x"
    share = found.parameters["toward_probability"]
    assert 0.3 < share < 0.9
    other = fit(linear_model([x / 3], y), [SelectedCandidate(0, 0, 4)])[0]
    square = share * alone.sigma**2 + (1 - share) * ((other.size - alone.size) ** 2 + other.sigma**2)
    assert found.sigma == pytest.approx(np.sqrt(square), rel=1e-6)
