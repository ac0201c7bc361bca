"""A sinusoid in arcs of the samples: its fit beside the motion of the body, its p-value, and whether its amplitude is constant.

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
from simulator.effects.recording_view import find_interval_slices

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
# least cycles and χ² of a part in which the amplitude is compared: enough to tell it from zero
PART_CYCLES = 12.0
PART_CHI2 = 25.0
MOST_PARTS = 8  # of an arc
TOLERANCE = 0.1  # relative change of the amplitude that a constant one may have: what the background takes of it
UNDISTURBED = 0.75  # share of the parts that no motion disturbs


def fit_line(
    x: Array, recording: Recording, axis: int, centre_hz: float, width_hz: float, arcs: Arcs, isolated: bool
) -> Line | None:
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
    constancy = _compute_constancy(fit, [fit.frequency_hz * piece.data.size * sample_s for piece in pieces])
    waveform = _make_waveform(fit, recording, arcs, beside=constancy > 0)
    return Line(axis, fit.frequency_hz, size, sigma, p, waveform, isolated, constancy)


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


# ---- p-value and constancy ------------------------------------------------------------------------------------------------


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


def _compute_constancy(fit: SinusoidFit, cycles: Sequence[float]) -> float:
    """Return the log likelihood ratio of amplitudes of a vibration against those of a motion, from parts of the arcs."""
    amplitudes, variances = list[float](), list[float]()
    for k, (waves, residual) in enumerate(zip(fit.waves, fit.residuals, strict=True)):
        chi2 = float(fit.amplitudes[k] @ fit.amplitudes[k] / fit.variances[k])
        count = int(np.clip(min(cycles[k] / PART_CYCLES, chi2 / PART_CHI2), 1, MOST_PARTS))
        data = waves @ fit.amplitudes[k] + residual
        for part in np.array_split(np.arange(residual.size), count):
            amplitudes.append(float(np.hypot(*np.linalg.lstsq(waves[part], data[part], rcond=None)[0])))
            variances.append(float(fit.variances[k]) * residual.size / part.size)
    return compute_log_constancy(np.array(amplitudes), np.array(variances), fit.size[0])


def compute_log_constancy(amplitudes: Array, variances: Array, size: float) -> float:
    """Return the log likelihood ratio of a constant amplitude against a motion's, of which half are constant, too.

    A constant amplitude with noise has Rice's distribution, one that changes at random as that of a narrow band of noise has
    Rayleigh's. Some parts are disturbed by other motions even if the amplitude is constant.

    Parameters
    ----------
    amplitudes, variances : (k,) of the parts, and the variance of their cosine and sine
    size : amplitude of all parts
    """
    trial = size * np.geomspace(0.7, 1.4, 9)[:, None]
    rayleigh = _log_rice(amplitudes, 0.0, variances + 0.5 * trial**2)
    changing = rayleigh[int(np.argmax(rayleigh.sum(axis=1)))]
    rice = _log_rice(amplitudes, trial, variances + (TOLERANCE * trial) ** 2)
    known = np.logaddexp(np.log(UNDISTURBED) + rice, np.log(1 - UNDISTURBED) + changing)
    constant = float(known.sum(axis=1).max())
    return constant - float(np.logaddexp(constant, changing.sum()) - np.log(2))


def _log_rice(r: Array, amplitude: Array | float, variance: Array) -> Array:
    """Log density of the size of a vector of some amplitude with normal noise of some variance along each of two axes."""
    bessel = scipy.special.i0e(r * amplitude / variance)
    return np.asarray(np.log(np.maximum(r, 1e-300) / variance) - (r - amplitude) ** 2 / (2 * variance) + np.log(bessel))


def _make_waveform(fit: SinusoidFit, recording: Recording, arcs: Arcs, beside: bool) -> Array:
    """Make the sinusoid (n,) in each arc, and beside it by at most its length to the middle of a gap or an interval's end.

    A few samples of a strong one that stay beside the arcs turn the attitude by more than references are off.
    """
    low, high = np.array(arcs).T
    waveform, reach = np.zeros(recording.gyro.t_s.size), (high - low) * beside
    for part in find_interval_slices(recording):
        own = np.flatnonzero((low >= part.start) & (low < part.stop))
        if own.size:
            sample = np.arange(part.start, part.stop)
            arc = own[np.searchsorted((high[own][:-1] + low[own][1:] + 1) // 2, sample, side="right")]
            near = (sample >= low[arc] - reach[arc]) & (sample < high[arc] + reach[arc])
            waves = make_waves(fit.frequency_hz, recording.gyro.t_s[part])
            waveform[part] = near * np.sum(waves * fit.amplitudes[arc], axis=1)
    return waveform
