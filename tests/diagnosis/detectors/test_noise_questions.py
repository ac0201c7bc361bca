"""Waves of the noise's level: exact tails, blocks that come at few places, and a motion in waves that is no noise."""

import numpy as np
import pytest
import scipy.stats

from diagnosis.detectors.noise_blocks import BACK, OF_MOTION, SHOWING
from diagnosis.detectors.noise_questions import Blocks, _strongest, waves_of_level

COUNT, STRIDE = 1500, 37


def blocks(cosines, turned=None):
    """Calm blocks, one after the other in one interval, of a body at rest."""
    start = STRIDE * np.arange(len(cosines))
    none = np.zeros((len(cosines), 3))
    return Blocks(
        cosines,
        cosines @ BACK,
        cosines @ BACK,
        np.column_stack([start, start]),
        none,
        none[:, 0],
        none if turned is None else turned,
    )


def noise(seed):
    return np.random.default_rng(seed).standard_normal((COUNT, SHOWING))


def gate(period):
    return (np.arange(COUNT) / period % 1.0 < 0.5)[:, None]


def test_noise_of_one_level_has_no_waves():
    """Also where the angle that is turned takes a few values only, as of a table that stops at every third of a turn."""
    angle = np.random.default_rng(0).integers(0, 4, (COUNT, 3)) * 2 * np.pi / 3
    p = np.array([waves_of_level(blocks(noise(seed), angle)).p_value for seed in range(60)])
    for at in (0.5, 0.1, 0.01):
        assert scipy.stats.binom.sf(np.sum(p < at) - 1, p.size, at) > 1e-3


@pytest.mark.parametrize("places", [[0.0, 16.0], [0.0, 8.0, 16.0], np.linspace(0.0, 16.0, 40)])
def test_the_strength_of_a_wave_has_at_most_the_tail_that_is_counted_with(places):
    """Where values come at two places only, sums have one degree of freedom, and twice as much of it in one direction."""
    clock, rng = np.resize(places, 40), np.random.default_rng(1)
    found = [_strongest(rng.standard_normal(40), clock, 1.0) for _ in range(12_000)]
    p = np.array([count * np.exp(-0.5 * strength) for strength, _, _, count in found])
    for at in (0.1, 1e-2, 3e-4):
        assert scipy.stats.binom.sf(np.sum(p < at) - 1, p.size, at) > 1e-3


@pytest.mark.parametrize("period", [9.3, 61.0, 400.0])
def test_a_level_in_waves_has_their_period(period):
    found = waves_of_level(blocks(noise(2) * np.where(gate(period), 1.15, 1.0)))
    assert found.p_value < 1e-12
    assert found.size == pytest.approx(0.15, abs=0.04)
    assert float(found.text.split()[-1]) == pytest.approx(STRIDE * period, rel=0.5 * period / COUNT)


def test_a_level_in_waves_of_an_angle_is_told_where_the_body_turns_unevenly():
    angle = 12 * np.sin(np.arange(COUNT) / 210.0) + np.arange(COUNT) / 300
    found = waves_of_level(
        blocks(noise(3) * np.where(np.sin(3.7 * angle) > 0.3, 1.15, 1.0)[:, None], np.tile(angle[:, None], 3))
    )
    assert found.p_value < 1e-12
    assert "angle turned" in found.text
    assert float(found.text.split()[-1]) == pytest.approx(2 * np.pi / 3.7, rel=0.02)


def test_a_motion_in_waves_is_no_noise():
    """A body that shakes now and then leaves power where motions have it."""
    shaking = np.sqrt(0.5 * OF_MOTION / OF_MOTION.mean()) * gate(61.0)
    found = waves_of_level(blocks(noise(4) + shaking * noise(5)))
    assert found.p_value > 1e-3
    even = waves_of_level(blocks(noise(4) + np.sqrt(0.5) * gate(61.0) * noise(5)))
    assert even.p_value < 1e-12
