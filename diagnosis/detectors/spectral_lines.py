"""Lines in the spectrum of the samples: tones that are there, with one frequency, in all arcs of the samples.

Quiet arcs show lines of any frequency. Arcs in which the body moves show them above the band of its motion, where the level of
the spectrum is that of the white noise.

A line is a vibration only if the body does not move so. The samples cannot tell that; the attitude does
(`diagnosis.model.lines`). Here a line is found, its frequency and amplitude are estimated, and its waveform is kept.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
import scipy.fft
import scipy.ndimage
import scipy.signal
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.report import AXES, IMPOSSIBLE, SampleReport, SampleTest, Tell, arcs, consecutive, silent
from gyrocal.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

AT_ONCE = 1 << 20  # samples of segments that are transformed together
FEWEST_CYCLES = 4.0  # of a line in the longest quiet arc: fewer are a trend
WORTH_A_FIT = 0.01  # p-value of a peak, from which on a tone is fitted to see whether it is one
FINENESS = 2.0  # times the samples: number of frequencies at which a fit may find a tone in white noise
CLEAR_LINE = 5.0  # sigmas of its amplitude over all arcs, for a line to be a tone
SHORTEST = 256  # samples of a segment
HALVINGS = 6  # lengths of segments that are tried, from the longest arc down
LEVEL_BINS = 61  # of the spectrum, over which the level around a line is taken
MANY = 8  # segments side by side, from which on overlapping ones are averaged too
MOST_LINES = 4  # of one axis in one look
MOST_PEAKS = 8  # that are tried for them; what a fit leaves of a line is a peak again
AVERAGED_CYCLES = (4, 4.5, 5, 5.5, 6, 7, 8, 9, 10)  # of a line, over which the motion beside it may be followed
SUDDEN = 6.0  # robust sigmas beyond which a sample does not count
DEGREE = 6  # of the polynomial that follows it
PART_CYCLES = 12  # of a line in a part of the samples in which its amplitude is compared
MOST_PARTS = 8  # of one arc
UNSTEADY = 0.1  # relative change of the amplitude that a tone may have
STEADY_SHARE, STEADY_SIGMAS = 0.75, 2.5  # of the parts, and how far these may be off
NO_NOISE = 1e-60  # (rad/s)², where readings leave nothing beside a line
BEYOND_REST = 5.0  # sigmas of a power, by which one arc may have more of a tone than the rest of them
STRONG = 30.0  # times the white noise: what a motion has, and no chance
LOBE = 4  # bins on either side of a line, over which its peak spreads
OUTSTANDING = 8.0  # times all that leads up to it, from which on a line stands out
FEWEST_BELOW = 40  # bins below a line that stands out of what leads up to it
NEXT = 3.0  # factor from one frequency of a motion to the next
JOLT = 15.0  # medians of the second differences, ten sigmas of noise, from which on the rate jumps
MOST_JOLTS = 0.02  # share of the samples, above which the body moves fast
MARGIN = 3.0  # on the highest of them, up to which a line belongs to the motion
ISOLATED = 2.0  # level around a line over that of the white noise, below which the body shows no other motion there


@dataclass(frozen=True)
class Line:
    """A tone of one gyro.

    Attributes
    ----------
    axis : which gyro
    frequency_hz : as sampled
    amplitude, sigma : rad/s
    p_value : that the strongest of all lines is chance
    waveform : (n,) the tone in the samples, rad/s; zero outside the quiet arcs
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


def lines(report: SampleReport, recording: Recording, quiet: Mask, used: Mask, tell: Tell = silent) -> list[Line]:
    """The lines of each axis: first those beyond the motion, in all samples that can be used, then any in quiet ones."""
    smooth = used & ~jolts(report.rates, used)
    looks = [_Look(arcs(smooth & consecutive(recording, smooth)), beyond=True)]
    looks.append(_Look(arcs(quiet & consecutive(recording, quiet)), beyond=False))
    out: list[Line] = []
    for axis in range(3):
        # Readings that stand still, as those of a gyro that is clipped or dead, have no noise beside which a line would stand.
        moving = [
            replace(look, arcs=[arc for arc in look.arcs if np.ptp(report.rates[slice(*arc), axis]) > 0]) for look in looks
        ]
        out += _of_axis(report, [look for look in moving if look.arcs], recording, axis, tell)
    return out


def jolts(rates: Array, used: Mask) -> Mask:
    """(n,) samples beside which a rate jumps or breaks off; none where that is so everywhere, as in fast motion.

    The spectrum of an arc that holds such a moment is full of waves that are neither motion nor noise.
    """
    if not used.any():
        return np.zeros(used.size, dtype=bool)
    second = np.zeros_like(rates)
    second[1:-1] = np.abs(np.diff(rates, 2, axis=0))
    usual = np.median(second[used], axis=0)
    found = scipy.ndimage.binary_dilation((second > JOLT * usual).any(axis=1), iterations=2)
    return np.asarray(found) if found[used].mean() < MOST_JOLTS else np.zeros_like(found)


def _of_axis(report: SampleReport, looks: list[_Look], recording: Recording, axis: int, tell: Tell) -> list[Line]:
    """The lines of an axis, and the note of the strongest; those of each look are counted apart: slow motions are many."""
    x, found, strongest = report.rates[:, axis].copy(), list[_Found](), NO_PEAK
    sample = recording.gyro.sample_s
    for look, outstanding in [*((look, True) for look in looks if look.beyond), *((look, False) for look in looks)]:
        most = len(found) + MOST_LINES
        for number in range(MOST_PEAKS):
            told = partial(tell, f"lines of gyro {AXES[axis]}", (axis + number / MOST_PEAKS) / 3)
            peak = _outstanding(x, look, sample) if outstanding else _strongest(x, look, sample, told)
            if number == 0 and peak.p_value <= strongest.p_value:
                strongest = peak
            # Rounding a slow motion makes lines of its own.
            if peak.p_value >= WORTH_A_FIT or report.lattice[axis] or len(found) == most:
                break
            line = _tone(x, recording, axis, peak, look.arcs)
            if line is None or line.p_value >= report.line_p:
                break
            x = x - line.waveform
            before = next((one for one in found if abs(one.line.frequency_hz - line.frequency_hz) < one.width_hz), None)
            if before is None:
                found.append(_Found(line, peak.width_hz))
            else:  # what the fit left of it
                before.line = replace(before.line, waveform=before.line.waveform + line.waveform)
    p = min(1.0, strongest.p_value * max(len(looks), 1))
    text = f"strongest line at {strongest.frequency_hz:.4f} Hz, {np.rad2deg(strongest.amplitude):.3g} deg/s"
    report.tests.append(SampleTest("strongest_line", AXES[axis], float(np.rad2deg(strongest.amplitude)), 0.0, p, None, text))
    return [one.line for one in found]


@dataclass(frozen=True)
class _Peak:
    """The strongest line of a spectrum, and the half width of a tone's peak in it."""

    p_value: float
    frequency_hz: float
    amplitude: float
    isolated: bool
    width_hz: float


NO_PEAK = _Peak(1.0, 0.0, 0.0, False, 0.0)


@dataclass
class _Found:
    """A line, and up to which distance in frequency another one is what a fit left of it."""

    line: Line
    width_hz: float


@dataclass(frozen=True)
class _Look:
    """Arcs of samples, and whether only what is beyond the band of the body's motion is looked at."""

    arcs: list[tuple[int, int]]
    beyond: bool


def _strongest(x: Array, look: _Look, sample_s: float, tell: Callable[[], None] = lambda: None) -> _Peak:
    """The strongest line of spectra averaged over segments, of the length of segments that shows it best.

    Long segments gather the power of a tone in one bin, short ones use more of the arcs.
    """
    peaks = []
    for length in _lengths(look):
        tell()
        peaks.append(_peak(x, look, length, sample_s))
    best = min(peaks, key=lambda peak: peak.p_value)
    return replace(best, p_value=min(1.0, best.p_value * len(peaks)))


def _lengths(look: _Look) -> list[int]:
    """Lengths of segments, samples."""
    longest = max(high - low for low, high in look.arcs)
    return sorted({scipy.fft.prev_fast_len(max(longest >> k, SHORTEST), real=True) for k in range(HALVINGS)})


def _averaged(x: Array, look: _Look, n: int) -> tuple[Array, Array, float]:
    """The spectrum averaged over all segments of n samples, its window, and how many independent ones it is the mean of.

    Segments overlap where there are many. Where there is none, neither is a spectrum.
    """
    # A window keeps the body's slow motion out of the frequencies looked at; where it moves, one of far lower side lobes.
    window = scipy.signal.windows.blackmanharris(n, sym=False) if look.beyond else scipy.signal.windows.hann(n, sym=False)
    many = sum((high - low) // n for low, high in look.arcs) >= MANY
    step = n // (3 if look.beyond else 2) if many else n
    starts = [np.arange(low, high - n + 1, step) for low, high in look.arcs]
    places = np.concatenate(starts)
    if not places.size:
        return np.empty(0), window, 0.0
    # Some segments at a time: all of a long recording, three times over and as complex numbers, are gigabytes.
    spectrum, some = np.zeros(n // 2 + 1), max(1, AT_ONCE // n)
    for first in range(0, places.size, some):
        segments = np.array([x[start : start + n] for start in places[first : first + some]])
        spectra = np.abs(scipy.fft.rfft(scipy.signal.detrend(segments, axis=1) * window, axis=1)) ** 2 / np.sum(window**2)
        spectrum += spectra.sum(axis=0) / places.size
    return spectrum, window, _independent([own.size for own in starts], window, step)


def _peak(x: Array, look: _Look, n: int, sample_s: float) -> _Peak:
    """The strongest line of the spectrum averaged over all segments of n samples."""
    spectrum, window, count = _averaged(x, look, n)
    if not spectrum.size:
        return NO_PEAK
    frequency: Array = np.fft.rfftfreq(n, sample_s).astype(float)
    lowest = FEWEST_CYCLES / (n * sample_s)
    # Against the level around it, so that coloured noise is no line. The median of a mean of `count` exponentials:
    median = float(scipy.stats.gamma.median(count)) / count
    around = scipy.ndimage.median_filter(spectrum, LEVEL_BINS, mode="nearest") / median
    white = float(np.median(spectrum[spectrum.size // 2 :])) / median
    if look.beyond:
        lowest = max([lowest, _edge(frequency[spectrum > STRONG * white]), *frequency[around > ISOLATED * white]])
    allowed = np.flatnonzero((frequency > lowest) & (frequency < frequency[-1] * (1 - 1 / n)))
    if allowed.size < 20:
        return NO_PEAK
    # Of few bins, the level around may be low by chance; the white noise is that of many.
    power = spectrum[allowed] / np.maximum(np.maximum(around, white)[allowed], 1e-300)
    k = int(allowed[np.argmax(power)])
    p = min(1.0, allowed.size * float(scipy.stats.gamma.sf(count * float(power.max()), count)))
    amplitude = 2 * np.sqrt(spectrum[k] * np.sum(window**2)) / np.sum(window)
    beside = spectrum[max(k - LEVEL_BINS // 2, 0) : k + LEVEL_BINS // 2]
    isolated = float(np.median(beside)) / median < ISOLATED * white
    width = (LOBE if look.beyond else 2) * float(frequency[1])
    return _Peak(max(p, IMPOSSIBLE), float(frequency[k]), float(amplitude), isolated, width)


def _outstanding(x: Array, look: _Look, sample_s: float) -> _Peak:
    """The line that stands out most above all of the spectrum on its lower side, whether in the band of the motion or not.

    Motions that turns, waves and their harmonics make have the less power the faster they are. A line that is far above what
    leads up to it, from a third of its frequency on, is none of them; it would pass for the end of their band, which nothing
    beyond is looked for in. It is not isolated if motion, and not noise, leads up to it.
    """
    best, most = NO_PEAK, OUTSTANDING
    for n in _lengths(look):
        spectrum, window, count = _averaged(x, look, n)
        if not spectrum.size:
            continue
        white = float(np.median(spectrum[spectrum.size // 2 :]))
        inner = spectrum[1:-1]
        tops = 1 + np.flatnonzero((inner > STRONG * white) & (inner >= spectrum[:-2]) & (inner >= spectrum[2:]))
        for k in tops[tops > max(NEXT * FEWEST_CYCLES, FEWEST_BELOW)]:
            below, beside = spectrum[int(k / NEXT) : k - LOBE], spectrum[k + LOBE + 1 : k + LEVEL_BINS]
            level = max(float(below.max()), float(beside.max(initial=0.0)), white)
            if spectrum[k] > most * level:
                most, f = float(spectrum[k] / level), float(k / (n * sample_s))
                p = float(np.clip(spectrum.size * scipy.stats.gamma.sf(count * most, count), IMPOSSIBLE, 1.0))
                amplitude = 2 * np.sqrt(spectrum[k] * np.sum(window**2)) / np.sum(window)
                best = _Peak(p, f, float(amplitude), bool(below.max() < STRONG * white), LOBE / (n * sample_s))
    return best


def _independent(counts: list[int], window: Array, step: int) -> float:
    """Number of independent segments that as many overlapping ones are worth (Welch 1967)."""
    n, total, shared = window.size, float(sum(counts)), 0.0
    for j in range(1, (n - 1) // step + 1):
        alike = float(window[: n - j * step] @ window[j * step :] / (window @ window)) ** 2
        shared += 2 * alike * sum(max(count - j, 0) for count in counts) / total
    return total / (1 + shared)


def _edge(strong: Array) -> float:
    """End of the band of frequencies, each within an octave and a half of the one before, in which the body moves, Hz."""
    apart = np.flatnonzero(strong[1:] > NEXT * np.maximum(strong[:-1], strong[1:2]))
    return float(MARGIN * strong[apart[0] if apart.size else -1]) if strong.size else 0.0


def _tone(x: Array, recording: Recording, axis: int, peak: _Peak, found: list[tuple[int, int]]) -> Line | None:
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
    levels = [_without_motion(x[low:high], peak.frequency_hz * sample) for low, high in found]
    levels = [np.where(_calm(y), y, 0.0) for y in levels]
    best = float(trial[int(np.argmax(_power(levels, found, recording, trial)))])
    near = np.linspace(best - 0.1 / span, best + 0.1 / span, 9)
    f = _top(near, _power(levels, found, recording, near))
    waveform, amplitudes, sigmas = np.zeros_like(x), list[float](), list[float]()
    samples, powers, variances = 0, np.zeros(len(found)), np.zeros(len(found))
    for arc, (low, high) in enumerate(found):
        angle = 2 * np.pi * f * recording.gyro.t_s[low:high]
        waves = np.column_stack([np.cos(angle), np.sin(angle)])
        level = _without_motion(x[low:high], f * sample)
        fitted = np.linalg.lstsq(waves, level, rcond=None)[0]
        calm = _calm(level - waves @ fitted)
        fitted = np.linalg.lstsq(waves[calm], level[calm], rcond=None)[0]
        waveform[low:high] = waves @ fitted
        waves, level = waves[calm], level[calm]
        left = max(float(np.mean((level - waves @ fitted) ** 2)), NO_NOISE)
        powers[arc], variances[arc] = fitted @ fitted, 2 * left / level.size
        samples += level.size
        count = int(np.clip(level.size * sample * f // PART_CYCLES, 1, MOST_PARTS))
        for part in np.array_split(np.arange(level.size), count):
            own = np.linalg.lstsq(waves[part], level[part], rcond=None)[0]
            amplitudes.append(float(np.hypot(*own)))
            sigmas.append(np.sqrt(2 * left / part.size))
    # Each arc counts by the noise that it has: what a turn leaves in one of them is no line of all.
    power, information = float(np.sum(powers / variances)), float(np.sum(1 / variances))
    size, error = np.sqrt(max(power - 2 * len(found), 0.0) / information), float(1 / np.sqrt(information))
    steady = _is_steady(np.array(amplitudes), np.array(sigmas)) and _in_all(powers, variances)
    # A window that keeps the motion out of a spectrum costs half of a tone's power; a fit has all of it, two numbers an arc.
    chance = FINENESS * samples * float(scipy.stats.chi2.sf(power, 2 * len(found))) if peak.isolated else 1.0
    p = max(min(peak.p_value, chance), IMPOSSIBLE)
    return Line(axis, f, float(size), error, p, waveform, peak.isolated, steady) if size > CLEAR_LINE * error else None


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


def _without_motion(x: Array, cycles: float) -> Array:
    """Samples without the body's motion that is slow beside a tone of so many cycles in a sample.

    A local polynomial over some cycles of the tone follows the motion, and of the tone next to nothing if its length is well
    chosen. A slew that begins gently is quiet to the eyes of the noise tests, but would pass for noise of the tone's amplitude.
    """
    counts = np.unique(np.round(np.array(AVERAGED_CYCLES) / cycles).astype(np.intp) // 2 * 2 + 1)
    kernels = [_smoothing(int(count)) for count in counts if DEGREE + 2 < count < x.size]
    if not kernels:
        return np.asarray(scipy.signal.detrend(x))
    kernel = min(kernels, key=lambda kernel: abs(_gain(kernel, cycles)))
    smooth = scipy.signal.oaconvolve(np.pad(x, kernel.size // 2, mode="edge"), kernel, mode="valid")
    return np.asarray((x - smooth) / (1 - _gain(kernel, cycles)))


def _smoothing(count: int) -> Array:
    """Weights of the samples in the middle of a local polynomial; in orthogonal polynomials, since windows may be long."""
    Q = np.linalg.qr(np.polynomial.legendre.legvander(np.linspace(-1, 1, count), DEGREE))[0]
    return np.asarray(Q @ Q[count // 2])


def _gain(kernel: Array, cycles: float) -> float:
    """Gain of a symmetric smoothing at a frequency in cycles a sample."""
    return float(kernel @ np.cos(2 * np.pi * cycles * (np.arange(kernel.size) - kernel.size // 2)))


def _calm(left: Array) -> Mask:
    """Samples in which nothing sudden is left of the motion."""
    spread = float(np.median(np.abs(left))) / 0.6745
    return np.asarray(np.abs(left) <= SUDDEN * spread)


def _transform(y: Array, t: Array, frequencies: Array) -> Array:
    """Fourier integral of y at some frequencies evenly spaced, by the chirp transform."""
    step = frequencies[1] - frequencies[0] if frequencies.size > 1 else 1.0
    dt = float(np.median(np.diff(t)))
    return np.asarray(_chirp(y.size, frequencies.size, step * dt, float(frequencies[0]) * dt)(y))


@lru_cache(maxsize=2)
def _chirp(count: int, trials: int, step: float, first: float) -> scipy.signal.CZT:
    """The chirp transform of so many samples, frequencies in cycles a sample; arcs are often of one length."""
    return scipy.signal.CZT(count, trials, np.exp(-2j * np.pi * step), np.exp(2j * np.pi * first))


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
