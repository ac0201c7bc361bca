"""Replication: random-effects means of sizes by part against closed forms and draws."""

import numpy as np
import pytest

from diagnosis.replication import combine_parts

NAMES = [f"part {k}" for k in range(8)]


def combined(sizes, sigmas):
    return combine_parts(NAMES[: len(sizes)], np.array(sizes, dtype=float), np.diag(np.square(sigmas)))


def test_sizes_that_agree_have_the_weighted_mean():
    found = combined([1.0, 1.1, 0.9], [0.1, 0.2, 0.2])
    weights = np.array([100.0, 25.0, 25.0])
    assert found.mean == pytest.approx(weights @ [1.0, 1.1, 0.9] / weights.sum())
    assert found.sigma == pytest.approx(weights.sum() ** -0.5)
    assert found.heterogeneity_p > 0.5
    assert found.replicates


def test_sizes_that_scatter_have_a_wider_sigma_and_may_not_replicate():
    found = combined([3.0, -3.0, 3.2, -2.8], [0.1] * 4)
    assert found.heterogeneity_p < 1e-10
    assert found.sigma > 1.0
    assert not found.replicates


def test_a_part_that_shows_nothing_is_left_out():
    found = combined([1.0, 1.1, 50.0], [0.1, 0.1, 100.0])
    assert [one.part for one in found.parts] == NAMES[:2]


def test_one_part_alone_does_not_replicate():
    assert not combined([1.0, 0.0], [0.01, 10.0]).replicates


def test_the_p_value_of_heterogeneity_is_uniform_and_the_sigma_holds():
    rng = np.random.default_rng(1)
    sigmas = np.array([0.5, 1.0, 1.0, 2.0, 1.5, 0.7])
    found = [combined(2.0 + sigmas * rng.standard_normal(6), sigmas) for _ in range(600)]
    p = np.array([one.heterogeneity_p for one in found])
    assert abs((p < 0.1).mean() - 0.1) < 3 * np.sqrt(0.1 * 0.9 / 600)
    errors = np.array([(one.mean - 2.0) / one.sigma for one in found])
    assert 0.85 < errors.std() < 1.1  # the scatter that is estimated cannot be negative, so that the sigma is rather wide


def test_sizes_of_one_sign_that_differ_beyond_their_errors_do_not_replicate():
    found = combined([3.0, 3.5, 4.0, 2.5], [0.1] * 4)
    assert abs(found.mean) > 3 * found.sigma
    assert found.heterogeneity_p < 1e-4
    assert not found.replicates
    assert combined([3.0, 3.5, 4.0, 2.5], [0.6] * 4).replicates
