import allantools
import numpy as np
import pytest

from gyrocal.allan import overlapping_allan_deviation
from gyrocal.allan.deviation import estimate_covariance
from gyrocal.allan.terms import FLICKER, RANDOM_WALK, RATE_WALK, compute_allan_variance
from tests.gyrocal.allan import noises

POWERS = {RANDOM_WALK: 0, FLICKER: -1, RATE_WALK: -2}  # of the frequency in the spectrum


def compute_degrees(found, term):
    """(t,) equivalent degrees of freedom of the estimates of one term alone."""
    expected = compute_allan_variance(term, found.tau_s)
    return 2 * expected**2 / np.diag(estimate_covariance(found, {term: 1.0}))


def test_the_deviation_is_that_of_allantools():
    rates = np.random.default_rng(1).standard_normal(3000).cumsum()
    found = overlapping_allan_deviation([rates], 0.5)
    _, theirs, _, counts = allantools.oadev(rates, rate=2.0, data_type="freq", taus=found.tau_s)
    assert np.allclose(found.deviation, theirs, rtol=1e-9)
    assert np.array_equal(found.counts, counts)


@pytest.mark.parametrize("term", POWERS)
def test_degrees_of_freedom_are_those_of_allantools(term):
    samples = 2000
    found = overlapping_allan_deviation([np.random.default_rng(3).standard_normal(samples)], 0.5)
    # Theirs are of angles that are averaged over a sample, ours of angles at its ends: alike once an average has many samples.
    many = [int(m) for m in found.factors if m >= 32]
    theirs = [allantools.edf_greenhall(POWERS[term], 2, m, samples + 1, overlapping=True, modified=False) for m in many]
    assert compute_degrees(found, term)[-len(many) :] == pytest.approx(theirs, rel=0.03)


def test_covariance_between_averaging_times():
    """Of white noise with a ramp, against the scatter over 1000 records."""
    cases, n, factors, slope = 1000, 400, [1, 4, 32, 64], 2e-3
    rng = np.random.default_rng(4)
    found = [
        overlapping_allan_deviation([noises.random_walk(rng, n, 1.0) + noises.ramp(n, slope)], noises.SAMPLE_S, factors)
        for _ in range(cases)
    ]
    seen = np.cov(np.array([one.variance for one in found]).T)
    V = estimate_covariance(found[0], {RANDOM_WALK: 1.0, "rate ramp": slope**2})
    scale = np.sqrt(np.outer(np.diag(V), np.diag(V)))
    assert np.all(np.abs(seen - V) / scale < 4 * np.sqrt(2 / cases) * 1.5)  # with the heavier tails of χ²
