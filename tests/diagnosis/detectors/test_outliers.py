"""Outliers of a body that rests for a part of the time, which are no rest where they are large."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.detectors.samples import examine
from studies.validation import broad
from tests import SHARED
from tests.diagnosis.recordings import of_rates

SAMPLE_S, ARW = 0.1, 3e-4
SIGMA = ARW / np.sqrt(SAMPLE_S)
EVERY = 397


def driving(spikes=0.0):
    """A rover that stands and drives by turns, shaken while it drives; one sample in hundreds of gyro x is off by `spikes`."""
    rng = np.random.default_rng(8)
    t_s = SAMPLE_S * np.arange(14_400)
    drives = (t_s % 240.0 > 150.0)[:, None]
    turning = 0.05 * np.sin(2 * np.pi * t_s[:, None] / np.array([31.0, 43.0, 57.0])) + 3 * SIGMA * rng.standard_normal(
        (t_s.size, 3)
    )
    made = of_rates(np.where(drives, turning, 0.0), 40, SAMPLE_S, ARW, 3e-4, 1)
    read = made.gyro.rates.copy()
    read[50::EVERY, 0] += spikes * rng.choice([-1.0, 1.0], read[50::EVERY, 0].size)
    return replace(made, gyro=replace(made.gyro, rates=read)), made.gyro.rates


def test_outliers_of_a_thousand_sigmas_are_found_and_taken_out():
    spoilt, clean = driving(1000 * SIGMA)
    report = examine(spoilt)
    (symptom,) = [one for one in report.symptoms if one.kind == "outliers"]
    assert symptom.axis == "x"
    assert symptom.size == pytest.approx(np.rad2deg(1000 * SIGMA), rel=0.05)
    assert symptom.parameters["fraction"] == pytest.approx(1 / EVERY, rel=0.1)
    assert np.abs(report.rates - clean).max() < 20 * SIGMA
    assert report.rates[:, 1:] == pytest.approx(clean[:, 1:], abs=0)


def test_a_rover_that_starts_and_stops_has_none():
    assert not [one for one in examine(driving()[0]).symptoms if one.kind.startswith("outlier")]


def thrusting(spikes=0.0, steps=0.0):
    """A body that never rests: a fast swing, spikes of gyro x at random places, and steps of its rate about x at others."""
    rng = np.random.default_rng(11)
    t_s = SAMPLE_S * np.arange(20_000)
    rates = 40 * SIGMA * np.sin(2 * np.pi * t_s[:, None] / np.array([2.1, 2.7, 3.3]) + np.array([0.0, 1.0, 2.0]))
    places = 40 + 160 * np.arange(120) + rng.integers(0, 80, 120)
    signs = rng.choice([-1.0, 1.0], 120)
    jumps = np.zeros(t_s.size)
    jumps[places] = steps * signs * SIGMA
    rates[:, 0] += np.cumsum(jumps)
    made = of_rates(rates, 40, SAMPLE_S, ARW, 3e-4, 1)
    read = made.gyro.rates.copy()
    read[places, 0] += spikes * signs * SIGMA
    return replace(made, gyro=replace(made.gyro, rates=read)), made.gyro.rates


def test_spikes_of_a_body_that_never_rests_are_found_at_ten_times_the_noise():
    spoilt, clean = thrusting(spikes=10.0)
    report = examine(spoilt)
    (symptom,) = [one for one in report.symptoms if one.kind == "outliers"]
    assert symptom.axis == "x"
    assert symptom.size == pytest.approx(np.rad2deg(10 * SIGMA), rel=0.1)
    assert 0.5 * 120 / 20_000 < symptom.parameters["fraction"] < 1.5 * 120 / 20_000
    found = np.abs(spoilt.gyro.rates - clean)[:, 0] > 0
    assert (report.rates != spoilt.gyro.rates)[found, 0].mean() > 0.8
    assert np.abs(report.rates - clean)[found, 0].mean() < 4 * SIGMA


@pytest.mark.parametrize("seed", [0, 1])
def test_the_size_of_a_few_that_stand_out_of_many_is_no_height_of_theirs(seed):
    """Of outliers of two sigmas in the mean only those beyond five are seen; or all there are have one height."""
    rng = np.random.default_rng(seed)
    made = of_rates(np.zeros((40_000, 3)), 40, SAMPLE_S, ARW, 3e-4, 1)
    for size, hit, height in (
        (2.0, rng.random(40_000) < 0.0015, rng.laplace(0.0, 2.0, 40_000)),
        (30.0, np.arange(40_000) % 6_000 == 3_000, 30.0 * rng.choice([-1.0, 1.0], 40_000)),
    ):
        read = made.gyro.rates.copy()
        read[:, 0] += np.where(hit, height * SIGMA, 0.0)
        for symptom in examine(replace(made, gyro=replace(made.gyro, rates=read))).symptoms:
            if symptom.kind == "outliers":
                assert abs(symptom.size - np.rad2deg(size * SIGMA)) < 3.5 * symptom.sigma


def test_steps_of_the_rate_are_no_spikes():
    report = examine(thrusting(steps=20.0)[0])
    assert not [one for one in report.symptoms if one.kind.startswith("outlier")]


def jolted(width):
    """A body whose slow swing is struck at random: each stroke rings on for a few samples, as a structure's does."""
    rng = np.random.default_rng(0)
    n, since = 14_400, np.arange(60)
    rates = 0.02 * np.sin(2 * np.pi * SAMPLE_S * np.arange(n)[:, None] / np.array([17.0, 23.0, 31.0]))
    for axis in range(3):
        strokes = np.cumsum(rng.exponential(60.0, n // 30)).astype(int)
        for at in strokes[strokes < n - 80]:
            height, period = 40 * SIGMA * rng.standard_normal(), width * rng.uniform(0.5, 2.0)
            rates[at : at + since.size, axis] += height * np.sin(2 * np.pi * since / period) * np.exp(-since / period)
    return of_rates(rates, 40, SAMPLE_S, ARW, 3e-4, 1)


@pytest.mark.parametrize("width", [3.0, 6.0, 8.0])
def test_a_jolted_body_that_rings_has_no_outliers(width):
    assert not [one for one in examine(jolted(width)).symptoms if one.kind.startswith("outlier")]


@pytest.mark.skipif(not (SHARED / "real").exists(), reason="the real recordings are not there")
def test_quick_motion_of_a_real_body_is_no_spike():
    """The rate changes by tens of deg/s from sample to sample, and unevenly."""
    flight = SHARED / "real" / "broad" / "07_undisturbed_fast_rotation_B.parquet"
    recording = broad.build_recording(broad.read(flight)).recording
    assert "outliers" not in [one.kind for one in examine(recording).symptoms]
