"""P-values of the times of repeats hold for missed telemetry, and fall for others that leave the same symptom."""

import numpy as np
import pytest

from diagnosis.detectors.repeats import compute_p_of_times
from simulator.effects.gyro.stale_samples import draw_stale_mask

SEEDS = 60
SHARE = 0.1
MOST = SHARE + 3 * np.sqrt(SHARE * (1 - SHARE) / SEEDS)  # of p-values below that share


def _starts(mask):
    return np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int)])) == 1)


@pytest.mark.parametrize("mean_run", [1.0, 3.5])
def test_repeats_of_missed_samples_look_like_that(mean_run):
    p = [
        compute_p_of_times(_starts(draw_stale_mask(np.random.default_rng(seed), 20_000, mean_run, 0.02)))
        for seed in range(SEEDS)
    ]
    assert np.mean(np.array(p) < SHARE) < MOST


def test_repeats_that_are_regular_do_not():
    packets = 16 * np.sort(np.random.default_rng(3).choice(1000, 60, replace=False))
    assert compute_p_of_times(packets) < 1e-6  # at the head of packets


def test_few_runs_say_nothing():
    assert compute_p_of_times(np.arange(5)) == 1.0
