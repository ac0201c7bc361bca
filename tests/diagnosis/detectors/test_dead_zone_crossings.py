"""Passes through a dead zone: its half width where there is one, nothing where a body moves, rests or swings."""

import numpy as np
import pytest

from diagnosis.detectors.dead_zone_crossings import find_best_zone

NOISE = 1e-3  # rad/s, of a sample
SAMPLES = 40_000
PARTS = (slice(0, SAMPLES // 2), slice(SAMPLES // 2, SAMPLES))


def _motion(seed, kind):
    """A rate that passes zero: swings of some periods, turns from a rest at some rate, or steps of a slow drift."""
    rng = np.random.default_rng(seed)
    t = np.arange(SAMPLES) / 10.0
    if kind == "swing":
        waves = (np.sin(2 * np.pi * t / rng.uniform(150, 400) + rng.uniform(0, 6)) for _ in range(2))
        return sum(rng.uniform(0.02, 0.05) * wave for wave in waves)
    rest = rng.uniform(-0.04, 0.04)
    turns = np.interp(t % 400, [0, 150, 200, 250, 400], [0, 0, 1, 0, 0]) * rng.choice([-0.2, 0.2], 11)[(t // 400).astype(int)]
    return rest + turns


def _read(rate, half_width, seed):
    shown = np.where(np.abs(rate) < half_width, 0.0, rate)
    return shown + NOISE * np.random.default_rng([seed, 1]).standard_normal(rate.size)


@pytest.mark.parametrize("half_width", [0.008, 0.015])
def test_the_half_width_is_found(half_width):
    for seed in range(2):
        rate = _motion(seed, "swing")
        found = find_best_zone(_read(rate, half_width, seed), PARTS, NOISE)
        assert found is not None
        assert np.mean(found.dead == (np.abs(rate) < half_width)) > 0.98
        assert found.log_odds > 8
        assert abs(found.half_width - half_width) < 3.5 * found.sigma
        assert found.sigma < 0.2 * half_width  # windows are as long as leaves a blur of a sixth


def test_one_way_through_the_zone_shows_it():
    """A body that is slowed down and turns back: the reading jumps to zero and, much later, to the other edge."""
    t = np.linspace(-1.0, 1.0, SAMPLES // 4)
    for seed in range(3):
        rate = 0.5 * t + 0.03 * np.sin(8 * t + seed)
        parts = (slice(0, rate.size),)
        found = find_best_zone(_read(rate, 0.05, seed), parts, NOISE)
        assert found.log_odds > 2
        assert abs(found.half_width - 0.05) < 3.5 * found.sigma
        assert find_best_zone(_read(rate, 0.0, seed), parts, NOISE) is None


def test_a_slew_from_rest_to_rest_shows_no_zone():
    """With ramps of all lengths, from a rest at zero or beside it."""
    t, odds = np.arange(SAMPLES // 4), []
    for seed in range(15):
        rng = np.random.default_rng(seed)
        ramp = rng.integers(5, 1500)
        rate = np.interp(t, [3000, 3000 + ramp, 6000, 6000 + ramp], [0.0, 1.0, 1.0, 0.0]) * rng.uniform(0.05, 0.4)
        found = find_best_zone(_read(rate + rng.choice([0.0, 0.003]), 0.0, seed), (slice(0, t.size),), NOISE)
        odds.append(found.log_odds if found else 0.0)
    assert max(odds) < 2


def test_a_real_motion_shows_no_zone():
    motions = [_motion(seed, kind) for seed in range(10) for kind in ("swing", "turns")]
    found = [find_best_zone(_read(rate, 0.0, seed), PARTS, NOISE) for seed, rate in enumerate(motions)]
    odds = [one.log_odds if one else 0.0 for one in found]
    assert max(odds) < 4
    assert np.mean(np.array(odds) > 1) < 0.1


def test_a_body_that_thrusters_push_from_rate_to_rate_shows_no_zone():
    """A limit cycle: the rate goes from one steady value to another within a sample."""
    found = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        levels = np.repeat(rng.uniform(-3, 3, SAMPLES // 50 + 1), 50)[:SAMPLES] * 30 * NOISE
        one = find_best_zone(levels + NOISE * rng.standard_normal(SAMPLES), PARTS, NOISE)
        found.append(one.log_odds if one else 0.0)
    assert max(found) < 2


def test_nothing_to_see_is_no_zone():
    assert find_best_zone(np.zeros(SAMPLES), PARTS, NOISE) is None
    assert find_best_zone(_motion(1, "swing"), PARTS, 0.0) is None
