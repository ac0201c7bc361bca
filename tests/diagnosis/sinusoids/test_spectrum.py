"""Mean periodograms: level, p-value and amplitude of a line, of even and of uneven times."""

import numpy as np
import pytest
import scipy.signal
import scipy.stats

from diagnosis.sinusoids.spectrum import compute_log_p, compute_power, compute_segment_spectrum

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
