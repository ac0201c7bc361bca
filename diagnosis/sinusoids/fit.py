"""Fit of a sinusoid: frequency, amplitudes and phases by least squares, beside a background.

Each piece of the data has a phase and an amplitude of its own. One piece for all data means one phase for all. The frequency is
common: Gauss and Newton's method finds it, with amplitudes and phases eliminated at each step (Golub and Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.sinusoids.spectrum import convolve

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEPS = 3  # of Gauss and Newton: from a tenth of the resolution the error falls below a thousandth of its sigma
ZOOM_STEP = 0.1  # between trial frequencies, in units of the resolution of the longest piece
NO_NOISE = 1e-60  # variance where the data leave nothing beside a sinusoid


@dataclass(frozen=True)
class Piece:
    """Data through which a sinusoid has one phase."""

    t_s: Array  # (n,) times of a waveform
    data: Array  # (N,) without the background
    # turns waveforms (n, k) into their contributions (N, k) to the data, without the background
    observe: Callable[[Array], Array]

    def select(self, rows: Mask) -> Piece:
        """Return the piece with some of its data only."""
        return Piece(self.t_s, self.data[rows], lambda waveforms: self.observe(waveforms)[rows])


@dataclass(frozen=True)
class SinusoidFit:
    """A sinusoid in some pieces."""

    frequency_hz: float  # frequency_hz, sigma_hz: and its standard deviation
    sigma_hz: float
    amplitudes: Array  # (p, 2) of sine and cosine in each piece
    variances: Array  # (p,) of each amplitude
    # waves, residuals: for each piece (N, 2) contributions of sine and cosine, and (N,) the data without the sinusoid
    waves: tuple[Array, ...]
    residuals: tuple[Array, ...]

    @property
    def chi2(self) -> float:
        """χ² that the sinusoid explains, with two degrees of freedom for each piece."""
        return float(np.sum(self.amplitudes**2 / self.variances[:, None]))

    @property
    def size(self) -> tuple[float, float]:
        """Amplitude common to all pieces and its sigma: pieces count by their variance, and noise adds two to χ² of each."""
        information = float(np.sum(1 / self.variances))
        power = max(self.chi2 - 2 * len(self.variances), 0.0)
        return float(np.sqrt(power / information)), float(1 / np.sqrt(information))


def make_waves(frequency_hz: Array | float, t_s: Array, duration_s: Array | float = 0.0) -> Array:
    """Return (n, 2 f) sine and cosine of each frequency, or their means over as long."""
    frequencies = np.atleast_1d(frequency_hz)
    angle = 2 * np.pi * np.outer(t_s, frequencies)
    waves = np.stack([np.sin(angle), np.cos(angle)], axis=2)
    if np.any(duration_s):
        waves *= np.sinc(np.outer(np.broadcast_to(duration_s, t_s.shape), frequencies))[:, :, None]
    return waves.reshape(t_s.size, -1)


def fit_sinusoid(pieces: Sequence[Piece], frequency_hz: float, reach_hz: float, steps: int = STEPS) -> SinusoidFit:
    """Fit a sinusoid near a frequency, at most so far from it."""
    found, sigma_hz = frequency_hz, 0.0
    for _ in range(steps):
        step, sigma_hz = _compute_step(pieces, found)
        found = float(np.clip(found + step, frequency_hz - reach_hz, frequency_hz + reach_hz))
    amplitudes, variances, all_waves, residuals = [], [], [], []
    for piece in pieces:
        waves = piece.observe(make_waves(found, piece.t_s))
        amplitude, variance, residual = _solve(waves, piece.data)
        amplitudes.append(amplitude)
        variances.append(2 * variance / max(float(np.sum(waves**2)), NO_NOISE))
        all_waves.append(waves)
        residuals.append(residual)
    return SinusoidFit(found, sigma_hz, np.array(amplitudes), np.array(variances), tuple(all_waves), tuple(residuals))


def _solve(waves: Array, data: Array) -> tuple[Array, float, Array]:
    """Amplitudes (2,), variance of the residuals, and these."""
    amplitude = np.linalg.lstsq(waves, data, rcond=None)[0]
    residual = data - waves @ amplitude
    return np.asarray(amplitude), max(float(np.mean(residual**2)), NO_NOISE), np.asarray(residual)


def _compute_step(pieces: Sequence[Piece], frequency_hz: float) -> tuple[float, float]:
    """Gauss and Newton's step of the frequency and its sigma, Hz."""
    top, bottom = 0.0, 0.0
    for piece in pieces:
        plain = make_waves(frequency_hz, piece.t_s)
        waves = piece.observe(plain)
        (s, c), variance, residual = _solve(waves, piece.data)
        elapsed = piece.t_s - piece.t_s.mean()
        turned = piece.observe((2 * np.pi * elapsed * (plain @ np.array([-c, s])))[:, None])[:, 0]
        own = turned - waves @ np.linalg.lstsq(waves, turned, rcond=None)[0]
        top, bottom = top + float(own @ residual) / variance, bottom + float(own @ own) / variance
    return (top / bottom, 1 / float(np.sqrt(bottom))) if bottom > 0 else (0.0, 0.0)


def find_frequency(pieces: Sequence[Piece], centre_hz: float, width_hz: float, sample_s: float) -> float:
    """Return the frequency near a peak at which even samples with a phase in each piece explain most, Hz."""
    span_s = max(float(np.ptp(piece.t_s)) for piece in pieces)
    low, high = max(centre_hz - width_hz, 0.1 / span_s), centre_hz + width_hz
    trial = np.linspace(low, high, 2 + int((high - low) * span_s / ZOOM_STEP))
    power = np.zeros(trial.size)
    for piece in pieces:
        transform = compute_zoom(piece.data, low * sample_s, (trial[1] - trial[0]) * sample_s, trial.size)
        power += np.abs(transform) ** 2 / max(float(piece.data @ piece.data), NO_NOISE)
    return float(trial[int(np.argmax(power))])


def compute_zoom(x: Array, first: float, step: float, count: int) -> NDArray[np.complex128]:
    """Compute the Fourier transform of a series (n,) at evenly spaced frequencies, in cycles per sample, but for its phase.

    Bluestein's transform: 2 k n = k² + n² − (k − n)² makes a convolution of the sum over n (IEEE Transactions on Audio and
    Electroacoustics 18, 1970).
    """
    n = np.arange(x.size)
    turned = x * np.exp(-2j * np.pi * n * (first + 0.5 * step * n))
    chirp = np.exp(1j * np.pi * step * np.arange(1 - x.size, count) ** 2)
    return convolve(turned, chirp)[x.size - 1 : x.size - 1 + count]
