"""Fit of a sinusoid against simulation: no bias, and sigmas that cover, with a phase for each piece and with one for all."""

import numpy as np
import pytest

from diagnosis.sinusoids.fit import Piece, find_frequency, fit_sinusoid

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
