"""Sinusoids in data that are cut into intervals: their spectrum, their fit, and one phase through all intervals.

**Spectrum.** The power of a piece of white noise at a frequency has an exponential distribution. The mean over n independent
pieces has a gamma distribution with the shape n. Noise that is not white has another level at each frequency: a running median
estimates it.

**Fit.** Each piece of the data has a phase and an amplitude of its own. One piece for all data means one phase for all. The
frequency is common: Gauss and Newton's method finds it, with amplitudes and phases eliminated at each step (Golub and Pereyra
1973).

**Coherence.** χ² and evidence of one phase over several intervals follow at many frequencies from a few numbers for each
interval. In an interval with the middle c_i, of the length D, a wave of the frequency f near f_j is

    exp(2πi f t) ≈ exp(2πi f c_i) a_ij(t),    a_ij(t) = exp(2πi f_j (t − c_i)),

which with |f − f_j| ≤ 1/(32D) loses at most 0.3 % of χ². Columns C turn waves into observations y. The nuisance parameters are
those of single intervals, which C is free of, and a few directions Q common to all. The products of
v = Σ_i exp(2πi f c_i) C a_ij, whose real and imaginary part are the columns of cosine and sine, are then

    vᵀy = Σ_i e_i z_i,    vᴴPv = Σ_i h_i − |Σ_i e_i g_i|²,    vᵀPv = Σ_i e_i² s_i − Σ (Σ_i e_i g_i)²,

P the projection, e_i = exp(2πi f c_i), and z, g, h, s those of a_ij in its interval.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
import scipy.ndimage
import scipy.special
from numpy.typing import NDArray

from diagnosis.arrays import LEAST_POSITIVE
from gyrocal.arrays import Array, Indices, Mask

Arcs = Sequence[tuple[int, int]]

SAMPLES_AT_ONCE = 1 << 20  # of segments that are transformed together: a bound of the memory
FREQUENCIES_AT_ONCE = 1000  # of times that are not even: a bound of the memory
SEGMENTS_TO_OVERLAP = 8  # pieces side by side from which on overlapping ones are averaged too

COSINES = {"hann": (0.5, 0.5), "blackmanharris": (0.35875, 0.48829, 0.14128, 0.01168)}  # shares of each in a taper


STEPS = 3  # of Gauss and Newton: from a tenth of the resolution the error falls below a thousandth of its sigma
ZOOM_STEP = 0.1  # between trial frequencies, in units of the resolution of the longest piece
NO_NOISE = 1e-60  # variance where the data leave nothing beside a sinusoid

Complex = NDArray[np.complex128]

# signal-to-noise ratios of the amplitudes by which frequencies are compared
SCALES = (3.0, 10.0, 30.0, 100.0, 300.0)


@dataclass(frozen=True)
class Spectrum:
    """Mean periodogram of some pieces."""

    frequency_hz: Array  # (f,)
    power: Array  # (f,) or (f, c) mean over the pieces; of white noise its variance
    count: Array  # (1,) or (f, 1) number of independent pieces in the mean, 0 where there is none
    amplitude_of_one: float  # amplitude of a sinusoid whose power at its own frequency is one

    def compute_level(self, width: int) -> Array:
        """Estimate the level of the noise around each frequency by the running median over `width` frequencies."""
        size = (min(width, len(self.power)), *[1] * (self.power.ndim - 1))
        median = scipy.special.gammaincinv(np.maximum(self.count, 1), 0.5) / np.maximum(self.count, 1)
        return np.asarray(scipy.ndimage.median_filter(self.power / median, size=size, mode="nearest"))


def compute_log_p(ratio: Array | float, count: Array | float, trials: int) -> Array:
    """Compute log p of powers over their level, means of `count` pieces of noise, with an allowance for the trials."""
    with np.errstate(divide="ignore"):
        log_p = np.log(scipy.special.gammaincc(count, count * np.asarray(ratio)))
    return np.asarray(np.minimum(log_p + np.log(trials), 0.0))


def make_taper(window: str, length: int) -> Array:
    """Make a sum of cosines (length,) that tapers a segment (Harris, Proceedings of the IEEE 66, 1978)."""
    phase = 2 * np.pi * np.arange(length) / length
    return np.asarray(sum((-1) ** k * share * np.cos(k * phase) for k, share in enumerate(COSINES[window])))


def compute_segment_spectrum(x: Array, arcs: Arcs, length: int, sample_s: float, window: str) -> Spectrum | None:
    """Average the periodograms of all segments of `length` even samples in the arcs; None where no arc is as long.

    Of many segments, overlapping ones are averaged (Welch 1967). A straight line is subtracted from each.
    """
    taper = make_taper(window, length)
    many = sum((high - low) // length for low, high in arcs) >= SEGMENTS_TO_OVERLAP
    step = (length // 2 if window == "hann" else length // 3) if many else length
    starts = [np.arange(low, high - length + 1, step) for low, high in arcs]
    places = np.concatenate(starts)
    if not places.size:
        return None
    power, batch_size = np.zeros(length // 2 + 1), max(1, SAMPLES_AT_ONCE // length)
    for first in range(0, places.size, batch_size):
        segments = np.array([x[start : start + length] for start in places[first : first + batch_size]])
        power += (np.abs(scipy.fft.rfft(remove_line(segments) * taper, axis=1)) ** 2).sum(axis=0)
    power /= places.size * np.sum(taper**2)
    count = np.array([_count_independent_segments([segment_starts.size for segment_starts in starts], taper, step)])
    amplitude = float(2 * np.sqrt(np.sum(taper**2)) / np.sum(taper))
    return Spectrum(np.arange(power.size) / (length * sample_s), power, count, amplitude)


def compute_power(t_s: Array, values: Array, frequency_hz: Array) -> Array:
    """Return the (f, c) periodogram of values (n, c) at any times; one in the mean for white noise of variance one."""
    x, t = values - values.mean(axis=0), t_s - t_s.mean()
    power = np.empty((frequency_hz.size, x.shape[1]))
    for first in range(0, frequency_hz.size, FREQUENCIES_AT_ONCE):
        batch = slice(first, first + FREQUENCIES_AT_ONCE)
        phase = np.outer(2 * np.pi * frequency_hz[batch], t)
        power[batch] = ((np.cos(phase) @ x) ** 2 + (np.sin(phase) @ x) ** 2) / len(x)
    return power


def remove_line(series: Array) -> Array:
    """Remove from series (…, n) the straight line that fits each best; scipy's ``detrend`` takes longer than all spectra."""
    t = np.arange(series.shape[-1]) - 0.5 * (series.shape[-1] - 1)
    slope = series @ t / max(float(t @ t), LEAST_POSITIVE)
    return np.asarray(series - series.mean(axis=-1, keepdims=True) - slope[..., None] * t)


def convolve(series: NDArray[Any], kernel: NDArray[Any]) -> NDArray[Any]:
    """Convolve series (…, n) with a kernel (k,), both real or complex, by a Fourier transform: (…, ≥ n + k − 1).

    The functions of scipy.signal take half a second and 50 megabytes to load.
    """
    size = scipy.fft.next_fast_len(series.shape[-1] + kernel.size - 1)
    if np.iscomplexobj(series):
        return np.asarray(scipy.fft.ifft(scipy.fft.fft(series, size) * scipy.fft.fft(kernel, size)))
    return np.asarray(scipy.fft.irfft(scipy.fft.rfft(series, size) * scipy.fft.rfft(kernel, size), size))


def _count_independent_segments(counts: Sequence[int], taper: Array, step: int) -> float:
    """Compute the number of independent segments that overlapping ones are worth (Welch 1967)."""
    n, total, correlated = taper.size, float(sum(counts)), 0.0
    for j in range(1, (n - 1) // step + 1):
        correlation = float(taper[: n - j * step] @ taper[j * step :] / (taper @ taper)) ** 2
        correlated += 2 * correlation * sum(max(count - j, 0) for count in counts) / total
    return total / (1 + correlated)


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
    residuals: tuple[Array, ...]  # (N,) of each piece, the data without the sinusoid

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
    """Compute sine and cosine (n, 2 f) of each frequency at times (n,), or their means over a duration."""
    frequencies = np.atleast_1d(frequency_hz)
    angle = 2 * np.pi * np.outer(t_s, frequencies)
    waves = np.stack([np.sin(angle), np.cos(angle)], axis=2)
    if np.any(duration_s):
        waves *= np.sinc(np.outer(np.broadcast_to(duration_s, t_s.shape), frequencies))[:, :, None]
    return waves.reshape(t_s.size, -1)


def fit_sinusoid(pieces: Sequence[Piece], frequency_hz: float, reach_hz: float, steps: int = STEPS) -> SinusoidFit:
    """Fit a sinusoid near a frequency, at most `reach_hz` from it."""
    fitted_hz, sigma_hz = frequency_hz, 0.0
    for _ in range(steps):
        step, sigma_hz = _compute_step(pieces, fitted_hz)
        fitted_hz = float(np.clip(fitted_hz + step, frequency_hz - reach_hz, frequency_hz + reach_hz))
    amplitudes, variances, residuals = [], [], []
    for piece in pieces:
        waves = piece.observe(make_waves(fitted_hz, piece.t_s))
        amplitude, variance, residual = _solve(waves, piece.data)
        amplitudes.append(amplitude)
        variances.append(2 * variance / max(float(np.sum(waves**2)), NO_NOISE))
        residuals.append(residual)
    return SinusoidFit(fitted_hz, sigma_hz, np.array(amplitudes), np.array(variances), tuple(residuals))


def _solve(waves: Array, data: Array) -> tuple[Array, float, Array]:
    """Solve for the amplitudes (2,), the variance of the residuals, and these."""
    amplitude = np.linalg.lstsq(waves, data, rcond=None)[0]
    residual = data - waves @ amplitude
    return np.asarray(amplitude), max(float(np.mean(residual**2)), NO_NOISE), np.asarray(residual)


def _compute_step(pieces: Sequence[Piece], frequency_hz: float) -> tuple[float, float]:
    """Compute the Gauss–Newton step of the frequency and its sigma, Hz."""
    top, bottom = 0.0, 0.0
    for piece in pieces:
        plain = make_waves(frequency_hz, piece.t_s)
        waves = piece.observe(plain)
        (s, c), variance, residual = _solve(waves, piece.data)
        elapsed = piece.t_s - piece.t_s.mean()
        derivative = piece.observe((2 * np.pi * elapsed * (plain @ np.array([-c, s])))[:, None])[:, 0]
        slope = derivative - waves @ np.linalg.lstsq(waves, derivative, rcond=None)[0]
        top, bottom = top + float(slope @ residual) / variance, bottom + float(slope @ slope) / variance
    return (top / bottom, 1 / float(np.sqrt(bottom))) if bottom > 0 else (0.0, 0.0)


def find_frequency(pieces: Sequence[Piece], centre_hz: float, width_hz: float, sample_s: float) -> float:
    """Find the frequency near a peak, Hz, whose sinusoid with a phase in each piece explains most of even samples."""
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


@dataclass(frozen=True)
class IntervalProducts:
    """Products of waves at some frequencies f_j in each of n intervals, see the module."""

    middle_s: Array  # (n,) c_i
    zg: Complex  # (j, n, 1 + q) z and g
    h: Array  # (j,) Σ_i h_i
    s: Complex  # (j, n, 1)

    def compute_log_evidence(self, frequency: Array, nearest: Indices | slice = slice(None)) -> Array:
        """Compute the log evidence (j, m) of waves of frequencies (j, m), Hz, of any phase, at the best of some sizes.

        `nearest` holds the index j of the frequency f_j that each row is near to.
        """
        e = np.exp(2j * np.pi * frequency[:, :, None] * self.middle_s)
        sums = np.matmul(e, self.zg[nearest])
        z, g = sums[..., 0], sums[..., 1:]
        around = self.h[nearest][:, None] - np.sum(np.abs(g) ** 2, axis=2)
        along = np.matmul(e * e, self.s[nearest])[..., 0] - np.sum(g * g, axis=2)
        pp, qq, pq = 0.5 * (around + along.real), 0.5 * (around - along.real), 0.5 * along.imag
        mean = np.maximum(0.5 * around, 1e-300)
        best = np.full(frequency.shape, -np.inf)
        for scale in SCALES:
            v = scale**2 / mean
            det = np.maximum((1 + v * pp) * (1 + v * qq) - (v * pq) ** 2, 1.0)
            quadratic = (1 + v * qq) * z.real**2 - 2 * v * pq * z.real * z.imag + (1 + v * pp) * z.imag**2
            best = np.maximum(best, 0.5 * v * quadratic / det - 0.5 * np.log(det))
        return best


def find_tops(score: Array, most: int) -> Indices:
    """Find the indices of the `most` highest local maxima of scores (m,), the highest first."""
    sides = np.pad(score, 1, constant_values=-np.inf)
    tops = np.flatnonzero((score > sides[:-2]) & (score >= sides[2:]))
    return np.asarray(tops[np.argsort(-score[tops])][:most])
