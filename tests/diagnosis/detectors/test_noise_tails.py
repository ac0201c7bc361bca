"""Tails of the noise: exact shares of normal noise of any spectrum, small spikes that are found, jerks that are none."""

import numpy as np
import pytest
import scipy.stats

from diagnosis.detectors.noise_blocks import SHOWING, blocks_of, powers_of
from diagnosis.detectors.noise_tails import _heights, _limits, tails

COUNT = 60_000


def white_of(x):
    blocks = blocks_of([x])[:, :SHOWING]
    return blocks / np.sqrt(powers_of(blocks))


def noise(seed):
    return np.random.default_rng(seed).standard_normal(COUNT)


def spikes(seed, number, height):
    rng, x = np.random.default_rng(seed), np.zeros(COUNT)
    x[rng.choice(COUNT, number, replace=False)] = height
    return x


@pytest.mark.parametrize("law", [lambda x: x, lambda x: np.diff(x, append=0.0), lambda x: np.convolve(x, [1, 0.5], "same")])
def test_normal_noise_of_any_spectrum_has_no_tails(law):
    p = np.array([tails(white_of(law(noise(seed)))).p_value for seed in range(60)])
    for at in (0.5, 0.1, 0.01):
        assert scipy.stats.binom.sf(np.sum(p < at) - 1, p.size, at) > 1e-3


def test_limits_are_exceeded_as_often_as_stated():
    """By draws of their own, and beyond them by no more than the share that is stated."""
    limits, shares = _limits()
    high = _heights(np.random.default_rng(3).standard_normal((300_000, SHOWING)))
    above = np.sum(high > limits[:, None], axis=1)
    for count, share in zip(above, shares, strict=True):
        error = np.sqrt(share * high.size * (1 + high.size / 200_000)) + 1
        assert count < share * high.size + 4 * error
        if share >= 3e-5:
            assert count > share * high.size - 4 * error
    assert np.all(np.diff(limits) > 0)


def test_small_spikes_are_found():
    """Five sigmas is less than one outlier must have; sixty of them are a thousandth of the samples."""
    assert all(tails(white_of(noise(seed) + spikes(seed, 60, 5.0))).p_value < 1e-8 for seed in range(5))
    one = tails(white_of(noise(1) + spikes(1, 60, 5.0)))
    assert "off by 4" in one.text
    assert tails(white_of(noise(2) + spikes(2, 6, 9.0))).p_value < 1e-8


@pytest.mark.parametrize("height", [2.0, 5.0, 20.0])
@pytest.mark.parametrize("order", [1, 2])
def test_steps_and_bends_of_a_motion_are_none(order, height):
    """Two hundred of them, at any place; of white noise alone the usual number stands out."""
    jerks = spikes(4, 200, height) * np.random.default_rng(5).choice([-1.0, 1.0], COUNT)
    for _ in range(order):
        jerks = np.cumsum(jerks)
    assert tails(white_of(noise(6) + jerks)).p_value > 1e-3


def test_no_blocks_say_nothing():
    assert tails(np.empty((0, SHOWING))).p_value == 1.0
