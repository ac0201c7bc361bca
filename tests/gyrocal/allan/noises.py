"""Noise of each kind with coefficients that are known, made without the code under test."""

import numpy as np
import scipy.signal

SAMPLE_S = 0.5


def angle_white(rng, n, size):
    """Rates whose angle has white noise of that standard deviation."""
    return size * np.diff(rng.standard_normal(n + 1)) / SAMPLE_S


def random_walk(rng, n, size):
    """White rates."""
    return size / np.sqrt(SAMPLE_S) * rng.standard_normal(n)


def rate_walk(rng, n, size):
    """A walk of the rate; the mean of a walk over a sample is as good as its value once an average has many."""
    return size * np.sqrt(SAMPLE_S) * np.cumsum(rng.standard_normal(n))


def flicker(rng, n, size):
    """Bias instability by the spectrum: white noise through the fractional integral of order 1/2 (Kasdin 1995)."""
    length = 4 * n
    ratio = (np.arange(1, length) - 0.5) / np.arange(1, length)
    response = np.concatenate([[1.0], np.cumprod(ratio)])
    # Its two-sided spectrum at low frequencies is 1/(2π f) whatever the sampling, times the variance of the white noise.
    return size * scipy.signal.fftconvolve(response, rng.standard_normal(length))[3 * n : length]


def ramp(n, slope):
    """A drift."""
    return slope * SAMPLE_S * np.arange(n)
