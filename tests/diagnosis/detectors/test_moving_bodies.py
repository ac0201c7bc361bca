"""Tests of the samples of a body that never rests: what it does is no fault of its gyros, and a fault still shows."""

import numpy as np
import pytest

from diagnosis.detectors.noise_removal import remove_interval_noise, shrink_cosines
from diagnosis.detectors.outliers import find_single_samples
from diagnosis.detectors.repeats import find_repeats
from diagnosis.detectors.spectral_lines import find_jolts
from gyrocal.smoothing import smooth_run

SAMPLES = 20_000


def swaying(seed, size=300.0):
    """Rates (n, 3) in sigmas of their noise, which turn about all axes at once and back."""
    rng = np.random.default_rng(seed)
    t = np.arange(SAMPLES)
    common = np.sin(2 * np.pi * t / 190) + 0.6 * np.sin(2 * np.pi * t / 331)
    return size * common[:, None] * np.array([1.0, -0.7, 0.5]) + rng.standard_normal((SAMPLES, 3))


@pytest.mark.parametrize("step", [2.0, 20.0])
def test_a_body_that_turns_back_repeats_no_reading_by_a_fault(step):
    for seed in range(2):
        x = np.round(swaying(seed) / step) * step
        assert _stale(x) is None or _stale(x).p_value > 1e-6


def _stale(x):
    return find_repeats(x, np.ones(len(x), dtype=bool))


def bending():
    """A rate that sets out along another line now and then, within a few samples or at once, in sigmas of its noise."""
    rng = np.random.default_rng(7)
    slope = np.repeat(rng.normal(0.0, 60.0, SAMPLES // 100), 100)
    slope[SAMPLES // 2 :] = np.convolve(slope, np.ones(4) / 4, mode="same")[SAMPLES // 2 :]
    return np.cumsum(slope) + rng.standard_normal(SAMPLES)


def test_neither_bends_nor_fast_motion_are_spikes_or_jolts():
    assert not find_single_samples(bending(), np.ones(SAMPLES, dtype=bool), 1.0, 0.0).mask.any()
    used = np.ones(SAMPLES, dtype=bool)
    x = np.random.default_rng(1).standard_normal((SAMPLES, 3))
    x[SAMPLES // 2 :, 1] += 100.0
    assert set(np.flatnonzero(find_jolts(x, used))) <= set(range(SAMPLES // 2 - 4, SAMPLES // 2 + 4))
    assert find_jolts(x, used).any()
    always = np.cumsum(np.random.default_rng(2).standard_t(1.0, (SAMPLES, 3)), axis=0)
    assert not find_jolts(always, used).any()
    assert not find_jolts(x, ~used).any()


N, SAMPLE_S, SIGMA = 6000, 0.02, 0.01


def noisy(motion, seed=0):
    return motion + SIGMA * np.random.default_rng(seed).standard_normal(motion.shape)


@pytest.mark.parametrize("amplitude", [1.5, 3.0, 100.0])
def test_a_sway_is_kept_at_any_size(amplitude):
    """Local quadratics alone keep nothing of one that is below four times the noise, or most of the noise of a larger one."""
    motion = np.tile(amplitude * SIGMA * np.sin(2 * np.pi * 1.3 * SAMPLE_S * np.arange(N))[:, None], 3)
    level = np.full(3, SIGMA)
    error = (remove_interval_noise(noisy(motion), SAMPLE_S, level) - motion).std()
    assert error < 0.6 * SIGMA
    assert error < 0.6 * (smooth_run(noisy(motion), SAMPLE_S, np.inf, level) - motion).std()


def test_degrees_of_freedom_are_the_share_of_the_noise_that_is_kept():
    """Σ covariance of estimate and noise over σ², by 60 draws."""
    motion = 0.5 * np.sin(2 * np.pi * 1.3 * SAMPLE_S * np.arange(2000))
    rng = np.random.default_rng(4)
    kept, stated = [], []
    for _ in range(60):
        noise = SIGMA * rng.standard_normal(motion.size)
        values, freedom = shrink_cosines(motion + noise, SIGMA)
        kept.append(noise @ (values - motion) / SIGMA**2)
        stated.append(freedom)
    # A coefficient that its noise lifts over the limit jumps, which the derivative leaves out.
    assert abs(np.mean(kept) - np.mean(stated)) < 4 * np.std(kept) / np.sqrt(60) + 0.1 * np.mean(stated)
