"""Smoothed rates against a motion that is known, and rests against simulated ones."""

import numpy as np
import pytest

from gyrocal.rests import compare_rests
from gyrocal.smoothing import smooth_axis

COUNT = 4000
DRAWS = 20


def drawn(motion, number):
    return motion + np.random.default_rng(number).normal(size=motion.size)


def swaying(period, amplitude):
    return amplitude * np.sin(2 * np.pi * np.arange(COUNT) / period)


MOTIONS = {"rest": np.zeros(COUNT), "slow sway": swaying(250.0, 8.0), "sway": swaying(130.0, 4.0)}


@pytest.mark.parametrize(("motion", "most", "bend"), [("slow sway", 0.05, 1e-3), ("sway", 0.09, 1e-3), ("rest", 1.5e-3, 3e-4)])
def test_little_of_the_noise_is_left_and_no_steps_where_the_window_changes(motion, most, bend):
    truth = MOTIONS[motion]
    errors = [smooth_axis(drawn(truth, number), 1.0, np.inf, 1.0)[0] - truth for number in range(DRAWS)]
    assert np.mean([np.mean(error**2) for error in errors]) < most
    # With the longest window of each sample, and no fading, it is 0.02 to 0.05 of a sample's variance for the two that sway.
    assert np.mean([np.mean(np.diff(error, n=2) ** 2) for error in errors]) < bend


@pytest.mark.parametrize("motion", MOTIONS)
def test_degrees_of_freedom_tell_the_risk(motion):
    truth, told, real = MOTIONS[motion], [], []
    for number in range(DRAWS):
        rates = drawn(truth, number)
        estimate, freedom = smooth_axis(rates, 1.0, np.inf, 1.0)
        told.append(np.mean((rates - estimate) ** 2) - 1 + 2 * freedom / COUNT)
        real.append(np.mean((estimate - truth) ** 2))
    # Stein's estimate scatters with the mean square of the noise, √(2/n), and holds the choice of windows to be none.
    scatter = np.sqrt(2 / COUNT / DRAWS)
    assert abs(np.mean(told) - np.mean(real)) < 4 * scatter + 0.2 * np.mean(real)


def test_a_slew_keeps_its_ramps():
    at = np.arange(COUNT)
    truth = 1000 * np.clip(np.minimum((at - 2000) / 30, (2260 - at) / 30), 0, 1)
    estimate, _ = smooth_axis(drawn(truth, 0), 1.0, np.inf, 1.0)
    assert np.abs(estimate - truth).max() < 5.0


RESTS = [(0, 1000), (3000, 4200), (5000, 6000)]


@pytest.mark.parametrize("sigma", [1e-4, 1e-3])
def test_rests_of_one_bias_do_not_differ_and_a_step_of_the_bias_is_said(sigma):
    rng, t = np.random.default_rng(4), 0.01 * np.arange(6000)
    said = [compare_rests(t, sigma * rng.normal(size=(6000, 3)) + 0.01, RESTS)[0] for _ in range(200)]
    assert said == [""] * 200
    rates = sigma * rng.normal(size=(6000, 3)) - [0.01, 0.02, 0.03]
    rates[4500:, 1] += sigma
    text, change = compare_rests(t, rates, RESTS)
    assert "b_y is" in text
    assert "at 50 s" in text
    np.testing.assert_allclose(np.abs(change), [0, sigma, 0], atol=5 * sigma * np.sqrt(2 / 1000))
