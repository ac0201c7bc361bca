"""Estimate the rates of a body without the gyro's noise from the samples alone.

Two estimates are made of each interval and axis:

- local quadratics in windows as long as the motion allows (`gyrocal.smoothing`), good for slews between rests; of a
  sway of less than four times the noise of a sample they keep nothing;
- shrunk cosine coefficients, good for a body that sways. Of white noise each orthonormal coefficient has the variance σ²; one
  of the mean square P among its neighbours is multiplied by 1 − σ²/P (Wiener), or left out where P is what noise may have.

The estimate of the smaller risk is taken, as estimated by ‖readings − estimate‖² + 2 σ² × degrees of freedom (Stein, Annals of
Statistics 9 (1981) 1135, section 3, but for a constant); these are the sum over the samples of what each contributes to its own
estimate.
"""

from __future__ import annotations

import numpy as np
import scipy.fft
from scipy.ndimage import uniform_filter1d

from gyrocal.arrays import Array
from gyrocal.recording import Recording
from gyrocal.smoothing import estimate_sample_sigma, replace_outliers, smooth_axis
from simulator.effects.recording_view import find_interval_slices

NEIGHBOURS = 17  # coefficients whose mean square is taken

# Mean squares of so many coefficients of noise alone, in σ², stay below this but for one in a thousand (χ²).
LOUDEST = 1 + 4 * float(np.sqrt(2 / NEIGHBOURS))
FEWEST_COSINE_SAMPLES = 8 * NEIGHBOURS  # samples of an interval whose motion is looked for among frequencies


def remove_noise(rates: Array, recording: Recording) -> Array:
    """Estimate the raw rates (n, 3), rad/s, without their noise, by smoothing inside each interval."""
    sigma = recording.gyro.arw / np.sqrt(recording.gyro.sample_s)
    smooth = rates.copy()
    for interval in find_interval_slices(recording):
        measured = rates[interval]
        smooth[interval] = remove_interval_noise(measured, recording.gyro.sample_s, estimate_sample_sigma(measured, sigma))
    return smooth


def remove_interval_noise(rates: Array, sample_s: float, sigma: Array) -> Array:
    """Estimate the noise-free rates (n, 3) of one interval, rad/s, evenly sampled with noise of (3,) sigmas of a sample."""
    return np.column_stack([_choose_axis_estimate(rates[:, axis], sample_s, float(level)) for axis, level in enumerate(sigma)])


def _choose_axis_estimate(rates: Array, sample_s: float, sigma: float) -> Array:
    """Choose the estimate (n,) of the motion about one axis, rad/s, that has the smaller risk."""
    read = replace_outliers(rates, sigma)
    local, local_freedom = smooth_axis(read, sample_s, np.inf, sigma)
    if rates.size < FEWEST_COSINE_SAMPLES or not sigma > 0:
        return local
    shrunk, shrunk_freedom = shrink_cosines(read, sigma)
    risk = _estimate_risk(read, shrunk, shrunk_freedom, sigma)
    return shrunk if risk < _estimate_risk(read, local, local_freedom, sigma) else local


def shrink_cosines(rates: Array, sigma: float) -> tuple[Array, float]:
    """Estimate the motion (n,) about one axis, rad/s, by its cosine coefficients; also the estimate's degrees of freedom.

    A straight line is taken out first, since a cosine series has no slope at its ends.
    """
    line = np.polynomial.Polynomial.fit(np.arange(rates.size), rates, 1)(np.arange(rates.size))
    coefficients = scipy.fft.dct(rates - line, norm="ortho") / sigma
    power = np.maximum(uniform_filter1d(coefficients**2, NEIGHBOURS, mode="mirror"), LOUDEST)
    is_signal = power > LOUDEST
    factor = np.where(is_signal, 1 - 1 / power, 0.0)
    # The factor's derivative by the coefficient, times the coefficient: the neighbours' mean square holds it, too.
    derivative = np.where(is_signal, 2 / NEIGHBOURS * coefficients**2 / power**2, 0.0)
    estimate = line + scipy.fft.idct(sigma * factor * coefficients, norm="ortho")
    return estimate, float(factor.sum() + derivative.sum()) + 2.0


def _estimate_risk(rates: Array, estimate: Array, freedom: float, sigma: float) -> float:
    return float(np.sum((rates - estimate) ** 2) + 2 * sigma**2 * freedom)
