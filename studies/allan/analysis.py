"""Allan deviation of a recording's noise about each axis, its confidence bands, lines, and the terms of IEEE Std 952.

Lines are taken out first, found in the spectrum as those of a diagnosis are, since a sinusoid is a bump of an Allan deviation
that other terms could pass for. What the references add where they were taken out of the rates is known, and no term.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from diagnosis.detectors.sample_report import Line, Stream
from diagnosis.detectors.spectral_lines import FEWEST_CYCLES, find_lines
from diagnosis.settings import DEFAULT
from gyrocal import Recording
from gyrocal.allan import Deviation, Fit, TermEstimate, fit_terms, overlapping_allan_deviation
from gyrocal.allan.terms import ANGLE_WHITE, FLICKER, MARKOV, RAMP, RANDOM_WALK, RATE_WALK, compute_sinusoid_variance
from gyrocal.arrays import Array, Mask
from gyrocal.calibration.parameters import AXIS_NAMES
from simulator.streams import generator
from studies.allan.rates import Stretch, find_stretches
from studies.allan.repeated_samples import select_measured_samples

BOUND_CONFIDENCE = 0.95
REFERENCE_ERROR_DRAWS = 32  # of the references' errors
BINS = 256
FEWEST_BINS = 16
STEP_CHI2_MARGIN = 50.0  # by how much the two levels' χ² is below that of the line, of noise that the levels leave
WHITE_VARIANCE_RATIO = 1.7  # mean square change from bin to bin over the variance, at least; 2 for white noise
DEG, HOUR = float(np.rad2deg(1.0)), 3600.0
COEFFICIENT_UNITS = {  # of a coefficient: from radians and seconds to the unit shown
    ANGLE_WHITE: ("arcsec", DEG * 3600),
    RANDOM_WALK: ("deg/√h", DEG * np.sqrt(HOUR)),
    FLICKER: ("deg/h", DEG * HOUR),
    RATE_WALK: ("deg/h/√h", DEG * HOUR * np.sqrt(HOUR)),
    MARKOV: ("deg/h", DEG * HOUR),
    RAMP: ("deg/h/h", DEG * HOUR * HOUR),
}
RATE_UNIT, RATE = "deg/h", DEG * HOUR


@dataclass(frozen=True)
class RateStep:
    """A step of the rate."""

    at: int  # sample from which on the rate is another
    size: float  # rad/s


@dataclass(frozen=True)
class LineSearch:
    """Lines of one axis."""

    found: tuple[Line, ...]  # the lines, each with its amplitude and sigma in rad/s
    upper: float  # amplitude that a line hidden in the spectrum may have at most, rad/s; 95 %
    longest_s: float  # period up to which lines are looked for


@dataclass(frozen=True)
class AxisNoise:
    """Noise of one axis, in radians and seconds."""

    deviation: Deviation  # with the lines in it
    low: Array  # low, high: (t,) confidence limits of the deviation
    high: Array
    model: Array  # (t,) Allan variance of the terms, the lines and the references
    references: Array  # (t,) that of the references' errors alone
    fit: Fit  # the terms
    sinusoid: LineSearch  # the lines
    steps: tuple[tuple[int, RateStep], ...]  # of the rate inside stretches, each with the stretch's place among all


@dataclass(frozen=True)
class NoiseAnalysis:
    """Noise of a recording, about each axis by itself."""

    recording: str  # title
    arw: float  # stated angle random walk, rad/√s
    stretches: tuple[Stretch, ...]  # what it rests on
    axes: tuple[AxisNoise, ...]  # x, y and z
    notes: tuple[str, ...]  # what to know of it

    def to_json(self) -> dict[str, Any]:
        """Everything as numbers with their units."""
        unit, factor = COEFFICIENT_UNITS[RANDOM_WALK]
        return {
            "recording": self.recording,
            "stated_angle_random_walk": {"value": self.arw * factor, "unit": unit},
            "confidence": BOUND_CONFIDENCE,
            "stretches": [describe_stretch(one) for one in self.stretches],
            "axes": {axis: _describe_axis(one, self.stretches) for axis, one in zip(AXIS_NAMES, self.axes, strict=True)},
            "notes": list(self.notes),
        }


def estimate_noise_terms(recording: Recording, interval: str | None = None) -> NoiseAnalysis:
    """Allan deviation and noise terms of a recording, or of one of its intervals.

    An `InputError` if there is no such interval, or no stretch of samples shows the gyro's noise.
    """
    samples = select_measured_samples(recording)
    recording = samples.recording
    parts, notes = find_stretches(recording, interval)
    sinusoids, clean = _subtract_lines(recording, parts)
    measured = [samples.measured[one.samples] for one in parts]
    sample_s = recording.gyro.sample_s
    axes = tuple(_estimate_axis_noise(sample_s, parts, k, clean, sinusoids[k], measured) for k in range(3))
    return NoiseAnalysis(recording.title, recording.gyro.arw, parts, axes, (*samples.notes, *notes))


def _estimate_axis_noise(
    sample_s: float, parts: tuple[Stretch, ...], axis: int, clean: list[Array], sinusoid: LineSearch, measured: list[Mask]
) -> AxisNoise:
    """Fit the terms of one axis to the samples of each stretch that were measured."""

    def compute_deviation(rates: Iterable[Array]) -> Deviation:
        own_parts = (one[own, axis] for one, own in zip(rates, measured, strict=True))
        return overlapping_allan_deviation([one for one in own_parts if one.size], sample_s)

    deviation = compute_deviation(one.rates for one in parts)
    # Errors of the references are in the rates from which these are taken out.
    draws = REFERENCE_ERROR_DRAWS if any(not one.rest for one in parts) else 1
    generators = [generator(0, case, "allan references") for case in range(draws)]
    drawn = [compute_deviation(one.draw_reference_rates(rng) for one in parts).variance for rng in generators]
    floor = np.asarray(np.mean(drawn, axis=0))
    fit = fit_terms(compute_deviation(clean), floor)
    low, high = deviation.band(fit.degrees, BOUND_CONFIDENCE)
    tones = (compute_sinusoid_variance(line.amplitude, line.frequency_hz, deviation.tau_s) for line in sinusoid.found)
    steps = []
    for place, (rates, own) in enumerate(zip(clean, measured, strict=True)):
        step = find_rate_step(rates[own, axis])
        if step is not None:
            steps.append((place, replace(step, at=int(np.flatnonzero(own)[step.at]))))
    return AxisNoise(deviation, low, high, sum(tones, fit.model), floor, fit, sinusoid, tuple(steps))


def _subtract_lines(recording: Recording, parts: tuple[Stretch, ...]) -> tuple[list[LineSearch], list[Array]]:
    """The lines of each axis, and the rates of each stretch without them."""
    rates, used = recording.gyro.rates.copy(), np.zeros(recording.gyro.t_s.size, dtype=bool)
    for one in parts:
        used[one.samples] = True
        rates[one.samples] = one.rates
    stream = Stream(recording, rates, np.zeros_like(rates), np.zeros_like(used), used)
    found, findings = find_lines(stream, used, np.zeros(3, dtype=bool), DEFAULT.line)
    sinusoids, longest_s = [], max(len(one.rates) for one in parts) * recording.gyro.sample_s / FEWEST_CYCLES
    for axis, test in enumerate(findings.tests):
        own = tuple(line for line in found if line.axis == axis)
        # Of a line whose power exceeds the level around it P times the amplitude scatters by 1/√(2P) of itself.
        power = np.log(used.size / 2) - np.log(test.p_value)
        upper = np.deg2rad(test.value) * (1 + 1.645 / np.sqrt(2 * power)) if not own else np.nan
        sinusoids.append(LineSearch(own, float(upper), longest_s))
    waves = np.zeros_like(rates)
    for line in found:
        waves[:, line.axis] += line.waveform
    return sinusoids, [one.rates - waves[one.samples] for one in parts]


def find_rate_step(rates: Array) -> RateStep | None:
    """The step that explains the course of a stretch's rates (n,), rad/s; None where a line or noise explains it as well.

    The means over up to `BINS` equal times are fitted by a straight line, and by two levels with a step where that fits best.
    A step explains them far better and leaves what is white: of a ramp the line fits better, and of noise that wanders neither
    leaves white noise (its changes are too small for its scatter; von Neumann, Annals of Mathematical Statistics 12, 1941).
    """
    each = max(1, rates.size // BINS)
    count = rates.size // each
    if count < FEWEST_BINS:
        return None
    means = rates[: count * each].reshape(count, each).mean(axis=1)
    before = np.arange(1, count)
    low = np.cumsum(means)[:-1] / before
    high = (means.sum() - np.cumsum(means)[:-1]) / (count - before)
    explained = before * (count - before) / count * (high - low) ** 2
    best = int(np.argmax(explained))
    left = means - np.where(np.arange(count) <= best, low[best], high[best])
    of_line = means - np.polynomial.Polynomial.fit(np.arange(count), means, 1)(np.arange(count))
    variance = float(np.sum(left**2)) / (count - 3)
    better = float(np.sum(of_line**2) - np.sum(left**2))
    white = float(np.mean(np.diff(left) ** 2)) / max(variance, 1e-300)
    if better < STEP_CHI2_MARGIN * variance or white < WHITE_VARIANCE_RATIO:
        return None
    return RateStep((best + 1) * each, float(high[best] - low[best]))


def describe_stretch(one: Stretch) -> dict[str, Any]:
    """A stretch in a few words."""
    return {
        "interval": one.interval,
        "start_s": float(one.edges[0]),
        "stop_s": float(one.edges[-1]),
        "samples": len(one.rates),
        "rates": "rest, raw" if one.rest else "residual",
        "references": one.references,
        "p_constant_rate": one.p_value,
    }


def convert_to_display_unit(estimate: TermEstimate) -> TermEstimate:
    """An estimate in the unit shown."""
    factor = COEFFICIENT_UNITS[estimate.term][1]
    return replace(estimate, value=estimate.value * factor, sigma=estimate.sigma * factor, upper=estimate.upper * factor)


def describe_step(place: int, step: RateStep, parts: tuple[Stretch, ...]) -> dict[str, Any]:
    """Describe the time and size of a step."""
    own = parts[place]
    return {"interval": own.interval, "time_s": float(own.edges[step.at]), "size": step.size * RATE, "unit": RATE_UNIT}


def _describe_axis(one: AxisNoise, parts: tuple[Stretch, ...]) -> dict[str, Any]:
    terms = {}
    for found in map(convert_to_display_unit, one.fit.estimates):
        entry = {"seen": found.seen, "unit": COEFFICIENT_UNITS[found.term][0], "value": found.value, "sigma": found.sigma}
        entry["upper_95"] = found.upper
        if found.term == MARKOV:
            entry |= {"time_constant_s": found.time_constant_s, "time_constant_sigma_s": found.time_constant_sigma_s}
        terms[found.term] = entry
    lines_found = [
        {"frequency_hz": line.frequency_hz, "amplitude": line.amplitude * RATE, "sigma": line.sigma * RATE, "unit": RATE_UNIT}
        for line in one.sinusoid.found
    ]
    return {
        "tau_s": one.deviation.tau_s,
        "deviation_deg_h": one.deviation.deviation * RATE,
        "low_deg_h": one.low * RATE,
        "high_deg_h": one.high * RATE,
        "model_deg_h": np.sqrt(one.model) * RATE,
        "references_deg_h": np.sqrt(one.references) * RATE,
        "equivalent_degrees_of_freedom": one.fit.degrees,
        "terms": terms,
        "sinusoids": lines_found,
        "sinusoid_upper_95_deg_h": one.sinusoid.upper * RATE,
        "sinusoid_longest_period_s": one.sinusoid.longest_s,
        "steps": [describe_step(place, step, parts) for place, step in one.steps],
        "chi2": one.fit.chi2,
        "dof": one.fit.dof,
        "as_well": [list(terms) for terms in one.fit.alternatives],
    }
