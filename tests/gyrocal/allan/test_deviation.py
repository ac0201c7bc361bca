import allantools
import numpy as np
import pytest

from gyrocal.allan import overlapping_allan_deviation
from gyrocal.allan.covariance import estimate_covariance
from gyrocal.allan.terms import ANGLE_WHITE, FLICKER, RANDOM_WALK, RATE_WALK, compute_allan_variance
from tests.gyrocal.allan import noises

KINDS = {ANGLE_WHITE: (2, noises.angle_white), RANDOM_WALK: (0, noises.random_walk), RATE_WALK: (-2, noises.rate_walk)}
KINDS[FLICKER] = (-1, noises.flicker)


def compute_degrees(found, term):
    """(t,) equivalent degrees of freedom of the estimates of one term alone."""
    expected = compute_allan_variance(term, found.tau_s)
    return 2 * expected**2 / np.diag(estimate_covariance(found, {term: 1.0}, 1.0))


def test_the_deviation_is_that_of_allantools():
    rates = np.random.default_rng(1).standard_normal(3000).cumsum()
    found = overlapping_allan_deviation([rates], 0.5)
    _, theirs, _, counts = allantools.oadev(rates, rate=2.0, data_type="freq", taus=found.tau_s)
    assert np.allclose(found.deviation, theirs, rtol=1e-9)
    assert np.array_equal(found.counts, counts)


@pytest.mark.parametrize("term", sorted(KINDS))
def test_mean_and_scatter_of_the_deviation_are_as_said(term):
    """Over 200 records the mean is the closed form, and the variance that of the equivalent degrees of freedom."""
    _, make = KINDS[term]
    cases, lengths, factors = 200, (700, 500), [8, 32, 128]
    found = [
        overlapping_allan_deviation(
            [make(np.random.default_rng([7, case, part]), n, 1.0) for part, n in enumerate(lengths)], noises.SAMPLE_S, factors
        )
        for case in range(cases)
    ]
    variance = np.array([one.variance for one in found])
    expected = compute_allan_variance(term, noises.SAMPLE_S * np.array(factors))
    degrees = compute_degrees(found[0], term)
    scatter = expected * np.sqrt(2 / degrees)
    # A walk's value at the samples' ends stands for its mean over them: 1 % at eight samples.
    assert np.all(np.abs(variance.mean(axis=0) - expected) < 4 * scatter / np.sqrt(cases) + 0.01 * expected)
    # The variance of a variance of χ² with ν degrees of freedom has the relative variance (2 + 12/ν)/cases.
    relative = variance.var(axis=0, ddof=1) / scatter**2 - 1
    assert np.all(np.abs(relative) < 4 * np.sqrt((2 + 12 / degrees) / cases))


@pytest.mark.parametrize("term", [FLICKER, RANDOM_WALK, RATE_WALK])
def test_degrees_of_freedom_are_those_of_allantools(term):
    samples = 2000
    found = overlapping_allan_deviation([np.random.default_rng(3).standard_normal(samples)], 0.5)
    # Theirs are of angles that are averaged over a sample, ours of angles at its ends: alike once an average has many samples.
    many = [int(m) for m in found.factors if m >= 32]
    theirs = [allantools.edf_greenhall(KINDS[term][0], 2, m, samples + 1, overlapping=True, modified=False) for m in many]
    assert compute_degrees(found, term)[-len(many) :] == pytest.approx(theirs, rel=0.03)
