"""Rates without noise, of the samples alone."""

import numpy as np
import pytest

from diagnosis.detectors.noise_removal import remove_interval_noise, shrink_cosines
from gyrocal.smoothing import smooth_run

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
