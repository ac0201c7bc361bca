"""Replication: random-effects means of sizes by part against closed forms and draws."""

import numpy as np
import pytest

from diagnosis.replication import combine_parts

NAMES = [f"part {k}" for k in range(8)]


def combined(sizes, sigmas):
    t_s = 10.0 * np.arange(len(sizes))
    return combine_parts(NAMES[: len(sizes)], np.array(sizes, dtype=float), np.diag(np.square(sigmas)), t_s)


def test_parts_that_show_nothing_are_left_out_and_growing_sizes_have_a_ramp():
    found = combined([1.0, 1.1, 50.0], [0.1, 0.1, 100.0])
    assert [one.part for one in found.parts] == NAMES[:2]
    # By hand: they lie on a line from 7 to 12, of which their variance is 3.5 beside what their sigmas make.
    found = combined([7.0, 8.0, 9.0, 10.0, 11.0, 12.0], [0.2] * 6)
    assert found.heterogeneity_p < 1e-10
    assert found.mean == pytest.approx(9.5)
    assert found.spread == pytest.approx(np.std(np.arange(6), ddof=1), rel=0.02)
    assert found.ramp == pytest.approx((7.0, 12.0))


def test_p_values_are_as_rare_as_they_say_and_the_sigma_holds():
    rng = np.random.default_rng(1)
    sigmas = np.array([0.5, 1.0, 1.0, 2.0, 1.5, 0.7])
    found = [combined(2.0 + sigmas * rng.standard_normal(6), sigmas) for _ in range(600)]
    p = np.array([one.heterogeneity_p for one in found])
    assert abs((p < 0.1).mean() - 0.1) < 3 * np.sqrt(0.1 * 0.9 / 600)
    errors = np.array([(one.mean - 2.0) / one.sigma for one in found])
    assert 0.85 < errors.std() < 1.1  # the scatter that is estimated cannot be negative, so that the sigma is rather wide
    rng = np.random.default_rng(2)
    found = [combined(2.0 + rng.standard_normal(6), [1.0] * 6).ramp for _ in range(2000)]
    assert sum(one is not None for one in found) < 2000 * 0.01 + 3 * np.sqrt(2000 * 0.01)
