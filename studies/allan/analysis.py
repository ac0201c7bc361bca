"""Allan deviation of a recording's noise about each axis, its confidence bands, lines, and the terms of IEEE Std 952.

Lines are found in the spectrum, as in a diagnosis, and subtracted first: the bump of a sinusoid in an Allan deviation could be
mistaken for other terms. Where the references were subtracted from the rates, their own noise is known and not a term.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from diagnosis.detectors.repeats import bridge_repeats
from diagnosis.detectors.sample_report import Line, Stream, mark_consecutive_samples
from diagnosis.detectors.spectral_lines import FEWEST_CYCLES, find_lines
from diagnosis.settings import DEFAULT
from gyrocal import Recording
from gyrocal.allan import Deviation, Fit, TermEstimate, fit_terms, overlapping_allan_deviation
from gyrocal.allan.terms import ANGLE_WHITE, FLICKER, RAMP, RANDOM_WALK, RATE_WALK, compute_sinusoid_variance
from gyrocal.arrays import Array, Mask
from gyrocal.calibration.parameters import AXIS_NAMES
from gyrocal.masking import mark_interval_samples
from simulator.streams import generator
from studies.allan.rates import Stretch, find_stretches

BAND_CONFIDENCE = 0.95
REFERENCE_ERROR_DRAWS = 32  # of the references' errors
DEG, HOUR = float(np.rad2deg(1.0)), 3600.0
COEFFICIENT_UNITS = {  # unit shown of a coefficient, and the factor to it from radians and seconds
    ANGLE_WHITE: ("arcsec", DEG * 3600),
    RANDOM_WALK: ("deg/√h", DEG * np.sqrt(HOUR)),
    FLICKER: ("deg/h", DEG * HOUR),
    RATE_WALK: ("deg/h/√h", DEG * HOUR * np.sqrt(HOUR)),
    RAMP: ("deg/h/h", DEG * HOUR * HOUR),
}
RATE_UNIT, RATE = "deg/h", DEG * HOUR


@dataclass(frozen=True)
class AxisNoise:
    """Noise of one axis, in radians and seconds."""

    deviation: Deviation  # with the lines in it
    low: Array  # low, high: (t,) confidence limits of the deviation
    high: Array
    model: Array  # (t,) Allan variance of the terms, the lines and the references
    references: Array  # (t,) that of the references' errors alone
    fit: Fit  # the terms
    lines: tuple[Line, ...]  # sinusoids, each with its amplitude and sigma in rad/s


@dataclass(frozen=True)
class NoiseAnalysis:
    """Noise of a recording, about each axis by itself."""

    recording: str  # title
    arw: float  # stated angle random walk, rad/√s
    stretches: tuple[Stretch, ...]  # used samples
    axes: tuple[AxisNoise, ...]  # x, y and z
    notes: tuple[str, ...]  # limits of the analysis

    @property
    def longest_period_s(self) -> float:
        """Period up to which lines are looked for, s."""
        return max(stretch.edges[-1] - stretch.edges[0] for stretch in self.stretches) / FEWEST_CYCLES

    def to_json(self) -> dict[str, Any]:
        """Return everything as numbers with their units."""
        unit, factor = COEFFICIENT_UNITS[RANDOM_WALK]
        return {
            "recording": self.recording,
            "stated_angle_random_walk": {"value": self.arw * factor, "unit": unit},
            "confidence": BAND_CONFIDENCE,
            "stretches": [describe_stretch(stretch) for stretch in self.stretches],
            "longest_period_of_lines_s": self.longest_period_s,
            "axes": {axis: _describe_axis(noise) for axis, noise in zip(AXIS_NAMES, self.axes, strict=True)},
            "notes": list(self.notes),
        }


def estimate_noise_terms(recording: Recording, interval: str | None = None) -> NoiseAnalysis:
    """Estimate Allan deviation and noise terms of a recording, or of one of its intervals.

    Raises `InputError` if there is no such interval, or no stretch of samples shows the gyro's noise.
    """
    is_measured, repeat_notes = mark_measured_samples(recording)
    parts, notes = find_stretches(recording, interval)
    lines, clean = _subtract_lines(recording, parts)
    measured = [is_measured[part.samples] for part in parts]
    sample_s = recording.gyro.sample_s
    axes = tuple(_estimate_axis_noise(sample_s, parts, k, clean, lines[k], measured) for k in range(3))
    return NoiseAnalysis(recording.title, recording.gyro.arw, parts, axes, (*repeat_notes, *notes))


def _estimate_axis_noise(
    sample_s: float, parts: tuple[Stretch, ...], axis: int, clean: list[Array], lines: tuple[Line, ...], measured: list[Mask]
) -> AxisNoise:
    """Fit the terms of one axis to the samples of each stretch that were measured."""

    def compute_deviation(rates: Iterable[Array]) -> Deviation:
        measured_rates = [part_rates[mask, axis] for part_rates, mask in zip(rates, measured, strict=True)]
        return overlapping_allan_deviation([x for x in measured_rates if x.size], sample_s)

    deviation = compute_deviation(part.rates for part in parts)
    # Rates from which references were subtracted hold the references' errors: the mean Allan variance of drawn ones.
    draws = REFERENCE_ERROR_DRAWS if any(not part.rest for part in parts) else 1
    generators = [generator(0, case, "allan references") for case in range(draws)]
    reference_variances = [compute_deviation(part.draw_reference_rates(rng) for part in parts).variance for rng in generators]
    floor = np.asarray(np.mean(reference_variances, axis=0))
    fit = fit_terms(compute_deviation(clean), floor)
    low, high = deviation.band(fit.degrees, BAND_CONFIDENCE)
    tones = (compute_sinusoid_variance(line.amplitude, line.frequency_hz, deviation.tau_s) for line in lines)
    return AxisNoise(deviation, low, high, sum(tones, fit.model), floor, fit, lines)


def _subtract_lines(recording: Recording, parts: tuple[Stretch, ...]) -> tuple[list[tuple[Line, ...]], list[Array]]:
    """Find the lines of each axis, and subtract them from the rates of each stretch."""
    rates, used = recording.gyro.rates.copy(), np.zeros(recording.gyro.t_s.size, dtype=bool)
    for part in parts:
        used[part.samples] = True
        rates[part.samples] = part.rates
    stream = Stream(recording, rates, np.zeros_like(rates), np.zeros_like(used), used)
    lines, _ = find_lines(stream, used, np.zeros(3, dtype=bool), DEFAULT.line)
    waves = np.zeros_like(rates)
    for line in lines:
        waves[:, line.axis] += line.waveform
    by_axis = [tuple(line for line in lines if line.axis == axis) for axis in range(3)]
    return by_axis, [part.rates - waves[part.samples] for part in parts]


def mark_measured_samples(recording: Recording) -> tuple[Mask, list[str]]:
    """Mark the samples (n,) that do not repeat the one before, by the test of a diagnosis; with a note on those that do."""
    used, rates = mark_interval_samples(recording), recording.gyro.rates
    findings, bridged = bridge_repeats(
        Stream(recording, rates, np.zeros_like(rates), np.zeros_like(used), used), DEFAULT.sample_event
    )
    repeated = bridged.filled
    if not (findings.symptoms and repeated.any()):
        return np.ones_like(used), []
    if findings.tests[0].expected == 0:  # no repeat is due to chance, not even at the largest reading
        follows = mark_consecutive_samples(recording, used)
        repeated = repeated | (follows & np.append(False, (rates[1:] == rates[:-1]).all(axis=1)))
    new = 1 - float(repeated[used].mean())  # share of samples that repeat no other
    note = (
        f"{int(repeated.sum())} of {int(used.sum())} samples repeat the one before on all axes and are left out, as lost ones. "
        f"If the gyro itself measures at {new:.3g} of the rate, its angle random walk is {1 / np.sqrt(new):.4g} "
        f"times the one here, and averaging times are {1 / new:.4g} times longer"
    )
    return ~repeated, [note]


def describe_stretch(stretch: Stretch) -> dict[str, Any]:
    """Describe a stretch in a few words and numbers."""
    return {
        "interval": stretch.interval,
        "start_s": float(stretch.edges[0]),
        "stop_s": float(stretch.edges[-1]),
        "samples": len(stretch.rates),
        "rates": "rest, raw" if stretch.rest else "residual",
        "references": stretch.references,
        "p_constant_rate": stretch.p_value,
    }


def convert_to_display_unit(estimate: TermEstimate) -> TermEstimate:
    """Convert an estimate to the unit shown."""
    factor = COEFFICIENT_UNITS[estimate.term][1]
    return replace(estimate, value=estimate.value * factor, sigma=estimate.sigma * factor)


def _describe_axis(axis: AxisNoise) -> dict[str, Any]:
    """Return the noise of an axis as numbers with their units."""
    terms = {
        estimate.term: {
            "seen": estimate.seen,
            "unit": COEFFICIENT_UNITS[estimate.term][0],
            "value": estimate.value,
            "sigma": estimate.sigma,
        }
        for estimate in map(convert_to_display_unit, axis.fit.estimates)
    }
    lines = [
        {"frequency_hz": line.frequency_hz, "amplitude": line.amplitude * RATE, "sigma": line.sigma * RATE, "unit": RATE_UNIT}
        for line in axis.lines
    ]
    return {
        "tau_s": axis.deviation.tau_s,
        "deviation_deg_h": axis.deviation.deviation * RATE,
        "low_deg_h": axis.low * RATE,
        "high_deg_h": axis.high * RATE,
        "model_deg_h": np.sqrt(axis.model) * RATE,
        "references_deg_h": np.sqrt(axis.references) * RATE,
        "equivalent_degrees_of_freedom": axis.fit.degrees,
        "terms": terms,
        "sinusoids": lines,
        "chi2": axis.fit.chi2,
        "dof": axis.fit.dof,
        "as_well": [list(terms) for terms in axis.fit.alternatives],
    }
