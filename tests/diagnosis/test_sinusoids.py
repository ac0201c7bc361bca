"""Fit of a sinusoid against simulation: no bias, and sigmas that cover, with a phase for each piece and with one for all.

One phase over several intervals: evidence against columns made at once, and the false alarms of its best frequency.
"""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
import scipy.stats

from diagnosis.inference.evidence import log_bayes
from diagnosis.sinusoids import (
    SCALES,
    IntervalProducts,
    Piece,
    compute_log_p,
    compute_power,
    compute_segment_spectrum,
    find_frequency,
    find_tops,
    fit_sinusoid,
    make_waves,
)

NOISE, SIZE, HZ = 1.0, 0.4, 0.1037
TIMES = [np.arange(0.0, 800.0), np.arange(5000.0, 5500.0)]

LONG_TIMES = [np.arange(0.0, 300.0), np.arange(2000.0, 2200.0), np.arange(7000.0, 7300.0)]
T = np.concatenate(LONG_TIMES)
OWNER = np.repeat([0, 1, 2], [one.size for one in LONG_TIMES])
MIDDLE = np.array([one.mean() for one in LONG_TIMES])
MADE = np.array([0.0917, 0.2113])
NEAR = MADE[:, None] + 1e-5 * np.arange(-8, 9)  # at most 1/(32 · 300 s) from the frequency at which waves are made


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


def compute_products(frequency, waves, y, interval, middle_s):
    """Products of waves of a sine and a cosine at each frequency, without nuisance parameters."""
    starts = np.flatnonzero(np.diff(interval, prepend=-1))
    back = np.exp(-2j * np.pi * np.outer(middle_s, frequency))
    a = (waves[:, 1::2] + 1j * waves[:, ::2]) * back[np.searchsorted(starts, np.arange(y.size), side="right") - 1]
    z = np.add.reduceat(a * y[:, None], starts, axis=0)
    s = np.add.reduceat(a * a, starts, axis=0)
    return IntervalProducts(middle_s, z.T[:, :, None], np.sum(np.abs(a) ** 2, axis=0), s.T[:, :, None])


def evidence_of(y):
    return compute_products(MADE, make_waves(MADE, T), y, OWNER, MIDDLE).compute_log_evidence(NEAR)


def test_evidence_is_that_of_columns_made_at_each_frequency():
    rng = np.random.default_rng(1)
    y = 0.3 * np.sin(2 * np.pi * (MADE[0] + 3e-5) * T + 1.0) + rng.standard_normal(T.size)
    found = evidence_of(y)
    for j, k in ((0, 11), (0, 2), (1, 5)):
        X = make_waves(NEAR[j, k], T)
        scales = np.array(SCALES) / np.sqrt(0.5 * np.sum(X**2))
        expected = log_bayes((X.T @ X)[None], (X.T @ y)[None], scales).max()
        assert found[j, k] == pytest.approx(expected, abs=0.02 * abs(expected) + 0.2)
    assert abs(int(find_tops(found[0], 1)[0]) - 11) <= 3  # its sigma is 0.9 steps
    assert found[0].max() > 15


def test_noise_has_no_evidence_and_tops_are_in_order():
    """The evidence of a sinusoid exceeds e^x by chance in at most e^-x of the cases, at any one frequency."""
    rng = np.random.default_rng(2)
    values = np.array([evidence_of(rng.standard_normal(T.size))[:, 8] for _ in range(400)]).ravel()
    for x in (2.0, 4.0):
        assert np.mean(values > x) <= len(SCALES) * np.exp(-x)
    assert find_tops(np.array([0.0, 3.0, 1.0, 5.0, 5.0, 2.0, 4.0]), 2).tolist() == [3, 6]
