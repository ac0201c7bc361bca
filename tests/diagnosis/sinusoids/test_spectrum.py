"""Mean periodograms: level, p-value and amplitude of a line, of even and of uneven times."""

import numpy as np
import pytest
import scipy.signal
import scipy.stats

from diagnosis.sinusoids import spectrum
from diagnosis.sinusoids.spectrum import compute_log_p, compute_piece_spectrum, compute_power, compute_segment_spectrum

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


def test_the_p_value_of_uneven_pieces_holds_for_white_noise():
    """Two pieces share the frequencies up to half the rate of the slower one; beyond it the other one counts alone."""
    rng, smallest = np.random.default_rng(4), []
    frequencies = np.arange(0.01, 0.45, 0.005)
    for _ in range(300):
        times = [np.sort(rng.uniform(0, 200, count)) for count in (200, 100)]
        found = compute_piece_spectrum([(t, rng.standard_normal((t.size, 1))) for t in times], frequencies, [0.5, 0.25])
        log_p = compute_log_p(found.power, np.maximum(found.count, 1), frequencies.size)
        smallest.append(float(np.exp(log_p.min())))
    assert set(found.count.ravel()) == {1, 2}
    for p in (0.05, 0.2):
        # Frequencies are not independent, so that fewer are found than p, but not far fewer.
        assert 0.4 * p < np.mean(np.array(smallest) < p) < p + 3 * np.sqrt(p * (1 - p) / 300)


def test_power_is_that_of_the_transform():
    t, x = np.arange(64.0), np.random.default_rng(5).standard_normal((64, 2))
    expected = np.abs(np.fft.rfft(x - x.mean(axis=0), axis=0)[1:]) ** 2 / 64
    np.testing.assert_allclose(compute_power(t, x, np.fft.rfftfreq(64)[1:]), expected, atol=1e-9)


def test_log_p_is_that_of_a_mean_of_exponentials():
    assert float(compute_log_p(9.0, 1.0, 100)) == pytest.approx(np.log(100) - 9.0)
    assert float(compute_log_p(3.0, 4.0, 1)) == pytest.approx(scipy.stats.chi2(8).logsf(24.0))
    assert float(compute_log_p(0.1, 1.0, 100)) == 0.0


@pytest.mark.parametrize("window", ["hann", "blackmanharris"])
def test_tapers_are_those_of_scipy(window):
    np.testing.assert_allclose(spectrum.make_taper(window, 128), scipy.signal.windows.get_window(window, 128), atol=1e-15)
