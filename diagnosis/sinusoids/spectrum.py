"""Mean periodograms of a series that is cut into pieces, and the probability of its strongest line under noise.

The power of a piece of white noise at a frequency has an exponential distribution. The mean over n independent pieces has a
gamma distribution with the shape n. Noise that is not white has another level at each frequency: a running median estimates it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
import scipy.ndimage
import scipy.special
from numpy.typing import NDArray

Array = NDArray[np.float64]
Arcs = Sequence[tuple[int, int]]

SAMPLES_AT_ONCE = 1 << 20  # of segments that are transformed together: a bound of the memory
FREQUENCIES_AT_ONCE = 1000  # of times that are not even: a bound of the memory
SEGMENTS_TO_OVERLAP = 8  # pieces side by side from which on overlapping ones are averaged too

LEAST_POSITIVE = 1e-300
COSINES = {"hann": (0.5, 0.5), "blackmanharris": (0.35875, 0.48829, 0.14128, 0.01168)}  # shares of each in a taper


@dataclass(frozen=True)
class Spectrum:
    """Mean periodogram of some pieces."""

    frequency_hz: Array  # (f,)
    power: Array  # (f,) or (f, c) mean over the pieces; of white noise its variance
    count: Array  # (1,) or (f, 1) number of independent pieces in the mean, 0 where there is none
    amplitude_of_one: float  # amplitude of a sinusoid whose power at its own frequency is one

    def compute_level(self, width: int) -> Array:
        """Return the level of the noise around each frequency: the running median over so many frequencies."""
        size = (min(width, len(self.power)), *[1] * (self.power.ndim - 1))
        median = scipy.special.gammaincinv(np.maximum(self.count, 1), 0.5) / np.maximum(self.count, 1)
        return np.asarray(scipy.ndimage.median_filter(self.power / median, size=size, mode="nearest"))


def compute_log_p(ratio: Array | float, count: Array | float, trials: int) -> Array:
    """Return log p of powers over their level, means of so many pieces of noise, with an allowance for the trials."""
    with np.errstate(divide="ignore"):
        log_p = np.log(scipy.special.gammaincc(count, count * np.asarray(ratio)))
    return np.asarray(np.minimum(log_p + np.log(trials), 0.0))


def make_taper(window: str, length: int) -> Array:
    """Make a sum of cosines (length,) that tapers a segment (Harris, Proceedings of the IEEE 66, 1978)."""
    phase = 2 * np.pi * np.arange(length) / length
    return np.asarray(sum((-1) ** k * share * np.cos(k * phase) for k, share in enumerate(COSINES[window])))


def compute_segment_spectrum(x: Array, arcs: Arcs, length: int, sample_s: float, window: str) -> Spectrum | None:
    """Average the periodograms of all segments of so many even samples in the arcs; None where no arc is as long.

    Where segments are many, overlapping ones are averaged (Welch 1967). A straight line is taken out of each.
    """
    taper = make_taper(window, length)
    many = sum((high - low) // length for low, high in arcs) >= SEGMENTS_TO_OVERLAP
    step = (length // 2 if window == "hann" else length // 3) if many else length
    starts = [np.arange(low, high - length + 1, step) for low, high in arcs]
    places = np.concatenate(starts)
    if not places.size:
        return None
    power, some = np.zeros(length // 2 + 1), max(1, SAMPLES_AT_ONCE // length)
    for first in range(0, places.size, some):
        segments = np.array([x[start : start + length] for start in places[first : first + some]])
        power += (np.abs(scipy.fft.rfft(remove_line(segments) * taper, axis=1)) ** 2).sum(axis=0)
    power /= places.size * np.sum(taper**2)
    count = np.array([_count_independent_segments([own.size for own in starts], taper, step)])
    amplitude = float(2 * np.sqrt(np.sum(taper**2)) / np.sum(taper))
    return Spectrum(np.arange(power.size) / (length * sample_s), power, count, amplitude)


def compute_power(t_s: Array, values: Array, frequency_hz: Array) -> Array:
    """Return the (f, c) periodogram of values (n, c) at any times; one in the mean for white noise of variance one."""
    x, t = values - values.mean(axis=0), t_s - t_s.mean()
    power = np.empty((frequency_hz.size, x.shape[1]))
    for first in range(0, frequency_hz.size, FREQUENCIES_AT_ONCE):
        some = slice(first, first + FREQUENCIES_AT_ONCE)
        phase = np.outer(2 * np.pi * frequency_hz[some], t)
        power[some] = ((np.cos(phase) @ x) ** 2 + (np.sin(phase) @ x) ** 2) / len(x)
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
    """Number of independent segments that as many overlapping ones are worth (Welch 1967)."""
    n, total, shared = taper.size, float(sum(counts)), 0.0
    for j in range(1, (n - 1) // step + 1):
        alike = float(taper[: n - j * step] @ taper[j * step :] / (taper @ taper)) ** 2
        shared += 2 * alike * sum(max(count - j, 0) for count in counts) / total
    return total / (1 + shared)
