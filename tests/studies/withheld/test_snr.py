"""The signal-to-noise ratios against closed forms."""

import numpy as np
import pytest

from simulator.effects import setting
from studies.withheld.snr import Change
from tests.studies.withheld.conftest import ARW, SAMPLE_S, SIGMA


def test_reference_error_at_rest_is_least_squares(resting):
    """With next to no random walk what is left beside start attitude and bias is what a line leaves."""
    t = resting.around.references.t_s
    error = np.zeros((len(t), 3))
    error[:, 1] = 3e-4 * np.sin(2 * np.pi * t / 900.0)
    line = np.column_stack([np.ones(len(t)), t])
    left = error[:, 1] - line @ np.linalg.lstsq(line, error[:, 1], rcond=None)[0]
    change = Change(np.zeros_like(resting.around.stream.raw), error)
    attitude, samples = resting.measure([change])
    assert attitude == pytest.approx(np.linalg.norm(left) / SIGMA, rel=0.02)
    assert samples == 0


def test_noise_level_is_that_of_its_divergence(resting):
    """√(n (f² − 1 − ln f²)) of n samples whose noise is f times as large."""
    factor, count = 1.3, len(resting.around.stream.t_s)
    one = setting("noise_excess", "x", factor)
    _, samples = resting.measure(resting.list_changes(one))
    assert samples == pytest.approx(np.sqrt(count * (factor**2 - 1 - np.log(factor**2))), rel=0.2)


def test_waveform_below_the_noise_of_a_sample_earns_no_matched_filter(turning):
    """A rough waveform of a tenth of the noise: a filter that knows it would have a ratio of 6, its level has one below 1."""
    rng, sigma = np.random.default_rng(1), ARW / np.sqrt(SAMPLE_S)
    raw = np.zeros_like(turning.around.stream.raw)
    raw[:, 0] = 0.1 * sigma * rng.choice([-1.0, 1.0], len(raw))
    _, samples = turning.measure([Change(raw, np.zeros((len(turning.around.references.t_s), 3)))])
    assert np.linalg.norm(raw) / sigma > 6
    assert samples < 1


def test_what_follows_the_motion_does_not_show_in_the_samples(turning):
    """A tenth of the body's own rate: the attitude shows the part that G does not take up, the samples nothing."""
    later = 0.1 * turning.around.stream.raw * np.linspace(0, 1, 4000)[:, None] ** 2
    attitude, samples = turning.measure([Change(later, np.zeros((len(turning.around.references.t_s), 3)))])
    assert attitude > 100
    assert samples < 0.1 * attitude
