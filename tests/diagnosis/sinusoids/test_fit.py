"""Fit of a sinusoid against simulation: no bias, and sigmas that cover, with a phase for each piece and with one for all."""

import numpy as np
import pytest
import scipy.signal
import scipy.stats

from diagnosis.sinusoids.fit import Piece, find_frequency, fit_sinusoid
from diagnosis.sinusoids.spectrum import compute_log_p, compute_power, compute_segment_spectrum

NOISE, SIZE, HZ = 1.0, 0.4, 0.1037
TIMES = [np.arange(0.0, 800.0), np.arange(5000.0, 5500.0)]


def project(t_s, degree=3):
    """Takes a polynomial out of columns: the background of a smooth motion."""
    Q = np.linalg.qr(np.polynomial.legendre.legvander(2 * (t_s - t_s.mean()) / np.ptp(t_s), degree))[0]
    return lambda columns: columns - Q @ (Q.T @ columns)


def make_pieces(rng, common, amplitude=SIZE, frequency=HZ):
    """Pieces with a cubic motion a thousand times as large as the noise; one phase for all in one piece only."""
    phases = rng.uniform(0, 2 * np.pi, 2) if not common else np.full(2, rng.uniform(0, 2 * np.pi))
    data, takers = [], [project(t) for t in TIMES]
    for t, phase, take in zip(TIMES, phases, takers, strict=True):
        motion = 1000.0 * ((t - t.mean()) / np.ptp(t)) ** 3
        wave = amplitude * np.sin(2 * np.pi * frequency * t + phase)
        data.append(take(wave + motion + NOISE * rng.standard_normal(t.size)))
    if not common:
        return [Piece(t, y, take) for t, y, take in zip(TIMES, data, takers, strict=True)]
    first = TIMES[0].size
    whole = lambda columns: np.concatenate([takers[0](columns[:first]), takers[1](columns[first:])])  # noqa: E731
    return [Piece(np.concatenate(TIMES), np.concatenate(data), whole)]


@pytest.mark.parametrize("common", [True, False])
def test_frequency_and_amplitude_have_the_sigmas_that_are_stated(common):
    rng, off = np.random.default_rng(1), []
    for _ in range(200):
        start = HZ + (1e-5 if common else 1e-4) * rng.uniform(-1, 1)
        fit = fit_sinusoid(make_pieces(rng, common), start, 1e-3)
        size, sigma = fit.size
        off.append([(fit.frequency_hz - HZ) / fit.sigma_hz, (size - SIZE) / sigma])
    off = np.array(off)
    np.testing.assert_allclose(off.std(axis=0), 1.0, atol=4 / np.sqrt(400))
    assert np.abs(off.mean(axis=0)).max() < 4 / np.sqrt(200)
    # The information on a frequency is (2πA)²/2σ² times the square sum of the times about their mean, of all or of each piece.
    groups = [np.concatenate(TIMES)] if common else TIMES
    information = 0.5 * (2 * np.pi * SIZE / NOISE) ** 2 * sum(float(np.sum((t - t.mean()) ** 2)) for t in groups)
    assert fit.sigma_hz == pytest.approx(1 / np.sqrt(information), rel=0.25)


@pytest.mark.parametrize("common", [True, False])
def test_chi2_of_noise_beside_a_motion_has_its_degrees_of_freedom(common):
    rng = np.random.default_rng(2)
    chi2 = [fit_sinusoid(make_pieces(rng, common, amplitude=0.0), HZ, 0.0, steps=0).chi2 for _ in range(400)]
    dof = 2 if common else 4
    assert np.mean(chi2) == pytest.approx(dof, abs=4 * np.sqrt(2 * dof / 400))


def test_a_frequency_is_found_between_the_bins_of_short_segments():
    rng = np.random.default_rng(3)
    pieces = make_pieces(rng, common=False, amplitude=1.0)
    assert find_frequency(pieces, HZ + 3e-3, 5e-3, 1.0) == pytest.approx(HZ, abs=0.1 / 800)


ARCS = [(0, 6000), (6000, 9000)]


@pytest.mark.parametrize("window", ["hann", "blackmanharris"])
def test_white_noise_has_its_variance_and_a_sinusoid_its_amplitude(window):
    rng = np.random.default_rng(1)
    found = compute_segment_spectrum(3.0 * rng.standard_normal(9000), ARCS, 600, 0.1, window)
    assert found.power[3:-3].mean() == pytest.approx(9.0, rel=0.05)
    level = found.compute_level(61)
    assert np.mean(level[10:-10]) == pytest.approx(9.0, rel=0.1)
    wave = 2.5 * np.sin(2 * np.pi * found.frequency_hz[77] * 0.1 * np.arange(9000) + 0.3)
    tone = compute_segment_spectrum(wave, ARCS, 600, 0.1, window)
    assert tone.amplitude_of_one * np.sqrt(tone.power[77]) == pytest.approx(2.5, rel=1e-3)


@pytest.mark.parametrize("window", ["hann", "blackmanharris"])
def test_overlapping_segments_scatter_as_stated(window):
    """The variance of a mean of n independent exponentials is 1/n of its square."""
    rng, powers = np.random.default_rng(2), []
    for _ in range(60):
        found = compute_segment_spectrum(rng.standard_normal(9000), ARCS, 600, 0.1, window)
        powers.append(found.power[5:-5])
    assert 1 / np.var(powers) == pytest.approx(float(found.count[0]), rel=0.06)


def test_power_and_its_p_value_are_those_of_closed_forms():
    t, x = np.arange(64.0), np.random.default_rng(5).standard_normal((64, 2))
    expected = np.abs(np.fft.rfft(x - x.mean(axis=0), axis=0)[1:]) ** 2 / 64
    np.testing.assert_allclose(compute_power(t, x, np.fft.rfftfreq(64)[1:]), expected, atol=1e-9)
    assert float(compute_log_p(9.0, 1.0, 100)) == pytest.approx(np.log(100) - 9.0)
    assert float(compute_log_p(3.0, 4.0, 1)) == pytest.approx(scipy.stats.chi2(8).logsf(24.0))
    assert float(compute_log_p(0.1, 1.0, 100)) == 0.0
