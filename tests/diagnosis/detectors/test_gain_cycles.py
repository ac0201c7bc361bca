"""Gains that go with the number of a sample, told from motions, from lines that are added, and from chance."""

import numpy as np
import pytest
import scipy.stats

from diagnosis.detectors.gain_cycles import CYCLES, _both, _smooth, _waves, gain_cycle

COUNT, SIGMA = 20_000, 1e-3
T = np.arange(COUNT)
RATE = np.sin(2 * np.pi * T / 3000 + 1) + 0.4 * np.sin(2 * np.pi * T / 777)
RUNS, STARTS = [(0, 9000), (9050, COUNT)], np.array([[0, 0], [9050, 0]])
SIGNIFICANT = 1e-5


def found(reading, seed=0, starts=STARTS):
    noise = SIGMA * np.random.default_rng(seed).standard_normal(COUNT)
    return gain_cycle(reading + noise, RUNS, starts)


def test_no_gain_is_found_in_noise():
    p = np.array([found(RATE, seed).p_value for seed in range(150)])
    for level in (0.05, 0.2):
        # Only gains that x shows far better than an added line count, so that p-values are too large rather than too small.
        assert np.sum(p < level) <= scipy.stats.binom.isf(1e-3, p.size, level)
    assert np.sum(p < 1.0) > 5


@pytest.mark.parametrize("cycle", [2, 3, 13, 40])
@pytest.mark.parametrize("way", [0, 1])
def test_a_gain_is_found_with_its_cycle_and_size(cycle, way):
    place = np.where(T >= 9050, T - 9050 * way, T)
    size = 4e-4
    wave = size * np.cos(2 * np.pi * place / cycle + (0.3 if cycle > 2 else 0.0))
    one = found(RATE * (1 + wave))
    assert one.p_value < SIGNIFICANT
    assert one.cycle == pytest.approx(cycle)
    assert abs(one.size - (size if cycle == 2 else size / np.sqrt(2))) < 4 * one.sigma


def test_runs_that_count_from_elsewhere_add_up_only_in_their_own_way():
    place = np.where(T >= 9050, T - 9050, T)
    wave = 3e-4 * np.cos(2 * np.pi * place / 40)
    from_interval, from_recording = (found(RATE * (1 + wave), starts=STARTS[:, [k]]).p_value for k in (1, 0))
    assert from_interval < 1e-3 * from_recording


@pytest.mark.parametrize("cycle", [2, 8, 40])
def test_a_line_that_does_not_grow_with_the_rate_is_no_gain(cycle):
    assert found(RATE + 4e-4 * np.cos(2 * np.pi * T / cycle)).p_value > SIGNIFICANT


@pytest.mark.parametrize("cycle", [40.5, 57.3])
def test_what_has_no_whole_cycle_is_none(cycle):
    """A body that shakes the more the faster it turns does not know which sample it is."""
    assert found(RATE * (1 + 4e-4 * np.cos(2 * np.pi * T / cycle))).p_value > SIGNIFICANT


def test_a_sway_beside_the_turns_is_no_gain():
    sway = 0.5 * np.sin(2 * np.pi * T / 50)
    assert found(RATE + sway).p_value > SIGNIFICANT
    assert found((RATE + sway) * (1 + 4e-4 * np.cos(2 * np.pi * T / 8))).p_value < SIGNIFICANT


def test_a_run_is_asked_beyond_the_motion_of_both_its_spectra():
    """A motion of which smoothing leaves little has a narrower band in the product than in the reading itself."""
    periods, sizes = (868.5, 815.1, 161.6, 116.5), (0.006, 0.0194, 0.3258, 0.0117)
    x = sum(size * np.sin(2 * np.pi * T[:4096] / period) for size, period in zip(sizes, periods, strict=True))
    x = x + SIGMA * np.random.default_rng(175).standard_normal(4096)
    product, reading = _waves(x * _smooth(x), STARTS[0]).asked, _waves(x, STARTS[0]).asked
    assert (product & ~reading).any()
    for one in _both(x, STARTS[0]):
        np.testing.assert_array_equal(one.asked, product & reading)


def test_nothing_is_said_of_short_runs_and_of_readings_without_noise():
    assert gain_cycle(RATE, [(0, 1000)], np.array([[0]])) is None
    assert gain_cycle(np.zeros(COUNT), [(0, COUNT)], np.array([[0]])) is None


def test_cycles_are_each_asked_once():
    assert CYCLES.min() == pytest.approx(1 / 64)
    assert CYCLES.max() == 0.5
    assert np.unique(np.round(CYCLES, 9)).size == CYCLES.size
