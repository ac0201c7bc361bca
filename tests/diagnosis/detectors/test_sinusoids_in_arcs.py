"""A tone by least squares: where it is taken out."""

import numpy as np
import pytest

from diagnosis.detectors.gap_interpolation import SIDE, fill_gaps
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


DT = 0.5
T = DT * np.arange(81)


def bridged(rates, low, high, sigma=0.0, t_s=T):
    bad = np.zeros(len(t_s), dtype=bool)
    bad[low:high] = True
    spoiled = rates.copy()
    spoiled[bad] = spoiled[low - 1]
    return fill_gaps(t_s, spoiled, bad, DT, sigma)


def test_a_corner_inside_a_run_is_covered_by_its_density():
    """Slew start in the middle: the angle is off by Δs L²/24, a third of what a line makes of it."""
    n = 19
    low, high = 31, 50
    middle = 0.5 * (T[low - 1] + T[high])
    slope = 0.004
    rates = np.column_stack([slope * np.maximum(T - middle, 0)] * 3)
    out, _, density = bridged(rates, low, high)
    error = float((out - rates)[:, 0].sum() * DT)
    span = (n + 1) * DT
    assert error == pytest.approx(slope * span**2 / 24, rel=0.02)
    assert density[low:high, 0].sum() * DT == pytest.approx((slope * span**2 / 24) ** 2, rel=0.1)
    line = np.interp(T, T[[low - 1, high]], rates[[low - 1, high], 0])
    assert (line - rates[:, 0])[low:high].sum() * DT == pytest.approx(3 * error, rel=0.02)


@pytest.mark.parametrize("n", [1, 12])
def test_noise_of_a_bridge_is_as_stated(n):
    """Angle over run and neighbours against the density it is given; 3000 draws, which leaves 2.6 % of sampling error."""
    rng = np.random.default_rng(n)
    low = 35
    found, stated = [], 0.0
    for _ in range(1000):
        out, factor, _ = bridged(rng.standard_normal((T.size, 3)), low, low + n, 1.0)
        # All that a bridge is made of, so that what it shares with its neighbours is counted.
        found.append(out[low - SIDE : low + n + SIDE].sum(axis=0))
        stated = float(factor[low - SIDE : low + n + SIDE].sum())
    variance = float(np.var(found))
    assert 0.9 < variance / stated < 1.1
