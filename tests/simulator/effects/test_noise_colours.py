"""Noise of a colour, as the simulator makes it."""

import numpy as np

from gyrocal.allan import compute_allan_variance, overlapping_allan_deviation
from gyrocal.allan.terms import ANGLE_WHITE, MARKOV
from simulator import scenario
from simulator.effects import parse
from simulator.simulate import simulate

PLAN = scenario.load("trmm_series")
ARCSEC = np.deg2rad(1 / 3600)
DEG_H = np.deg2rad(1 / 3600)


def added(*effects, seed=1):
    """What effects add to each interval's samples of axis z, and how long a sample is."""
    with_, without = (simulate(PLAN, seed=seed, effects=[parse(text) for text in texts]) for texts in (effects, ()))
    difference = (with_.gyro.rates - without.gyro.rates)[:, 2]
    edges = np.searchsorted(with_.gyro.t_s, [[one.start_s, one.stop_s] for one in with_.intervals])
    return [difference[low:high] for low, high in edges], with_.gyro.sample_s


def test_angle_white_noise_is_that_of_readings_and_does_not_add_up():
    parts, sample_s = added("noise_angle_white:z=2")
    found = overlapping_allan_deviation(parts, sample_s, [1, 8, 64])
    expected = (2 * ARCSEC) ** 2 * compute_allan_variance(ANGLE_WHITE, found.tau_s)
    assert np.all(np.abs(found.variance / expected - 1) < 4 * np.sqrt(2 * 35 / 18 / found.counts))
    for part in parts:  # only the first and the last reading remain
        assert abs(np.sum(part) * sample_s) < 6 * np.sqrt(2) * 2 * ARCSEC


def test_markov_noise_has_its_size_and_time_constant():
    variances = []
    for seed in range(8):
        parts, sample_s = added("bias_markov:z=3,time_constant_s=20", seed=seed)
        variances.append(overlapping_allan_deviation(parts, sample_s, [1, 16, 64, 256]).variance)
    tau = sample_s * np.array([1, 16, 64, 256])
    expected = (3 * DEG_H) ** 2 * compute_allan_variance(MARKOV, tau, 20.0)
    mean, error = np.mean(variances, axis=0), np.std(variances, axis=0, ddof=1) / np.sqrt(8)
    # At one sample the process' value stands for its mean over it, whose difference is smaller: 2 ln-scale terms of Δt/τ.
    assert abs(mean[0] / (0.5 * (3 * DEG_H) ** 2 * 2 * (1 - np.exp(-sample_s / 20))) - 1) < 0.05
    assert np.all(np.abs(mean - expected)[1:] < 6 * error[1:] + 0.01 * expected[1:])
