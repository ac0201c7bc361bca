"""A sinusoid in arcs of the samples: its fit beside the motion of the body, and its p-value.

A local polynomial follows the motion that is slow beside the sinusoid. What it leaves of the readings is fitted to what it
leaves of waves. Each arc has its own phase.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import scipy.special
from numpy.typing import NDArray

from diagnosis.detectors.sample_report import IMPOSSIBLE, Line
from diagnosis.sinusoids.fit import Piece, SinusoidFit, find_frequency, fit_sinusoid, make_waves
from diagnosis.sinusoids.spectrum import Arcs, compute_power, convolve, remove_line
from gyrocal.recording import Recording

Array = NDArray[np.float64]

# lengths of the local polynomial, in cycles; the one that leaves the sinusoid whole is taken
SMOOTHING_CYCLES = (4, 4.5, 5, 5.5, 6, 7, 8, 9, 10)
DEGREE = 6  # of the polynomial
SUDDEN = 6.0  # robust sigmas beyond which a sample does not count: what jolts leave
FREQUENCIES_PER_SAMPLE = 2.0  # independent frequencies of a fit; oversampling finds twice the Fourier frequencies
CLEAR = 5.0  # sigmas of the amplitude below which there is no line
# resolutions of an arc from the sinusoid, at which the level of the noise is taken
BESIDE = tuple(range(3, 11))
NEARBY = 0.25  # share of the frequency within which that is


def fit_line(x: Array, recording: Recording, axis: int, centre_hz: float, width_hz: float, arcs: Arcs) -> Line | None:
    """Fit a sinusoid to the readings (n,) of a gyro, rad/s, near a peak of their spectrum; None where it is not clear."""
    sample_s, t_s = recording.gyro.sample_s, recording.gyro.t_s
    span_s = max(high - low for low, high in arcs) * sample_s
    pieces = [_make_piece(x[low:high], t_s[low:high], centre_hz * sample_s) for low, high in arcs]
    f = find_frequency([_remove_jolts(piece) for piece in pieces], centre_hz, max(width_hz, 1.5 / span_s), sample_s)
    first = fit_sinusoid(pieces, f, 0.0, steps=0)
    calm = [_is_calm(residual) for residual in first.residuals]
    pieces = [piece.select(rows) for piece, rows in zip(pieces, calm, strict=True)]
    fit = fit_sinusoid(pieces, f, 0.2 / span_s, steps=2)  # the frequency is found to a twentieth of the resolution
    size, sigma = fit.size
    if not size > CLEAR * sigma:
        return None
    samples = sum(piece.data.size for piece in pieces)
    level = _compute_level([piece.t_s[rows] for piece, rows in zip(pieces, calm, strict=True)], fit)
    chance = scipy.special.chdtrc(2 * len(pieces), fit.chi2 / level)
    p = float(np.clip(FREQUENCIES_PER_SAMPLE * samples * chance, IMPOSSIBLE, 1.0))
    return Line(axis, fit.frequency_hz, size, sigma, p, _make_waveform(fit, recording, arcs))


# ---- the motion of the body -----------------------------------------------------------------------------------------------


def _make_piece(x: Array, t_s: Array, cycles: float) -> Piece:
    """Readings of an arc without the motion that is slow beside a sinusoid of so many cycles in a sample."""

    return Piece(t_s, remove_motion(x, cycles), lambda waveforms: remove_motion(waveforms, cycles))


def remove_motion(x: Array, cycles: float) -> Array:
    """Remove from series (n,) or (n, k) the motion that is slow beside a sinusoid of so many cycles in a sample.

    A slew that begins gently is quiet to the noise tests, but would pass for noise of the sinusoid's amplitude.
    """
    kernel, gain = _choose_smoothing(cycles, len(x))
    if kernel is None:
        return remove_line(x.T).T
    count = kernel.size
    ends = np.clip(np.arange(-(count // 2), len(x) + count // 2), 0, len(x) - 1)
    smooth = convolve(x[ends].T, kernel)[..., count - 1 : ends.size].T
    return np.asarray((x - smooth) / (1 - gain))


@lru_cache(maxsize=64)
def _choose_smoothing(cycles: float, size: int) -> tuple[Array | None, float]:
    """Choose the weights of a local polynomial that leaves a sinusoid whole, and its gain; None where an arc is too short.

    They are made of orthogonal polynomials, since windows may be long.
    """

    counts = np.unique(np.round(np.array(SMOOTHING_CYCLES) / cycles).astype(np.intp) // 2 * 2 + 1)
    best, least = None, np.inf
    for count in counts[(counts > DEGREE + 2) & (counts < size)]:
        Q = np.linalg.qr(np.polynomial.legendre.legvander(np.linspace(-1, 1, count), DEGREE))[0]
        kernel = Q @ Q[count // 2]
        gain = float(kernel @ np.cos(2 * np.pi * cycles * (np.arange(count) - count // 2)))
        if abs(gain) < abs(least):
            best, least = kernel, gain
    return best, least


def _is_calm(residual: Array) -> NDArray[np.bool_]:
    """Samples in which nothing sudden is left of the motion."""
    spread = float(np.median(np.abs(residual))) / 0.6745
    return np.asarray(np.abs(residual) <= SUDDEN * spread)


def _remove_jolts(piece: Piece) -> Piece:
    return replace(piece, data=np.where(_is_calm(piece.data), piece.data, 0.0))


# ---- p-value -------------------------------------------------------------------------------------------------------------


def _compute_level(times_s: Sequence[Array], fit: SinusoidFit) -> float:
    """Noise around the sinusoid over that of all frequencies, at least one: a hump of the noise is no line.

    The median of n powers of noise is ln 2, with the error 1/√n.
    """
    powers = [np.empty(0)]
    for t_s, residual in zip(times_s, fit.residuals, strict=True):
        span_s = max(float(np.ptp(t_s)), 1e-300)
        apart = np.array([k for k in BESIDE if k < NEARBY * fit.frequency_hz * span_s]) / span_s
        beside = np.concatenate([fit.frequency_hz - apart, fit.frequency_hz + apart])
        powers.append(compute_power(t_s, residual[:, None], beside)[:, 0] / max(float(np.mean(residual**2)), 1e-300))
    found = np.concatenate(powers)
    return max(1.0, (float(np.median(found)) - 1 / np.sqrt(found.size)) / float(np.log(2))) if found.size else 1.0


def _make_waveform(fit: SinusoidFit, recording: Recording, arcs: Arcs) -> Array:
    """Make the sinusoid (n,) in each arc."""
    waveform = np.zeros(recording.gyro.t_s.size)
    for (low, high), amplitudes in zip(arcs, fit.amplitudes, strict=True):
        waveform[low:high] = make_waves(fit.frequency_hz, recording.gyro.t_s[low:high]) @ amplitudes
    return waveform
