"""Stream tests: each finds its effect with its size, and nothing in M0."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from diagnosis.detectors import samples as stream
from diagnosis.detectors.samples import examine
from diagnosis.detectors.spectral_lines import Look, find_peak
from diagnosis.settings import DEFAULT
from simulator import scenario
from simulator.effects import parse
from simulator.simulate import motion, observe
from simulator.streams import generator
from studies.validation import broad
from tests import SHARED
from tests.diagnosis.recordings import of_rates

FLIGHT = scenario.override(scenario.load("trmm"), {"gyro.arw_deg_per_sqrt_s": 1.5e-4})


@pytest.fixture(scope="module")
def plan():
    """The first three of the flight's six intervals: half of the samples."""
    return FLIGHT.model_copy(update={"interval": FLIGHT.interval[:3]})


@pytest.fixture(scope="module")
def truth(plan):
    return motion(plan)


def _recording(plan, truth, seed, *effects):
    return observe(
        plan,
        truth,
        gyro_rng=generator(seed, 0, "gyro_noise"),
        reference_rng=generator(seed, 0, "reference_noise"),
        effects=[parse(text) for text in effects],
        seed=seed,
    )


def test_m0_shows_nothing(plan, truth):
    for seed in range(3):
        report = stream.examine(_recording(plan, truth, seed))
        assert report.symptoms == ()
        assert report.lines == ()
        assert min(test.p_value for test in report.tests) > 1e-6


@pytest.mark.parametrize(
    ("text", "symptom", "axis", "size", "sigma"),
    [
        ("rate_quantization:y=1e-3", "lattice", "y", 1e-3, 1e-8),
        ("rate_truncation=1e-3", "lattice", None, 1e-3, 1e-8),
        ("stale_samples=3,fraction=0.01", "repeats", None, 3.0, None),
        ("spikes:x=0.004,fraction=0.001", "outliers", "x", 0.004, None),
        ("noise_excess=1.3", "white_noise_level", None, 1.3, None),
        ("noise_excess=0.8", "white_noise_level", None, 0.8, None),
    ],
)
def test_each_symptom_is_found_alone_with_its_size(plan, truth, text, symptom, axis, size, sigma):
    (found,) = stream.examine(_recording(plan, truth, 1, text)).symptoms
    assert (found.kind, found.axis) == (symptom, axis)
    assert abs(found.size - size) < 4 * (found.sigma if sigma is None else sigma)
    assert found.p_value < DEFAULT.sample_event


@pytest.mark.parametrize(("amplitude", "frequency"), [(1e-4, 0.31), (4e-4, 0.706)])
def test_a_tone_is_found_with_its_amplitude_and_frequency(plan, truth, amplitude, frequency):
    report = stream.examine(_recording(plan, truth, 1, f"vibration:y={amplitude},apparent_hz={frequency}"))
    (line,) = report.lines
    assert line.axis == 1
    assert line.frequency_hz == pytest.approx(frequency, abs=1e-4)
    assert abs(np.rad2deg(line.amplitude) - amplitude) < 4 * np.rad2deg(line.sigma)
    assert report.symptoms == ()  # the body may move so


@pytest.mark.parametrize(("arcs", "moving"), [([4000] * 6, False), ([700] * 40, True)])
def test_the_p_value_of_the_strongest_line_holds_for_white_noise(arcs, moving):
    edges = np.cumsum([0, *arcs])
    look = Look(list(pairwise(edges)), moving)
    p = [find_peak(np.random.default_rng(seed).standard_normal(edges[-1]), look, 0.1).p_value for seed in range(120)]
    assert np.mean(np.array(p) < 0.05) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 120)
    assert min(p) > 1e-5


def test_readings_that_are_rounded_or_cut_below_their_noise_show_nothing(plan, truth):
    clean = _recording(plan, truth, 3)
    step = 0.11 * clean.gyro.arw / np.sqrt(clean.gyro.sample_s)
    for how in (np.trunc, np.round):
        report = stream.examine(replace(clean, gyro=replace(clean.gyro, rates=how(clean.gyro.rates / step) * step)))
        assert report.symptoms == ()
        assert report.cut_steps == pytest.approx(np.full(3, step), rel=1e-6)


def test_two_axes_that_repeat_together_are_no_repeats_of_all(plan, truth):
    """A calibration in the sensor that mixes two axes makes them repeat at once, far more often than each by chance."""
    recording = _recording(plan, truth, 7)
    step = 1.2 * np.deg2rad(1.5e-4) / np.sqrt(recording.gyro.sample_s)
    counts = np.round(recording.gyro.rates / step)
    mixed = counts + 1e-3 * counts[:, [1, 0, 2]] * [1.0, 1.0, 0.0]
    report = stream.examine(replace(recording, gyro=replace(recording.gyro, rates=mixed * step)))
    assert "repeats" not in {one.kind for one in report.symptoms}


def test_a_sway_that_two_gyros_show_in_quiet_arcs_is_no_slow_noise(plan, truth):
    """It is slow beside the samples and fast beside their means; readout noise under it is still told by the upper spectrum."""
    recording = _recording(plan, truth, 5, "noise_angle_white:y=0.6")
    sigma = np.deg2rad(1.5e-4) / np.sqrt(recording.gyro.sample_s)
    waves = np.random.default_rng(6).normal(0.11, 0.02, (3, 30)) / recording.gyro.sample_s
    sway = np.stack(
        [np.sin(2 * np.pi * np.outer(recording.gyro.t_s, own) + np.arange(30)).sum(axis=1) for own in waves], axis=1
    )
    rates = recording.gyro.rates + 0.2 * sigma * sway
    report = stream.examine(replace(recording, gyro=replace(recording.gyro, rates=rates)))
    assert {(one.kind, one.axis) for one in report.symptoms} <= {("readout_noise", "y")}
    assert report.noise_factor[[0, 2]] == pytest.approx(1.0, abs=0.02)


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
