"""The gap budget: effects identified in the presence of a remainder, and the shares that they close on held-out data."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.budget import HeldOut, is_surely_closing, predict_held_out
from diagnosis.explain import explain
from diagnosis.replication import combine_parts
from diagnosis.settings import DEFAULT
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import prepared

REMAINDER = ("bias_markov:y=0.4,time_constant_s=1000", "reference_correlated:x=0.01,time_constant_s=400")


SHOWN = ("bias_orbital:z=0.6,phase_deg=25", *REMAINDER)
COARSE = {"sample_s": 4.0, "every_s": 300.0}


@pytest.fixture(scope="module")
def orbital():
    own = [one for one in EFFECTS.values() if not one.is_process]
    return explain(prepared(5, *SHOWN, **COARSE), own, DEFAULT, 0, lambda text, share: None)


def test_a_set_of_effects_is_predicted_as_if_there_were_no_others(orbital):
    model, effects = prepared(5, *SHOWN, **COARSE).model, [*orbital.fitted, orbital.unnamed[0]]
    squares = predict_held_out(model, effects, sets=[(), [1], [0], [0, 1]]).squares
    np.testing.assert_allclose(squares[:, [0, 2, 3]], predict_held_out(model, effects).squares)
    np.testing.assert_allclose(squares[:, :2], predict_held_out(model, effects[1:]).squares)
    noise = np.random.default_rng(3).standard_normal(effects[0].columns.shape)
    other = replace(effects[0], columns=noise * np.linalg.norm(effects[0].columns) / np.linalg.norm(noise))
    both = [effects[0], other]
    assert [is_surely_closing(model, both, orbital.unnamed, k) for k in (0, 1)] == [True, False]


def test_an_effect_beside_a_remainder_has_its_size_and_its_share(orbital):
    assert [one.effect for one in orbital.fitted] == ["bias_orbital"]
    assert abs(orbital.fitted[0].size - 0.6) < 3 * orbital.fitted[0].sigma
    assert orbital.attribution.slots[0].group_probability >= DEFAULT.named
    assert orbital.attribution.verdict == "partial"
    assert orbital.remainder.noise_factor == pytest.approx(1.0, abs=0.15)
    assert orbital.remainder.gyro_deg_h[1] == pytest.approx(0.4, rel=0.5)
    names = [step.step for step in orbital.budget]
    assert names == ["baseline", "bias_orbital:z", "remainder", "floor"]
    misfit = [step.misfit for step in orbital.budget]
    assert misfit[0] > misfit[1] >= misfit[-1] == 1.0
    closed, left = orbital.budget[1].closed, orbital.budget[2].closed
    assert closed + left == pytest.approx(1.0, abs=1e-9)
    assert orbital.budget[1].interval_90[0] <= closed <= orbital.budget[1].interval_90[1]
    assert closed == pytest.approx((misfit[0] - misfit[1]) / (misfit[0] - 1.0))


def test_the_share_closed_is_that_of_the_sums_over_all_parts():
    squares = np.array([[30.0, 12.0], [26.0, 11.0], [34.0, 13.0]])
    held = HeldOut(squares, squares, np.array([10.0, 10.0, 10.0]), ("a", "b", "c"))
    closed, (low, high) = held.closed(0, 1)
    assert closed == pytest.approx((90 - 36) / (90 - 30))
    assert low < closed < high


@pytest.mark.parametrize("shared", [0.0, 3.0])
def test_the_interval_of_a_share_holds_it_as_often_as_it_says(shared):
    """Eight intervals of eight parts, whose gains have errors of their own, and those of an interval a common one or none."""
    rng, hits, draws = np.random.default_rng(11), 0, 300
    names = tuple(np.repeat(list("abcdefgh"), 8))
    for _ in range(draws):
        gained = 8.0 + rng.standard_normal(64) + np.repeat(shared * rng.standard_normal(8), 8)
        squares = np.column_stack([np.full(64, 20.0), 20.0 - gained])
        low, high = HeldOut(squares, squares, np.full(64, 10.0), names).closed(0, 1)[1]
        hits += low <= 0.8 <= high
    assert abs(hits / draws - 0.9) < 3 * np.sqrt(0.9 * 0.1 / draws)


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
