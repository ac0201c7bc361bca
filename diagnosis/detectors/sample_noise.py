"""Estimate the noise of a sample of each gyro, and find the symptoms where it is not white noise as stated.

`measure_noise` compares the fit of each gyro's spectrum (`diagnosis.detectors.noise_spectrum`) with the stated noise. If the
noise of all three gyros is too large by one factor, it is of one kind, and the log odds of readout against white noise are
added over the gyros. An excess in one band of the spectrum is no noise, but a body that shakes with its wheels or its
appendages. `estimate_local_noise` and `find_quiet_samples` give the tests for outliers and lines a robust level and the samples
at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb

import numpy as np
import scipy.ndimage
import scipy.special
from scipy.special import expit, logit

from diagnosis.arrays import AXES
from diagnosis.detectors.noise_spectrum import (
    HIDDEN_TONE_FREQUENCY,
    ORDER,
    UNDECIDED,
    Readout,
    compute_broadband_share,
    fit_noise_spectrum,
)
from diagnosis.detectors.number_format import Lattices
from diagnosis.detectors.sample_report import IMPOSSIBLE, Findings, Line, SampleTest, Stream, Symptom
from gyrocal.arrays import Array, Mask

HALF = 20  # samples on either side of one in the test for quiet
# sigmas of the change of the mean that count as visible; a slew's are hundreds, those of a vibration a few
MOVING = 20.0
FEWEST = 200  # differences, below which those of samples that were not measured count as well
# variance of the samples in squares of a lattice's step, below which it may be that of a few readings
RESOLVED = 0.34
# noise sigmas in a step, up to which rounding adds uniform noise, to 1e-3 of the variance (Widrow, 1956)
DITHERED = 1.5
SLACK = 0.1  # departure of the noise factor that rounding to a few sigmas makes by itself
# share of too much power beside any one band of the spectrum, from which on it is noise of another level
ELSEWHERE = 0.3
LEAST_ERROR = 0.01  # of a noise factor that is compared with others
ONE_FACTOR = 14.0  # χ² of three noise factors with one mean, below which they are one: a chance of 1e-3
OFF_ZERO = 5.0  # sigmas from zero, from which on cutting toward zero is rounding down
POSSIBLE = 0.02  # probability from which on the other kind of noise is an alternative


@dataclass(frozen=True)
class NoiseFactor:
    """Noise of one gyro beside what is stated."""

    value: float  # value, sigma: actual over stated noise of a sample
    sigma: float
    p_value: float  # under noise as stated
    readout: Readout | None  # readout noise, if that explains an excess
    log_odds: float  # of readout noise against white noise


def estimate_local_noise(rates: Array, sigma: float, coarse: Mask, steps: Array, filled: Mask) -> Array:
    """Estimate the noise (3,) of a sample robustly from those that were measured, where enough were."""
    if len(rates) <= ORDER:
        return np.full(3, sigma)
    measured = ~scipy.ndimage.binary_dilation(filled, iterations=ORDER // 2)[ORDER // 2 : filled.size - ORDER // 2]
    if measured.sum() < FEWEST:
        measured[:] = True
    # The differences of white noise have C(2d, d) times its variance.
    scale = 0.6745 * np.sqrt(comb(2 * ORDER, ORDER))
    robust = np.array([np.median(np.abs(np.diff(x, ORDER)[measured])) for x in rates.T]) / scale
    floor = np.where(coarse, np.sqrt(sigma**2 + steps**2 / 12), 0.0)
    return np.asarray(np.maximum(np.where(robust > 0, robust, sigma), floor))


def find_quiet_samples(rates: Array, noise: Array) -> Mask:
    """Find the samples around which the mean rate does not visibly change on any axis."""
    half, moving = HALF, np.zeros(len(rates), dtype=bool)
    for axis, level in enumerate(noise):
        ahead = scipy.ndimage.uniform_filter1d(rates[:, axis], half, origin=-half // 2, mode="nearest")
        behind = scipy.ndimage.uniform_filter1d(rates[:, axis], half, origin=half // 2 - 1, mode="nearest")
        moving |= np.abs(ahead - behind) / (level * np.sqrt(2 / half)) > MOVING
    return ~scipy.ndimage.binary_dilation(moving, iterations=half)


def measure_noise(stream: Stream, lattices: Lattices, lines: Sequence[Line], event_p: float) -> tuple[Findings, Array, Array]:
    """Measure the noise of each axis of a stream, beside the lines of the spectrum.

    Returns findings, and actual over stated noise of a sample and of the density that integrates to the attitude, (3,) each.
    """
    measured = stream.used & ~scipy.ndimage.binary_dilation(stream.filled, iterations=2)
    factors: dict[int, NoiseFactor] = {}
    for axis in range(3):
        noise = _measure_axis(stream, axis, measured, lattices, [line for line in lines if line.axis == axis], event_p)
        if noise is not None:
            factors[axis] = noise
    tests = tuple(
        SampleTest(
            "noise_level", AXES[axis], noise.value, 1.0, noise.p_value, "white_noise_level",
            f"the noise of the samples is {noise.value:.3f} times what is stated",
        )
        for axis, noise in factors.items()
    )  # fmt: skip
    departing = {axis: noise for axis, noise in factors.items() if noise.p_value < event_p}
    symptoms, density = _build_symptoms(stream, departing, event_p)
    factor = np.array([departing[axis].value if axis in departing else 1.0 for axis in range(3)])
    return Findings(tests, tuple(symptoms)), factor, density


def _measure_axis(
    stream: Stream, axis: int, measured: Mask, lattices: Lattices, lines: Sequence[Line], event_p: float
) -> NoiseFactor | None:
    """Measure the noise of one axis; None where its readings do not show the level."""
    sigma, step, coarse = stream.sigma, float(lattices.steps[axis]), bool(lattices.coarse[axis])
    expected = sigma**2 + (step**2 / 12 if coarse else 0.0)
    x, is_usable = _remove_lines(stream, axis, measured, lines)
    if lattices.may_bias[axis]:
        is_usable = is_usable & _is_off_zero(x, step, sigma)
    gyro = stream.recording.gyro
    degrees = gyro.arw_degrees if gyro.arw_estimated and gyro.arw_degrees > 0 else np.inf
    level = fit_noise_spectrum(x, stream.find_arcs(is_usable), expected, degrees)
    if level is None or (coarse and level.variance < RESOLVED * step**2):
        return None
    factor = float(np.sqrt(max(1 + (level.variance - expected) / sigma**2, 1e-6)))
    p, is_rough = max(level.p_value, IMPOSSIBLE), coarse and step > DITHERED * sigma
    is_one_band = p < event_p and factor > 1 and compute_broadband_share(level.powers, expected) < ELSEWHERE
    # Rounding to a few noise sigmas is not uniform noise.
    if is_one_band or (is_rough and abs(factor - 1) < SLACK):
        p = 1.0
    readout = level.readout if factor > 1 and not is_rough else None
    bound = 0.5 * UNDECIDED
    log_odds = -bound if readout is None else max(float(logit(readout.probability)), -bound)
    return NoiseFactor(factor, 0.5 * level.sigma / sigma**2 / factor, p, readout, log_odds)


def _remove_lines(stream: Stream, axis: int, measured: Mask, lines: Sequence[Line]) -> tuple[Array, Mask]:
    """Remove lines from the readings of one axis (n,), rad/s; also mark the samples (n,) in which no line remains."""
    x, is_usable = stream.rates[:, axis].copy(), measured
    for line in lines:
        x -= line.waveform
        # A line that is this fast is in the blocks of the spectrum, where it could not be removed.
        if line.frequency_hz * stream.recording.gyro.sample_s > HIDDEN_TONE_FREQUENCY:
            is_usable = is_usable & (line.waveform != 0.0)
    return x, is_usable


def _is_off_zero(x: Array, step: float, sigma: float) -> Mask:
    """Mark the samples (n,) around which all readings are far from zero, where cutting toward zero is rounding down."""
    middle = scipy.ndimage.uniform_filter1d(x, HALF, mode="nearest")
    is_near_zero = np.abs(middle) < OFF_ZERO * sigma + 2 * step
    return np.asarray(~scipy.ndimage.binary_dilation(is_near_zero, iterations=HALF))


def _build_symptoms(stream: Stream, departing: dict[int, NoiseFactor], event_p: float) -> tuple[list[Symptom], Array]:
    """Build the symptoms of noise that is not as stated, white or readout noise; also the factors (3,) of the noise density."""
    density = np.ones(3)
    factors = list(departing.values())
    log_odds = {axis: factor.log_odds for axis, factor in departing.items()}
    if len(departing) == 3 and all(factor.value > 1 for factor in factors) and _has_one_factor(factors):
        log_odds = dict.fromkeys(departing, float(sum(factor.log_odds for factor in factors)))
    symptoms, white = list[Symptom](), list[int]()
    for axis, factor in departing.items():
        if factor.readout is not None and log_odds[axis] > 0:
            probability = float(expit(log_odds[axis]))
            described, density[axis] = _describe_readout(stream, axis, factor, factor.readout, probability, event_p)
            symptoms += described
        else:
            white.append(axis)
            density[axis] = factor.value**2
    common = len(white) == 3 and _has_one_factor([departing[axis] for axis in white])
    for name, axes in [(None, white)] if common else [(AXES[axis], [axis]) for axis in white]:
        size = float(np.mean([departing[axis].value for axis in axes]))
        error = float(np.sqrt(np.mean([departing[axis].sigma ** 2 for axis in axes]) / len(axes)))
        readout = float(expit(log_odds[axes[0]]))
        rivals = (("readout_noise", readout),) if readout > POSSIBLE else ()
        p = min(departing[axis].p_value for axis in axes)
        symptoms.append(Symptom("white_noise_level", name, size, "factor", error, {}, p, rivals=rivals))
    return symptoms, density


def _has_one_factor(factors: Sequence[NoiseFactor]) -> bool:
    """Check whether the noise factors of some gyros are equal within their errors."""
    values, errors = np.array([factor.value for factor in factors]), np.array([factor.sigma for factor in factors])
    departures = (values - np.average(values, weights=1 / errors**2)) / np.maximum(errors, LEAST_ERROR)
    return float(departures @ departures) < ONE_FACTOR


def _describe_readout(
    stream: Stream, axis: int, factor: NoiseFactor, readout: Readout, probability: float, event_p: float
) -> tuple[list[Symptom], float]:
    """Build the symptoms of readout noise, which adds no noise to the angle, and of white noise; also the density factor."""
    sample_s, sigma = stream.recording.gyro.sample_s, stream.sigma
    size, error = (float(np.rad2deg(value) * 3600 * sample_s) for value in (readout.reading, readout.sigma))
    text = f"the noise of the samples rises with the frequency as that of readings of the angle of {size:.3g} arcsec"
    rivals = (("white_noise_level", 1 - probability),) if readout.is_as_stated and 1 - probability > POSSIBLE else ()
    symptoms = [Symptom("readout_noise", AXES[axis], size, "arcsec", error, {}, factor.p_value, text, rivals=rivals)]
    if readout.is_as_stated:
        return symptoms, 1.0
    white = float(np.sqrt(readout.white)) / sigma
    error = 0.5 * readout.white_sigma / sigma**2 / white
    p = max(float(2 * scipy.special.ndtr(-abs(white - 1) / error)), IMPOSSIBLE)
    if p < event_p:
        text = f"beside readout noise, the white noise of the samples is {white:.3f} times what is stated"
        symptoms.append(Symptom("white_noise_level", AXES[axis], white, "factor", error, {}, p, text))
    return symptoms, white**2
