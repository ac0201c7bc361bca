"""Noise that swells and falls within an interval: its statistics under white noise, and what is found and what is not."""

import numpy as np
import pytest

from diagnosis.detectors import noise_structure as structure
from diagnosis.detectors.report import SampleReport
from tests.diagnosis.detectors.test_noise_patterns import COUNT, SIGMA, drawn, moving, recording_of


def report_of(x):
    none = np.zeros(COUNT, dtype=bool)
    report = SampleReport([], [], SIGMA * x, np.full(x.shape, SIGMA**2), none, none.copy())
    structure.constancy(report, recording_of(x), np.ones(COUNT, dtype=bool))
    return report


def chances(x):
    return [one.p_value for one in report_of(x).tests if one.statistic == "noise_steadiness"]


def swelling(period, depth):
    """Amplitudes of noise that grows and falls back within so many samples, of mean square one."""
    return np.sqrt(1 + depth * np.sin(2 * np.pi * np.arange(COUNT) / period))[:, None]


@pytest.mark.parametrize("order", [structure.ORDER, structure.HIGHER])
def test_the_spread_of_a_median_is_that_of_many(order):
    draws, count = 4000, 400
    z = np.diff(np.random.default_rng(order).standard_normal((draws, count + order)), order, axis=1)
    logs = 2 * np.log(np.median(np.abs(z), axis=1))
    # A variance over draws is known to √(2/draws), and so short a window adds some percent.
    assert count * np.var(logs) == pytest.approx(structure.spread_of_median(order), rel=0.03 + 3 * np.sqrt(2 / draws))


def test_steady_noise_on_a_moving_body_is_no_surprise():
    found = np.concatenate([chances(moving() + drawn(seed)) for seed in range(40)])
    assert found.size == 120
    # The less surprised of two statistics: fewer than stated are small.
    assert np.mean(found < 0.1) < 0.1 + 3 * np.sqrt(0.1 * 0.9 / found.size)
    assert found.min() > 1e-4


@pytest.mark.parametrize("period", [3000, 9000])
def test_noise_that_swells_is_found_on_its_gyro(period):
    x = moving() + drawn(3) * np.where(np.arange(3) == 1, swelling(period, 0.6), 1.0)
    report = report_of(x)
    assert [(one.kind, one.axis) for one in report.symptoms] == [("noise_constancy", "y")]
    assert report.symptoms[0].p_value < 1e-8


def test_jerks_and_spikes_in_some_windows_are_not_unsteady_noise():
    rng = np.random.default_rng(5)
    jerks = np.cumsum(np.where(rng.random((COUNT, 3)) < 2e-4, 30.0 * rng.standard_normal((COUNT, 3)), 0.0), axis=0)
    spikes = np.where(rng.random((COUNT, 3)) < 1e-3, 8.0, 0.0)
    assert report_of(moving() + drawn(4) + jerks + spikes).symptoms == []


def test_bursts_are_found():
    rng = np.random.default_rng(6)
    louder = np.ones((COUNT, 3))
    for place in rng.integers(0, COUNT - 300, 12):
        louder[place : place + 300, 2] = 2.0
    assert [(one.kind, one.axis) for one in report_of(moving() + drawn(7) * louder).symptoms] == [("noise_constancy", "z")]


def test_a_body_that_shakes_nearly_as_fast_as_it_is_sampled_has_no_unsteady_noise(monkeypatch):
    """At one frequency differences of either order hold the same share of a tone, as they do of white noise."""
    low, high = structure.ORDER, structure.HIGHER
    gain = (structure.power_of(high) / structure.power_of(low)) ** (1 / (high - low))  # (2 sin ½ωΔt)²
    tone = 2.0 * np.sin(2 * np.arcsin(0.5 * np.sqrt(gain)) * np.arange(COUNT))
    for first, last in ((0, 2000), (COUNT - 1900, COUNT)):
        shaking = np.where((np.arange(COUNT) >= first) & (np.arange(COUNT) < last), tone, 0.0)
        x = moving() + drawn(8) + shaking[:, None] * np.array([0.0, 0.0, 1.0])
        assert report_of(x).symptoms == []
        with monkeypatch.context() as without:
            without.setattr(structure, "RINGING", 0.0)
            assert [(one.kind, one.axis) for one in report_of(x).symptoms] == [("noise_constancy", "z")]


def test_a_body_that_shakes_at_many_rates_for_one_window_has_no_unsteady_noise():
    """Both orders hold as much of motions about 0.42 of the samples' rate as of noise; of sixty of them no line shows."""
    low, high = structure.ORDER, structure.HIGHER
    gain = (structure.power_of(high) / structure.power_of(low)) ** (1 / (high - low))
    middle = np.arcsin(0.5 * np.sqrt(gain)) / np.pi
    rng = np.random.default_rng(9)
    tones = np.sum(
        [np.sin(2 * np.pi * (f * np.arange(COUNT) + rng.random())) for f in np.linspace(middle - 0.03, middle + 0.03, 60)],
        axis=0,
    )
    begin = 10 * structure.FEWEST
    inside = (np.arange(COUNT) >= begin) & (np.arange(COUNT) < begin + structure.FEWEST - 20)
    x = moving() + drawn(10) + np.where(inside, 0.25 * tones, 0.0)[:, None] * np.array([0.0, 1.0, 0.0])
    assert report_of(x).symptoms == []
