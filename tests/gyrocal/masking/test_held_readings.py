"""Held readings against rates of which it is known which were measured."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrocal.masking.held_readings import find_held_readings

BIAS = np.array([0.25, -0.15, 0.1])


def draw_readings(step, sigma, bias=BIAS, seed=0):
    """Rests and turns in deg/s at 100 Hz, rounded to a step."""
    rng, t = np.random.default_rng(seed), 0.01 * np.arange(6000)
    turning = np.where(t % 20 < 8, 0.0, np.sin(np.pi / 3 * (t % 20 - 8)))
    rates = turning[:, None] * np.stack([np.full(t.size, 20.0), 14 * np.cos(t), np.full(t.size, -10.0)], axis=1)
    return t, np.round((rates + bias + sigma * rng.normal(size=rates.shape)) / step) * step


@settings(max_examples=30, deadline=None)
@given(
    step=st.sampled_from([1e-4, 1e-3, 0.01]),
    sigma=st.floats(0.03, 0.1),
    width=st.floats(6.0, 12.0),
    together=st.booleans(),
    held=st.sampled_from([0.0, 0.1]),
    seed=st.integers(0, 99),
)
def test_a_threshold_is_found_on_all_axes_and_on_each(step, sigma, width, together, held, seed):
    """Half-widths from six sigmas of the noise; the value in place of the readings is zero, or another in the zone."""
    t, rates = draw_readings(step, sigma, seed=seed)
    small = np.abs(rates) < width * sigma + np.abs(BIAS).max()
    small = np.broadcast_to(small.all(axis=1)[:, None], small.shape) if together else small
    found, said = find_held_readings(t, np.where(small, held, rates))
    wrong = found != small.any(axis=1)
    assert wrong.sum() <= 0.01 * len(t)  # a crossing of the zone by one axis alone may be too short to be told from chance
    assert all(f"read exactly {held:g}" in text for text in said)
    assert len(said) >= 1


@settings(max_examples=60, deadline=None)
@given(step=st.floats(1e-12, 1.0), sigma=st.floats(0.0, 0.3), bias=st.floats(-0.5, 0.5), seed=st.integers(0, 99))
def test_a_gyro_with_steps_larger_than_its_noise_keeps_its_rests(step, sigma, bias, seed):
    t, rates = draw_readings(step, sigma, bias, seed)
    found, said = find_held_readings(t, rates)
    assert not found.any()
    assert said == []


@pytest.mark.parametrize("level", [10.0, 40.0])
def test_a_table_of_constant_rates_and_a_clipped_gyro_hold_nothing(level):
    """A quiet gyro on a rate table repeats all its levels; a clipped one its largest reading."""
    t = 0.01 * np.arange(6000)
    table = np.repeat(np.tile([0.0, level, 0.0, -level], 15), 100)[:, None] * [1.0, 0.5, -0.2]
    assert not find_held_readings(t, table)[0].any()
    _, rates = draw_readings(1e-4, 0.05)
    assert not find_held_readings(t, np.clip(rates, -0.2 * level, 0.2 * level))[0].any()
