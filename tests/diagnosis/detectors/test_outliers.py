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


def test_spikes_of_a_body_that_never_rests_are_found_and_its_steps_are_none():
    spoilt, clean = thrusting(spikes=10.0)
    report = examine(spoilt)
    (symptom,) = [one for one in report.symptoms if one.kind == "outliers"]
    assert symptom.axis == "x"
    assert symptom.size == pytest.approx(np.rad2deg(10 * SIGMA), rel=0.1)
    assert 0.5 * 120 / 20_000 < symptom.parameters["fraction"] < 1.5 * 120 / 20_000
    found = np.abs(spoilt.gyro.rates - clean)[:, 0] > 0
    assert (report.rates != spoilt.gyro.rates)[found, 0].mean() > 0.8
    assert np.abs(report.rates - clean)[found, 0].mean() < 4 * SIGMA
    report = examine(thrusting(steps=20.0)[0])
    assert not [one for one in report.symptoms if one.kind.startswith("outlier")]


@pytest.mark.skipif(not (SHARED / "real").exists(), reason="the real recordings are not there")
def test_quick_motion_of_a_real_body_is_no_spike():
    """The rate changes by tens of deg/s from sample to sample, and unevenly."""
    flight = SHARED / "real" / "broad" / "07_undisturbed_fast_rotation_B.parquet"
    recording = broad.build_recording(broad.read(flight)).recording
    assert "outliers" not in [one.kind for one in examine(recording).symptoms]
