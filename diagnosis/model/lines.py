"""Whether a line in the samples is a vibration or a motion of the body: the attitude decides.

With c the whitened and projected observations of all references of a reading that is too high by the line's waveform, and y
those of the recording propagated with the line in it, y ~ N(c, I) if the line is a vibration, which the body does not follow,
and N(0, I) if the body moves so. The log of the likelihood ratio is yᵀc − ½ cᵀc, whose mean is ±½ cᵀc: references that could
not see a motion of that size and frequency say nothing, at whatever frequency that is, and then the prior remains. Where
another effect is at work, a bias that walks for one, y has more power than noise at the line's frequency whatever the line
is: y ~ N(·, B I) with B, not less than one, the mean square of y along tones of that gyro beside the line, and the log ratio
is 1/B of that. A body that sways does so over a band of frequencies and with an amplitude that changes: a line that is not
steady, or not alone above the white noise, is a motion unless the references deny it, and so is one within the band of such
lines. Of a steady tone beyond that band only the frequency is known: a vibration may show at any up to half the sampling
rate, evenly, a motion is as likely in each octave. A vibration is picked up by one gyro; a body that rings shows several such
tones.

What is no motion need not be a vibration either: a bias may swing with any period that the references can follow, and is as
likely to in each octave of them. Where it is rather that by far, it is left to the search of the attitude, and otherwise each
is the other's rival.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence, Set

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from diagnosis.detectors.gap_interpolation import runs
from diagnosis.detectors.report import AXES, SampleReport, Symptom
from diagnosis.detectors.spectral_tones import Line
from diagnosis.model.misfit import innovations_of
from diagnosis.model.recording import RecordingModel
from diagnosis.model.tones.tone import BIAS, PICKUP, Way, waves
from gyrocal.recording import GyroStream
from simulator.effects.periodic import period_band

Array = NDArray[np.float64]

BEYOND = -0.6  # prior log odds of a vibration for a steady tone beyond the band in which the body moves
OCTAVES = 7.0  # natural log of the range of frequencies of a motion
WITHIN = -10.0  # the same for any other line
SEVERAL = 3.0  # log odds that each further one, of which the references know nothing, takes from all of them
CONFIRMED = -4.0  # log ratio below which the references confirm a motion
PERIODS = 5.0  # natural log of the range of periods that a bias may have
FAR = 0.95  # probability of a swing of the bias, from which on it is left to the search
BESIDE = (-8.0, -6.5, -5.0, -3.5, -2.0, 2.0, 3.5, 5.0, 6.5, 8.0)  # resolutions of the longest arc, to the tones beside a line
BAND = 3.0  # factor on a frequency of the body's motion, up to which the next line belongs to it too


def judged_lines(
    report: SampleReport,
    model: RecordingModel,
    silent: Set[int] = frozenset(),
    tell: Callable[[int], None] = lambda count: None,
) -> bool:
    """Take the lines that are vibrations out of the samples, and note them as symptoms; whether there were any.

    Lines that are motions of the body stay where they are, and so do those in the band of motion of gyros that are silent in a
    dead zone, whose edges make lines of their own. `tell` is called with the number of lines that are done, before each.
    """
    ratios = []
    for count, line in enumerate(report.lines):
        tell(count)
        ratios.append(log_ratio(model, line))
    half_rate_hz, band = 0.5 / model.recording.gyro.sample_s, period_band(model.around)
    fastest_hz = 0.0 if band is None else 1 / band[0]
    apart = [
        ratio + BEYOND + float(np.log(OCTAVES * line.frequency_hz / half_rate_hz))
        for line, ratio in zip(report.lines, ratios, strict=True)
    ]
    moving = [
        line.frequency_hz
        for line, ratio, odds in zip(report.lines, ratios, apart, strict=True)
        if ratio < CONFIRMED or (odds <= 0 if line.isolated and line.steady else WITHIN + ratio <= 0)
    ]
    edge = _edge(moving, [line.frequency_hz for line in report.lines])
    alone = [line.isolated and line.steady and line.frequency_hz > edge for line in report.lines]
    # A tone within the band of the motions says nothing of those beyond it.
    ringing = sum(one and abs(ratio) < -CONFIRMED for one, ratio in zip(alone, ratios, strict=True))
    own = [odds if single else WITHIN + ratio for odds, single, ratio in zip(apart, alone, ratios, strict=True)]
    found = False
    for line, ratio, single, by_itself in zip(report.lines, ratios, alone, own, strict=True):
        if line.axis in silent and not single:
            continue
        odds = by_itself - (SEVERAL * max(ringing - 1, 0) if single else 0.0)
        swing = _swing(line, half_rate_hz, fastest_hz)
        if odds > 0 and swing > FAR:
            continue
        if odds <= 0:
            (report.motions if ratio < CONFIRMED else report.unconfirmed).append(line)
            continue
        found = True
        report.vibrations.append(line)
        report.rates[:, line.axis] -= line.waveform
        report.symptoms.append(_symptom(line, float(expit(odds)), swing, model.recording.gyro))
    return found


def _edge(moving: Sequence[float], frequencies: Sequence[float]) -> float:
    """The highest frequency of the band in which the body moves, Hz: of the motions, and of lines that follow one another."""
    edge = BAND * max(moving, default=0.0)
    for frequency in sorted(frequencies):
        if frequency <= edge:
            edge = max(edge, BAND * frequency)
    return edge


def _symptom(line: Line, probability: float, swing: float, gyro: GyroStream) -> Symptom:
    """A line that is no motion, as a vibration or as a swing of the bias, the other of which may be its rival."""
    size, sigma = float(np.rad2deg(line.amplitude)), float(np.rad2deg(line.sigma))
    text = f"a line of {size:.3g} deg/s at {line.frequency_hz:.4f} Hz that is no motion of the body"
    kind, other, unit = PICKUP, BIAS, "deg/s"
    parameters: dict[str, float | str] = {"apparent_hz": line.frequency_hz}
    if swing > 0.5:
        kind, other = BIAS, PICKUP
        size, sigma, unit, parameters = _as_swing(line, gyro).stated()
    share = min(swing, 1 - swing)
    rivals = ((other, share),) if share > 0 else ()
    return Symptom(kind, AXES[line.axis], size, unit, sigma, parameters, line.p_value, text, probability, rivals, of_line=True)


def _as_swing(line: Line, gyro: GyroStream) -> Way:
    """The line as a swing of the bias, of which a sample shows the mean, in phase with the longest run that holds it."""
    low, high = max(runs(line.waveform != 0.0), key=lambda run: run[1] - run[0])
    wave = waves(np.array([line.frequency_hz]), gyro.t_s[low:high] + 0.5 * gyro.sample_s, 0.0)
    found = np.linalg.lstsq(wave, line.waveform[low:high], rcond=None)[0]
    mean = float(np.sinc(line.frequency_hz * gyro.sample_s))
    amplitudes = line.amplitude / mean * found / np.hypot(*found)
    return Way(BIAS, line.axis, line.frequency_hz, amplitudes, line.sigma / mean, 0.0)


def _swing(line: Line, half_rate_hz: float, fastest_hz: float) -> float:
    """Probability that a line that is no motion is a swing of the bias, which the references follow up to a frequency.

    A vibration may show at any frequency up to half the sampling rate, evenly; periods of a bias are even in their logarithm.
    """
    if line.frequency_hz > fastest_hz:
        return 0.0
    return float(expit(np.log(half_rate_hz / (line.frequency_hz * PERIODS))))


def log_ratio(model: RecordingModel, line: Line) -> float:
    """log of the likelihood of the attitude with the line a vibration, over that with it a motion of the body."""
    beside = line.frequency_hz + np.array(BESIDE) / _longest_s(line, model)
    y, (c, *others) = _seen(model, line.axis, _beside(line, model.recording.gyro.t_s, beside[beside > 0]))
    # In the directions of tones beside it, whatever else is at work shows its power at these frequencies; noise has one.
    Q = np.linalg.qr(np.column_stack([c, *others]))[0]
    usual = max(float(np.mean((y @ Q[:, 1:]) ** 2)), 1.0)
    return float(y @ c - 0.5 * c @ c) / usual


def _beside(line: Line, t_s: Array, frequencies: Array) -> Iterator[Array]:
    """The line's waveform (n,), and tones at some frequencies where it is; one at a time: there may be ten million samples."""
    yield line.waveform
    there = line.waveform != 0.0
    for frequency in frequencies:
        for wave in (np.cos, np.sin):
            yield there * wave(2 * np.pi * frequency * t_s)


def _longest_s(line: Line, model: RecordingModel) -> float:
    """Duration of the longest run of samples that hold the line."""
    return max(high - low for low, high in runs(line.waveform != 0.0)) * model.recording.gyro.sample_s


def _seen(model: RecordingModel, axis: int, waves: Iterable[Array]) -> tuple[Array, list[Array]]:
    """White observations, and the same of readings of a gyro that are too high by each of some waveforms, (n,).

    Where references are averaged to fewer observations, a fast line is lost in these; their innovations have it still.
    """
    gyro = model.recording.gyro
    # A sample lasts until the next one, but not over a gap between intervals.
    stops = np.minimum(gyro.t_s + gyro.sample_s, np.append(gyro.t_s[1:], np.inf))
    edges = np.column_stack([gyro.t_s, stops]).ravel()
    begin, end = model.t_s - 0.5 * model.dt, model.t_s + 0.5 * model.dt
    rates = []
    for wave in waves:
        after = np.cumsum(wave * gyro.sample_s)
        turned = np.column_stack([np.append(0.0, after[:-1]), after]).ravel()
        rates.append((np.interp(end, edges, turned) - np.interp(begin, edges, turned)) / model.dt)
    high = np.zeros((model.t_s.size, 3, len(rates)))
    high[:, axis] = np.column_stack(rates)
    if model.recording.attitudes.sensor is not None or all((block.counts == 1).all() for block in model.blocks):
        return model.y, list(model.prepared(model.reading(high)).T)
    left, _, _ = innovations_of(model, np.dstack([model.residuals, model.turned_by(high)]))
    y, *columns = left.T
    return y, columns
