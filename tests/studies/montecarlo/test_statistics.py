"""Verdicts on estimators known to be calibrated, over-confident, under-confident and biased."""

import math

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from studies.calibration import summaries
from studies.montecarlo import statistics

N, P = 400, 3


@pytest.fixture(scope="module")
def cases():
    rng = np.random.default_rng(11)
    covariances = []
    for _ in range(N):
        L = np.tril(rng.normal(size=(P, P))) + 2 * np.eye(P)
        covariances.append(np.diag([1.0, 1e-6, 1e3]) @ L @ L.T @ np.diag([1.0, 1e-6, 1e3]))
    covariances = np.array(covariances)
    errors = np.array([np.linalg.cholesky(V) @ rng.normal(size=P) for V in covariances])
    return errors, covariances


@pytest.mark.parametrize(("scale", "shift"), [(1.5, 0.0), (0.7, 0.0), (1.0, 1.0)])
def test_over_confident_under_confident_and_biased_fail(cases, scale, shift):
    errors, covariances = cases
    sigma = np.sqrt(np.einsum("nii->ni", covariances))
    assert not statistics.check_mean_nees(statistics.compute_nees(scale * errors + shift * sigma, covariances), P).is_inside


def test_bounds_and_intervals_are_those_of_closed_forms():
    check = statistics.check_mean_nees(np.full(200, 12.0), 12, confidence=0.95)
    assert scipy.stats.chi2.cdf(200 * check.upper, 2400) - scipy.stats.chi2.cdf(200 * check.lower, 2400) == pytest.approx(0.95)
    errors = np.array([[0.5, 2.5], [-0.9, 0.1], [1.1, 3.5], [-1.9, 0.0]])
    assert summaries.count_covered(errors, np.ones((4, 2)), "68") == (4, 8)
    assert summaries.count_covered(errors, np.ones((4, 2)), "95") == (6, 8)
    assert summaries.count_covered(errors, np.ones((4, 2)), "99.7") == (7, 8)
    low, high = statistics.compute_binomial_interval(95, 100)
    assert (low, high) == pytest.approx((0.8882, 0.9785), abs=1e-4)  # Wilson's, by hand
    assert statistics.compute_binomial_interval(0, 0) == (0.0, 1.0)  # without a trial nothing is known
    assert np.isnan(statistics.compute_tolerance_interval(np.arange(92.0))).all()  # of Wilks: 93 for 95 % with 95 %
    low, high = statistics.compute_tolerance_interval(np.arange(93.0))
    assert (low, round(high, 2)) == (0.0, 92.0)
    assert np.isnan(statistics.compute_tolerance_interval([])).all()


@pytest.mark.parametrize(("share", "n"), [(0.90, 100), (0.95, 400)])
def test_tolerance_intervals_cover_as_often_as_they_say(share, n):
    """Of 10⁴ repeats, within 1 %; the sampling error of a share is 0.3 %."""
    for law in (scipy.stats.uniform, scipy.stats.t(3), scipy.stats.lognorm(1.0)):
        samples = law.rvs(size=(10_000, n), random_state=np.random.default_rng(1))
        ends = statistics.compute_tolerance_interval(samples, share, share)
        content = law.cdf(ends[:, 1]) - law.cdf(ends[:, 0])
        assert np.mean(content >= share) == pytest.approx(share, abs=0.01)


VALUES = st.lists(st.sampled_from([math.inf, *np.linspace(-1.0, 1.0, 9)]), min_size=1, max_size=300)


@given(VALUES, st.sampled_from([0.05, 0.5, 0.9, 0.95]))
@settings(max_examples=200)
def test_infinite_values_count_as_very_large_ones(values, share):
    """Ends that reach them are infinite, and the others are those of any large number in their place."""
    huge = np.where(np.isinf(values), 1e300, values)
    found = [statistics.compute_quantile(values, share), *statistics.compute_tolerance_interval(values, 0.8, 0.8)]
    large = [np.quantile(huge, share), *statistics.compute_tolerance_interval(huge, 0.8, 0.8)]
    np.testing.assert_allclose(found, np.where(np.array(large) > 1e200, math.inf, large), rtol=1e-12, atol=1e-12)
