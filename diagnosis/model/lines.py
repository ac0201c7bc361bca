"""Whether a line in the samples is a vibration or a motion of the body: one likelihood ratio, of which the attitude is a part.

With c the whitened and projected observations of all references of a reading that is too high by the line's waveform, and y
those of the recording propagated with the line in it, y ~ N(c, I) if the line is a vibration, which the body does not follow,
and N(0, I) if the body moves so. The log of the likelihood ratio is yᵀc − ½ cᵀc, whose mean is ±½ cᵀc: references that could
not see a motion of that size and frequency leave the prior as it is. Where another effect is at work, a bias that walks for
one, y has more power than noise at the line's frequency whatever the line is: y ~ N(·, B I) with B, not less than one, the mean
square of y along tones of that gyro beside the line, and the log ratio is 1/B of that.

The amplitudes in parts of the samples have a likelihood ratio, too (`diagnosis.detectors.sinusoids_in_arcs`). The prior is even
in frequency up to half the sampling rate for a vibration, and in the logarithm of the frequency for a motion.

What is no motion need not be a vibration either: a bias may vary with any period that the references can follow, evenly in its
logarithm. Where that is far more probable, the search of the attitude decides, and otherwise each is the other's alternative.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from diagnosis.detectors.sample_report import AXES, Line, SampleReport, Symptom
from diagnosis.model.misfit import project_innovations
from diagnosis.model.recording_model import RecordingModel
from diagnosis.model.sinusoid_causes import BIAS, PICKUP, SinusoidCause
from diagnosis.sinusoids.fit import make_waves
from gyrocal.mask_runs import find_mask_runs
from gyrocal.recording import GyroStream
from simulator.effects.periodic import compute_period_band

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class LinePrior:
    """Prior of what a line is."""

    # log odds of a vibration against a motion, of lines at any frequency; −0.6 once the amplitude is constant
    vibration: float = -1.3
    # natural log of the range of frequencies of a motion, and of the periods of a bias
    motion_range: float = 7.0
    bias_range: float = 5.0
    within_motion: float = -10.0  # log odds of a vibration where the body shows other motion at or below the line's frequency
    left_to_search: float = 0.95  # probability of a variation of the bias above which the attitude alone decides on it
    confirmed: float = -4.0  # log ratio of the attitude below which a note says that the references show the motion
    # resolutions of the longest arc, to the tones beside a line
    beside: tuple[float, ...] = (-8.0, -6.5, -5.0, -3.5, -2.0, 2.0, 3.5, 5.0, 6.5, 8.0)


LINE_PRIOR = LinePrior()


def judge_lines(
    report: SampleReport,
    model: RecordingModel,
    tell: Callable[[int], None] = lambda count: None,
) -> SampleReport:
    """Take the lines that are vibrations out of the samples, as symptoms; return the report with them.

    Lines that are motions of the body stay where they are. `tell` is called with the number of lines that are done.
    """
    gyro, band = model.recording.gyro, compute_period_band(model.surroundings)
    fastest_hz = 0.0 if band is None else 1 / band[0]
    rates, symptoms = report.rates.copy(), list(report.symptoms)
    vibrations: list[Line] = []
    motions: list[Line] = []
    unconfirmed: list[Line] = []
    for count, line in enumerate(report.lines):
        tell(count)
        of_attitude = compute_log_ratio(model, line)
        odds = compute_log_prior_odds(line, gyro) + line.log_constancy + of_attitude
        if odds <= 0:
            (motions if of_attitude < LINE_PRIOR.confirmed else unconfirmed).append(line)
            continue
        bias = compute_probability_of_bias(line, gyro, fastest_hz)
        if bias > LINE_PRIOR.left_to_search:
            continue
        vibrations.append(line)
        rates[:, line.axis] -= line.waveform
        symptoms.append(make_symptom(line, float(expit(odds)), bias, gyro))
    return replace(
        report, rates=rates, symptoms=tuple(symptoms), vibrations=tuple(vibrations), motions=tuple(motions),
        unconfirmed=tuple(unconfirmed),
    )  # fmt: skip


def compute_log_prior_odds(line: Line, gyro: GyroStream) -> float:
    """Return the prior log odds of a vibration against a motion."""
    if not line.isolated:
        return LINE_PRIOR.within_motion
    return LINE_PRIOR.vibration + float(np.log(LINE_PRIOR.motion_range * line.frequency_hz * 2 * gyro.sample_s))


def compute_probability_of_bias(line: Line, gyro: GyroStream, fastest_hz: float) -> float:
    """Return the probability that a line that is no motion is one of the bias, up to the frequency that references follow."""
    if line.frequency_hz > fastest_hz:
        return 0.0
    return float(expit(-np.log(LINE_PRIOR.bias_range * line.frequency_hz * 2 * gyro.sample_s)))


def make_symptom(line: Line, probability: float, bias: float, gyro: GyroStream) -> Symptom:
    """Make the symptom of a line that is no motion: a vibration, or a variation of the bias; the other is its alternative."""
    size, sigma = float(np.rad2deg(line.amplitude)), float(np.rad2deg(line.sigma))
    text = f"a line of {size:.3g} deg/s at {line.frequency_hz:.4f} Hz that is no motion of the body"
    kind, other, unit = PICKUP, BIAS, "deg/s"
    parameters: dict[str, float | str] = {"apparent_hz": line.frequency_hz}
    if bias > 0.5:
        kind, other = BIAS, PICKUP
        size, sigma, unit, parameters = _convert_to_bias(line, gyro).state()
    share = min(bias, 1 - bias)
    rivals = ((other, share),) if share > 0 else ()
    return Symptom(kind, AXES[line.axis], size, unit, sigma, parameters, line.p_value, text, probability, rivals, of_line=True)


def _convert_to_bias(line: Line, gyro: GyroStream) -> SinusoidCause:
    """The line as one of the bias, of which a sample shows the mean, in phase with the longest run that holds it."""
    low, high = max(find_mask_runs(line.waveform != 0.0), key=lambda run: run[1] - run[0])
    wave = make_waves(line.frequency_hz, gyro.t_s[low:high] + 0.5 * gyro.sample_s)
    found = np.linalg.lstsq(wave, line.waveform[low:high], rcond=None)[0]
    mean = float(np.sinc(line.frequency_hz * gyro.sample_s))
    amplitudes = line.amplitude / mean * found / np.hypot(*found)
    return SinusoidCause(BIAS, line.axis, line.frequency_hz, amplitudes, line.sigma / mean)


def compute_log_ratio(model: RecordingModel, line: Line) -> float:
    """Return the log likelihood of the attitude with the line a vibration, over that with it a motion of the body."""
    gyro = model.recording.gyro
    longest_s = max(high - low for low, high in find_mask_runs(line.waveform != 0.0)) * gyro.sample_s
    beside = line.frequency_hz + np.array(LINE_PRIOR.beside) / longest_s
    y, (c, *others) = _observe(model, line.axis, _make_waveforms(line, gyro.t_s, beside[beside > 0]))
    # In the directions of tones beside it, whatever else is at work shows its power at these frequencies; noise has one.
    Q = np.linalg.qr(np.column_stack([c, *others]))[0]
    usual = max(float(np.mean((y @ Q[:, 1:]) ** 2)), 1.0)
    return float(y @ c - 0.5 * c @ c) / usual


def _make_waveforms(line: Line, t_s: Array, frequencies: Array) -> Iterator[Array]:
    """The line's waveform (n,), and tones at some frequencies where it is; one at a time: there may be ten million samples."""
    yield line.waveform
    there = line.waveform != 0.0
    for frequency in frequencies:
        yield from there * make_waves(frequency, t_s).T


def _find_samples(t_s: Array, lasts: Array, times_s: Array) -> tuple[Indices, Array]:
    """Find the sample of each time (q,), and the share of it that is left then."""
    sample = np.maximum(np.searchsorted(t_s, times_s, side="right") - 1, 0)
    return sample, np.clip(1 - (times_s - t_s[sample]) / lasts[sample], 0.0, 1.0)


def _observe(model: RecordingModel, axis: int, waveforms: Iterable[Array]) -> tuple[Array, list[Array]]:
    """White observations, and the same of readings of a gyro that are too high by each of some waveforms, (n,).

    Where references are averaged to fewer observations, a fast line is lost in these; their innovations have it still.
    """
    gyro = model.recording.gyro
    # A sample lasts until the next one, but not over a gap between intervals.
    lasts = np.minimum(gyro.sample_s, np.append(np.diff(gyro.t_s), np.inf))
    begin, end = (_find_samples(gyro.t_s, lasts, model.t_s + way * model.dt) for way in (-0.5, 0.5))
    rates = []
    for waveform in waveforms:
        turned = waveform * gyro.sample_s
        after = np.cumsum(turned)
        at_begin, at_end = (after[sample] - left * turned[sample] for sample, left in (begin, end))
        rates.append((at_end - at_begin) / model.dt)
    high = np.zeros((model.t_s.size, 3, len(rates)))
    high[:, axis] = np.column_stack(rates)
    if all((block.counts == 1).all() for block in model.blocks):
        return model.y, list(model.whiten_and_project(model.reading(high)).T)
    left, _, _ = project_innovations(model, np.dstack([model.residuals, model.compute_attitude_turns(high)]))
    y, *columns = left.T
    return y, columns
