"""A tone of one gyro by least squares: its frequency, amplitude and waveform, and whether it is one and the same everywhere.

Each arc has its own phase and counts by the noise that it has (`diagnosis.detectors.tone_in_arc`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.signal
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.report import IMPOSSIBLE
from diagnosis.detectors.tone_in_arc import NO_NOISE, calm_samples, frequency_off, in_arc, without_motion
from gyrocal.recording import Recording
from simulator.effects.recorded import interval_slices

Array = NDArray[np.float64]

SHORTEST = 256  # samples of a segment
FINENESS = 2.0  # times the samples: number of frequencies at which a fit may find a tone in white noise
CLEAR_LINE = 5.0  # sigmas of its amplitude over all arcs, for a line to be a tone
PART_CYCLES = 12  # of a line in a part of the samples in which its amplitude is compared
MOST_PARTS = 8  # of one arc
UNSTEADY = 0.1  # relative change of the amplitude that a tone may have
STEADY_SHARE, STEADY_SIGMAS = 0.75, 2.5  # of the parts, and how far these may be off
KEPT_SAMPLES = 1 << 17  # of an arc, below which its chirp transform is small enough to be kept
BESIDE = range(3, 11)  # resolutions of an arc from a tone, at which the noise around it is looked at
NEARBY = 0.25  # of a tone's frequency, within which that is
BEYOND_REST = 5.0  # sigmas of a power, by which one arc may have more of a tone than the rest of them


@dataclass(frozen=True)
class Line:
    """A tone of one gyro.

    Attributes
    ----------
    axis : which gyro
    frequency_hz : as sampled
    amplitude, sigma : rad/s
    p_value : that the strongest of all lines is chance
    waveform : (n,) the tone in the samples, rad/s; if it is steady, also beside the arcs in which it was found
    isolated : whether nothing but white noise is around it in the spectrum, so that the body shows no other motion there
    steady : whether its amplitude is the same in all arcs and their parts, as that of a tone is and that of a sway is not
    """

    axis: int
    frequency_hz: float
    amplitude: float
    sigma: float
    p_value: float
    waveform: Array
    isolated: bool
    steady: bool


@dataclass(frozen=True)
class Peak:
    """The strongest line of a spectrum, and the half width of a tone's peak in it."""

    p_value: float
    frequency_hz: float
    amplitude: float
    isolated: bool
    width_hz: float


def fitted_tone(x: Array, recording: Recording, axis: int, peak: Peak, found: list[tuple[int, int]]) -> Line | None:
    """Amplitude and frequency of a tone by least squares, arc by arc, each with its own phase.

    The strongest of many lines in one arc may be chance; a tone is there in all of them. None if it is not.
    """
    sample = recording.gyro.sample_s
    longest = max(found, key=lambda arc: arc[1] - arc[0])
    span = (longest[1] - longest[0]) * sample
    # The line is as wide as a segment is short; the longest arc resolves it further.
    width = max(1.5 / span, 1.0 / (SHORTEST * sample))
    trial = peak.frequency_hz + np.arange(-width, width, 0.05 / span)
    trial = trial[trial > 0]
    levels = [without_motion(x[low:high], peak.frequency_hz * sample) for low, high in found]
    levels = [np.where(calm_samples(y), y, 0.0) for y in levels]
    best = float(trial[int(np.argmax(_power(levels, found, recording, trial)))])
    near = np.linspace(best - 0.1 / span, best + 0.1 / span, 9)
    f = _top(near, _power(levels, found, recording, near))
    t_s = recording.gyro.t_s
    off = frequency_off([in_arc(x[low:high], t_s[low:high], f, sample) for low, high in found])
    f += float(np.clip(off, -0.1 / span, 0.1 / span))
    waveform, amplitudes, sigmas = np.zeros_like(x), list[float](), list[float]()
    samples, powers, variances, fits, beside = 0, np.zeros(len(found)), np.zeros(len(found)), list[Array](), list[Array]()
    for arc, (low, high) in enumerate(found):
        own = in_arc(x[low:high], t_s[low:high], f, sample)
        fitted, calm, waves, level = own.fitted, own.calm, own.waves[own.calm], own.level[own.calm]
        waveform[low:high] = own.plain @ fitted
        fits.append(fitted)
        left = max(float(np.mean((level - waves @ fitted) ** 2)), NO_NOISE)
        powers[arc], variances[arc] = fitted @ fitted, 2 * left / level.size
        beside.append(_beside(level - waves @ fitted, t_s[low:high][calm], f) / left)
        samples += level.size
        count = int(np.clip(level.size * sample * f // PART_CYCLES, 1, MOST_PARTS))
        for part in np.array_split(np.arange(level.size), count):
            amplitudes.append(float(np.hypot(*np.linalg.lstsq(waves[part], level[part], rcond=None)[0])))
            sigmas.append(np.sqrt(2 * left / part.size))
    # Each arc counts by the noise that it has: what a turn leaves in one of them is no line of all.
    power, information = float(np.sum(powers / variances)), float(np.sum(1 / variances))
    size, error = np.sqrt(max(power - 2 * len(found), 0.0) / information), float(1 / np.sqrt(information))
    steady = _is_steady(np.array(amplitudes), np.array(sigmas)) and _in_all(powers, variances)
    if steady:
        _carry_on(waveform, recording, found, fits, f)
    # A window that keeps the motion out of a spectrum costs half of a tone's power; a fit has all of it, two numbers an arc.
    # The averaged spectrum's p-value is not enough of an isolated line: to its bins, a hump of the noise is one, too.
    chance = FINENESS * samples * float(scipy.stats.chi2.sf(power / _level(beside), 2 * len(found)))
    p = float(np.clip(chance if peak.isolated else peak.p_value, IMPOSSIBLE, 1.0))
    return Line(axis, f, float(size), error, p, waveform, peak.isolated, steady) if size > CLEAR_LINE * error else None


def _beside(left: Array, t_s: Array, frequency_hz: float) -> Array:
    """Power of what a tone leaves of an arc at frequencies beside it that the arc tells apart; 1 for noise of variance 1."""
    span = float(t_s[-1] - t_s[0])
    apart = np.array([k for k in BESIDE if k < NEARBY * frequency_hz * span]) / max(span, 1e-300)
    trial = np.concatenate([frequency_hz - apart, frequency_hz + apart])
    waves = np.exp(-2j * np.pi * np.outer(trial, t_s - t_s[0]))
    return np.asarray(np.abs(waves @ left) ** 2 / left.size)


def _level(beside: list[Array]) -> float:
    """Noise around a tone over that of all frequencies, not less than one: what turns and jolts of a body leave is coloured.

    Where the spectrum has a hump, a frequency in it has more power than white noise, and so have those around it. The median of
    n powers of noise is ln 2, with the error 1/√n.
    """
    powers = np.concatenate(beside)
    if not powers.size:
        return 1.0
    return max(1.0, (float(np.median(powers)) - 1 / np.sqrt(powers.size)) / float(np.log(2)))


def _carry_on(
    waveform: Array, recording: Recording, found: list[tuple[int, int]], fits: list[Array], frequency_hz: float
) -> None:
    """A steady tone does not stop at the edges of the arcs: each goes on by as much as its length, or to the middle of a gap.

    A few samples of a strong tone that stay beside the arcs turn the attitude by more than references are off.
    """
    for part in interval_slices(recording):
        own = [k for k, (low, _) in enumerate(found) if part.start <= low < part.stop]
        for place, k in enumerate(own):
            low, high = found[k]
            begin = (found[own[place - 1]][1] + low + 1) // 2 if place else part.start
            end = (high + found[own[place + 1]][0] + 1) // 2 if place + 1 < len(own) else part.stop
            for beside in (slice(max(begin, 2 * low - high), low), slice(high, min(end, 2 * high - low))):
                angle = 2 * np.pi * frequency_hz * recording.gyro.t_s[beside]
                waveform[beside] = fits[k] @ np.array([np.cos(angle), np.sin(angle)])


def _power(levels: list[Array], found: list[tuple[int, int]], recording: Recording, trial: Array) -> Array:
    """Power of a tone at each of some frequencies evenly spaced, over all arcs, each in terms of its own."""
    power = np.zeros(trial.size)
    for y, (low, high) in zip(levels, found, strict=True):
        power += np.abs(_transform(y, recording.gyro.t_s[low:high], trial)) ** 2 / max(float(y @ y), NO_NOISE)
    return power


def _top(trial: Array, power: Array) -> float:
    """Where a parabola through the powers has its top."""
    at = (trial - trial.mean()) / np.ptp(trial)
    _, slope, curvature = np.polynomial.polynomial.polyfit(at, power / max(float(power.max()), 1e-300), 2)
    top = -slope / (2 * curvature) if curvature < 0 else 0.0
    return float(trial.mean() + np.ptp(trial) * np.clip(top, -0.5, 0.5))


def _transform(y: Array, t: Array, frequencies: Array) -> Array:
    """Fourier integral of y at some frequencies evenly spaced, by the chirp transform of y turned by the first of them."""
    step = frequencies[1] - frequencies[0] if frequencies.size > 1 else 1.0
    dt = float(np.median(np.diff(t)))
    turned = y * np.exp(-2j * np.pi * float(frequencies[0]) * dt * np.arange(y.size))
    make = _kept_chirp if y.size < KEPT_SAMPLES else _chirp
    # Steps that differ by rounding are one: over a trial's band of a few resolutions, its last digits turn nothing.
    return np.asarray(make(y.size, frequencies.size, float(f"{step * dt:.9e}"))(turned))


def _chirp(count: int, trials: int, step: float) -> scipy.signal.CZT:
    """The chirp transform of so many samples, from frequency zero on in steps of cycles a sample."""
    return scipy.signal.CZT(count, trials, np.exp(-2j * np.pi * step))


_kept_chirp = lru_cache(maxsize=32)(_chirp)  # lines are many: one for each arc serves them all


def _is_steady(amplitudes: Array, sigmas: Array) -> bool:
    """Whether amplitudes of several parts are one, within their noise and a tenth of it.

    Where the body starts or stops to turn, a part may be off; the amplitude of a sway is off in most of them.
    """
    if amplitudes.size < 2:
        return False
    middle = float(np.median(amplitudes))
    off = np.abs(amplitudes - middle) / np.hypot(sigmas, UNSTEADY * middle)
    return bool(np.quantile(off, STEADY_SHARE) < STEADY_SIGMAS)


def _in_all(powers: Array, variances: Array) -> bool:
    """Whether no arc has more of a line than all others together, as the one has in which a turn of the body rings.

    With its own phase in each, an arc of n samples shows of a tone A the power a² of the mean A² + 2s² and the variance
    4s² (A² + s²), where s² = 2σ²/n; the others' mean, weighed by 1/s², says what A² is. Parts of an arc, which each show
    little of a weak line, would not tell.
    """
    if powers.size < 2:
        return True
    weights = (1.0 - np.eye(powers.size)) / variances
    weights /= weights.sum(axis=1, keepdims=True)
    rest = np.maximum(weights @ (powers - 2 * variances), 0.0)
    own = 4 * variances * (rest + variances)
    of_others = weights**2 @ (4 * variances**2) + 4 * rest * (weights**2 @ variances)
    spread = np.sqrt(own + of_others + (2 * UNSTEADY * rest) ** 2)
    return bool(np.all(powers - 2 * variances - rest < BEYOND_REST * spread))
