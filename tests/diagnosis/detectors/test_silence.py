"""Silent stretches of a gyro, against the truth that made them."""

from itertools import pairwise, product

import numpy as np

from diagnosis.detectors.silence import _chain, silent

NOISE = 1.0


def _readings(rates, seed=0):
    return rates + np.random.default_rng(seed).normal(0, NOISE, rates.size)


def test_stretches_without_a_rate_are_found_and_no_others():
    rates = np.where((np.arange(6000) // 1000) % 2 == 0, 0.0, 2.0)
    shown = silent(_readings(rates), [slice(0, 6000)], NOISE, 10)
    assert shown[rates == 0].mean() > 0.98
    assert shown[rates != 0].mean() < 0.02


def test_a_motion_that_passes_through_zero_is_not_silent():
    rates = 30 * np.sin(np.arange(20000) / 300)
    assert silent(_readings(rates), [slice(0, 20000)], NOISE, 10).mean() < 0.02


def test_intervals_are_apart_and_nothing_is_silent_outside():
    rates = np.zeros(900)
    shown = silent(_readings(rates), [slice(100, 400), slice(500, 900)], NOISE, 7)
    assert not shown[:100].any()
    assert not shown[400:500].any()
    assert shown[100:400].min() > 0.5


def test_chain_is_the_sum_over_all_paths():
    """Five windows: against all 32 sequences of states."""

    log_likelihood = np.random.default_rng(3).normal(0, 2, (5, 2))
    stay, total, first = 8.0, 0.0, np.zeros(5)
    for path in product((0, 1), repeat=5):
        weight = 0.5 * np.exp(sum(log_likelihood[k, state] for k, state in enumerate(path)))
        for a, b in pairwise(path):
            weight *= 1 - 1 / stay if a == b else 1 / stay
        total += weight
        first += weight * (np.array(path) == 0)
    assert np.allclose(_chain(log_likelihood, stay), first / total, atol=1e-12)
