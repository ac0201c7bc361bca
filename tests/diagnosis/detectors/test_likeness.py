"""Likeness: p-values hold for the fault that is named, and fall for others that leave the same symptom."""

import numpy as np
import pytest
import scipy.stats

from diagnosis.detectors import likeness
from simulator.effects.gyro.stale_samples import stale_mask

SEEDS = 60
SHARE = 0.1
MOST = SHARE + 3 * np.sqrt(SHARE * (1 - SHARE) / SEEDS)  # of p-values below that share


def _runs(mask):
    edges = np.diff(np.concatenate([[0], mask.astype(int), [0]]))
    starts = np.flatnonzero(edges == 1)
    return starts, np.flatnonzero(edges == -1) - starts


def _noise(seed):
    rng = np.random.default_rng(seed)
    return [rng.standard_normal(size) for size in (900, 2500, 400)]


@pytest.mark.parametrize("mean_run", [1.0, 3.5])
def test_repeats_of_missed_samples_look_like_that(mean_run):
    p = [likeness.of_runs(*_runs(stale_mask(np.random.default_rng(seed), 20_000, mean_run, 0.02))) for seed in range(SEEDS)]
    assert np.mean(np.array(p) < SHARE) < MOST


def test_repeats_that_are_regular_do_not():
    rng = np.random.default_rng(3)
    packets = 16 * np.sort(rng.choice(1000, 60, replace=False))
    assert likeness.of_runs(packets, np.ones(60, dtype=int)) < 1e-6  # at the head of packets
    random = np.sort(rng.choice(16_000, 60, replace=False))
    assert likeness.of_runs(random, np.full(60, 7)) < 1e-3  # all as long


def test_exponential_heights_look_like_that_and_steps_of_a_word_do_not():
    p = [likeness.of_heights(np.random.default_rng(seed).exponential(2.0, 40), seed) for seed in range(SEEDS)]
    assert np.mean(np.array(p) < SHARE) < MOST
    bits = 2.0 ** -np.random.default_rng(1).integers(0, 3, 60) + 0.001 * np.random.default_rng(2).standard_normal(60)
    assert likeness.of_heights(bits) < 0.01


def test_white_noise_looks_like_that():
    p = [likeness.of_noise(_noise(seed)) for seed in range(SEEDS)]
    assert np.mean(np.array(p) < SHARE) < MOST


@pytest.mark.parametrize("kind", ["lulls", "bursts", "heavy tails"])
def test_noise_that_comes_and_goes_does_not(kind):
    parts = _noise(7)
    for part in parts:
        if kind == "lulls":  # packets filled by straight lines
            for start in range(0, part.size - 60, 120):
                part[start : start + 12] = np.linspace(part[start], part[start + 11], 12) + 1e-6 * part[start : start + 12]
        elif kind == "bursts":
            part[::1] *= np.where(np.arange(part.size) % 400 < 60, 2.5, 1.0)
        else:
            part *= np.abs(np.random.default_rng(part.size).standard_t(4, part.size))
    assert likeness.of_noise(parts) < 1e-4


def test_too_little_says_nothing():
    assert likeness.of_runs(np.arange(5), np.ones(5, dtype=int)) == 1.0
    assert likeness.of_heights(np.ones(3)) == 1.0
    assert likeness.of_noise([np.ones(20)]) == 1.0


def test_noise_that_depends_on_the_reading_is_not_white():
    rng = np.random.default_rng(5)
    x = np.linspace(-50, 50, 6000)
    jumps = np.where(np.abs(x) < 2, 3.0, 1.0)
    assert likeness.of_noise([x + jumps * rng.standard_normal(x.size)]) < 1e-4
    assert likeness.of_noise([x + rng.standard_normal(x.size)]) > 0.01


def test_events_at_random_moments_look_like_that_whatever_the_readings_do():
    t = np.arange(20_000)
    readings = [t.astype(float), np.sin(t / 3000.0), np.round(np.cos(t / 900.0), 1), np.where(t < 15_000, 0.0, 1.0)]
    assert likeness.of_places([]) == likeness.of_places([(readings[0], readings[0][:1])]) == 1.0
    for count in (2, 9, 300):
        p = []
        for seed in range(SEEDS):
            own = np.random.default_rng(seed).choice(t.size, count, replace=False)
            p.append(likeness.of_places([(one, one[own]) for one in readings]))
        assert np.mean(np.array(p) < SHARE) < MOST


def test_events_that_go_with_a_reading_or_come_together_do_not():
    rng, t = np.random.default_rng(5), np.arange(20_000)
    reading = np.sin(t / 700.0)
    passing = np.flatnonzero(np.diff(reading > 0.4))[:8]
    assert likeness.of_places([(reading, reading[passing]), (t, t[passing])]) < 1e-6
    burst = 7000 + rng.choice(100, 6, replace=False)
    among = np.append(rng.choice(t.size, 6, replace=False), burst)
    assert likeness.of_places([(reading, reading[among]), (t, t[among])]) < 1e-6


def test_many_events_are_thinned_by_chance():
    t = np.arange(100_000.0)
    own = np.flatnonzero(np.random.default_rng(2).random(t.size) < 0.05)
    kept = likeness.some(own)
    assert kept.size == likeness.SOME
    assert likeness.of_places([(t, t[kept])]) > 0.01
    assert likeness.of_places([(t, t[own[: likeness.SOME]])]) < 1e-6


def test_signs_that_go_with_nothing_are_random_and_others_are_told():
    """Also where most are of one sign; a fault that goes with the direction of a turn has signs that do."""
    p = []
    for seed in range(4 * SEEDS):
        rng = np.random.default_rng(seed)
        p.append(likeness.of_signs(rng.random(40) < 0.9, [rng.standard_normal(40)]))
    assert scipy.stats.kstest(p, "uniform").pvalue > 1e-3
    reading = np.random.default_rng(1).standard_normal(30)
    assert likeness.of_signs(reading > 0, [reading[::-1], reading]) < 1e-5
    assert likeness.of_signs(reading > 0, [reading[::-1]]) > 1e-3
    assert likeness.of_signs(np.ones(30, dtype=bool), [reading]) == 1.0
    assert likeness.of_signs(reading[:5] > 0, [reading[:5]]) == 1.0
    assert likeness.of_signs(reading > 0, [np.zeros(30)]) == 1.0
