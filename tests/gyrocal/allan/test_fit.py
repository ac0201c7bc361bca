from functools import cache

import numpy as np
import pytest

from gyrocal.allan import TERMS, compute_allan_variance, fit_terms, overlapping_allan_deviation
from gyrocal.allan.terms import (
    ANGLE_WHITE,
    FLICKER,
    RAMP,
    RANDOM_WALK,
    RATE_WALK,
    compute_term_covariance,
)
from tests.builders import choose_case_numbers
from tests.gyrocal.allan import noises

SAMPLES = 10000
SEEDS = range(5)  # of the long tier; the first of them otherwise


@cache
def fitted(seed, *parts):
    """The fit of a sum of noises, each given by a function of a generator and a length."""
    rng = np.random.default_rng(seed)
    return fit_terms(overlapping_allan_deviation([sum(part(rng, SAMPLES) for part in parts)], noises.SAMPLE_S))


def noise(make, *numbers):
    return lambda rng, n: make(rng, n, *numbers)


WHITE = noise(noises.random_walk, 1.0)
CASES = {
    "white": ([WHITE], {RANDOM_WALK: 1.0}),
    "readout": ([noise(noises.angle_white, 1.0)], {ANGLE_WHITE: 1.0}),
    "white and readout": ([WHITE, noise(noises.angle_white, 5.0)], {RANDOM_WALK: 1.0, ANGLE_WHITE: 5.0}),
    "flicker": ([WHITE, noise(noises.flicker, 0.2)], {RANDOM_WALK: 1.0, FLICKER: 0.2}),
    "walk": ([WHITE, noise(noises.rate_walk, 0.02)], {RANDOM_WALK: 1.0, RATE_WALK: 0.02}),
    "ramp": ([WHITE, lambda rng, n: noises.ramp(n, 4e-4)], {RANDOM_WALK: 1.0, RAMP: 4e-4}),
}


@pytest.mark.parametrize("records", choose_case_numbers(2, len(SEEDS)))
def test_each_term_is_found_with_its_size(records):
    """The terms that are there are seen nearly always, within four sigma, and no others for sure."""
    pulls = []
    for name, (parts, truth) in CASES.items():
        whole = 0
        for seed in SEEDS[:records]:
            found = fitted(seed, *parts)
            seen = {estimate.term for estimate in found.estimates if estimate.seen}
            sets = [seen, *(set(terms) for terms in found.alternatives)]
            assert set(truth) in sets, name
            if seen == set(truth):
                whole += 1
                pulls += [(found.estimate(term).value - size) / found.estimate(term).sigma for term, size in truth.items()]
        assert whole >= records - 1, name
    assert np.abs(pulls).max() < 4
    assert np.std(pulls) == pytest.approx(1.0, abs=4 / np.sqrt(2 * len(pulls)))


def test_what_is_known_is_no_term():
    rng = np.random.default_rng(9)
    rates = noises.random_walk(rng, SAMPLES, 1.0) + noises.angle_white(rng, SAMPLES, 3.0)
    found = overlapping_allan_deviation([rates], noises.SAMPLE_S)
    fit = fit_terms(found, 9.0 * compute_allan_variance(ANGLE_WHITE, found.tau_s))
    assert [estimate.term for estimate in fit.estimates if estimate.seen] == [RANDOM_WALK]
    assert np.all(np.abs(found.variance / fit.model - 1) < 4 * np.sqrt(2 / fit.degrees))


@pytest.mark.parametrize("term", TERMS[:4])
@pytest.mark.parametrize("tau", [0.01, 0.3, 0.99, 1.01, 40.0])
def test_allan_variance_follows_from_the_covariance(term, tau):
    at = compute_term_covariance(term, np.array([0.0, tau, 2 * tau]))
    z2 = 6 * at[0] - 8 * at[1] + 2 * at[2] + (6.0 if term == ANGLE_WHITE else 0.0)
    assert compute_allan_variance(term, np.array([tau]))[0] == pytest.approx(z2 / (2 * tau**2), rel=1e-4)
