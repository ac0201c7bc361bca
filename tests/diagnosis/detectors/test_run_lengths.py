"""P-values of runs of repeats hold for missed telemetry, and fall for others that leave the same symptom."""

import numpy as np
import pytest

from diagnosis.detectors.run_lengths import compute_p_of_runs
from simulator.effects.gyro.stale_samples import stale_mask

SEEDS = 60
SHARE = 0.1
MOST = SHARE + 3 * np.sqrt(SHARE * (1 - SHARE) / SEEDS)  # of p-values below that share


def _runs(mask):
    edges = np.diff(np.concatenate([[0], mask.astype(int), [0]]))
    starts = np.flatnonzero(edges == 1)
    return starts, np.flatnonzero(edges == -1) - starts


@pytest.mark.parametrize("mean_run", [1.0, 3.5])
def test_repeats_of_missed_samples_look_like_that(mean_run):
    p = [compute_p_of_runs(*_runs(stale_mask(np.random.default_rng(seed), 20_000, mean_run, 0.02))) for seed in range(SEEDS)]
    assert np.mean(np.array(p) < SHARE) < MOST


def test_repeats_that_are_regular_do_not():
    rng = np.random.default_rng(3)
    packets = 16 * np.sort(rng.choice(1000, 60, replace=False))
    assert compute_p_of_runs(packets, np.ones(60, dtype=int)) < 1e-6  # at the head of packets
    random = np.sort(rng.choice(16_000, 60, replace=False))
    assert compute_p_of_runs(random, np.full(60, 7)) < 1e-3  # all as long


def test_few_runs_say_nothing():
    assert compute_p_of_runs(np.arange(5), np.ones(5, dtype=int)) == 1.0
