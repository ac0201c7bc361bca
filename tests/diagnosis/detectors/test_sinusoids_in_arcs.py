"""A tone by least squares: where it is taken out."""

import numpy as np
import pytest

from diagnosis.detectors.spectral_lines import fit_line
from tests.diagnosis.recordings import recorded

HZ, SIZE, NOISE = 0.137, 2e-4, 1e-6  # of the tone, rad/s, and of a sample


@pytest.fixture(scope="module")
def recording():
    return recorded(3)


def _arcs(recording):
    """Arcs that leave out the first and last 7 samples of each interval, and some in the middle of the first."""
    t, out = recording.gyro.t_s, []
    for interval in recording.intervals:
        low, high = np.searchsorted(t, [interval.start_s - 1e-6, interval.stop_s - 1e-6])
        out.append((int(low) + 7, int(high) - 7))
    low, high = out[0]
    middle = (low + high) // 2
    return [(low, middle - 20), (middle + 20, high), *out[1:]]


def test_a_tone_is_taken_out_of_the_arcs_in_which_it_was_found_also_a_weak_one(recording):
    t, arcs = recording.gyro.t_s, _arcs(recording)
    tone = SIZE * np.sin(2 * np.pi * HZ * t + 0.4)
    x = tone + NOISE * np.random.default_rng(3).standard_normal(t.size)
    line = fit_line(x, recording, 0, HZ, 1e-4, arcs)
    inside = np.concatenate([np.arange(low, high) for low, high in arcs])
    assert np.abs(line.waveform - tone)[inside].max() < 1e-2 * SIZE
    assert not np.delete(line.waveform, inside).any()
    t, arcs = recording.gyro.t_s, _arcs(recording)
    size = 14 * NOISE * np.sqrt(2 / t.size)
    x = size * np.sin(2 * np.pi * HZ * t) + NOISE * np.random.default_rng(5).standard_normal(t.size)
    assert fit_line(x, recording, 0, HZ, 1e-4, arcs).p_value < 1e-12


def test_a_frequency_in_a_hump_of_the_noise_is_no_tone(recording):
    """What short turns of a body leave in arcs is coloured: some frequency of a hump has more power than white noise has."""
    t, arcs, found = recording.gyro.t_s, _arcs(recording), {True: [], False: []}
    for seed in range(20):
        white = np.random.default_rng(seed).standard_normal((2, t.size))
        turning = np.exp(2j * np.pi * HZ * np.arange(t.size) * recording.gyro.sample_s)
        hump = np.convolve(white[1], (np.hanning(25) / np.linalg.norm(np.hanning(25)) * turning[:25]).real, "same")
        for humped in found:
            x = NOISE * (white[0] + 1.2 * hump * humped)
            line = fit_line(x, recording, 0, HZ, 1e-4, arcs)
            found[humped].append(1.0 if line is None else line.p_value)
    assert min(found[True]) > 1e-3
    assert min(found[False]) > 1e-3
