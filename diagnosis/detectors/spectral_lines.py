"""Lines in the spectrum of the samples: tones that are there, with one frequency, in all arcs of the samples.

Quiet arcs show lines of any frequency. Arcs in which the body moves show them above the band of its motion, where the level of
the spectrum is that of the white noise.

A line is a vibration only if the body does not move so. The samples cannot tell that; the attitude does
(`diagnosis.model.lines`). Here a line is found, its frequency and amplitude are estimated, and its waveform is kept.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy.fft
import scipy.ndimage
import scipy.signal
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.report import AXES, IMPOSSIBLE, SampleReport, SampleTest, Tell, arcs, consecutive, silent
from diagnosis.detectors.spectral_tones import SHORTEST, Line, Peak, fitted_tone
from gyrocal.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

AT_ONCE = 1 << 20  # samples of segments that are transformed together
FEWEST_CYCLES = 4.0  # of a line in the longest quiet arc: fewer are a trend
WORTH_A_FIT = 0.01  # p-value of a peak, from which on a tone is fitted to see whether it is one
HALVINGS = 6  # lengths of segments that are tried, from the longest arc down
LEVEL_BINS = 61  # of the spectrum, over which the level around a line is taken
MANY = 8  # segments side by side, from which on overlapping ones are averaged too
MOST_LINES = 4  # of one axis in one look
MOST_PEAKS = 8  # that are tried for them; what a fit leaves of a line is a peak again
STRONG = 30.0  # times the white noise: what a motion has, and no chance
LOBE = 4  # bins on either side of a line, over which its peak spreads
OUTSTANDING = 8.0  # times all that leads up to it, from which on a line stands out
FEWEST_BELOW = 40  # bins below a line that stands out of what leads up to it
NEXT = 3.0  # factor from one frequency of a motion to the next
JOLT = 15.0  # medians of the second differences, ten sigmas of noise, from which on the rate jumps
MOST_JOLTS = 0.02  # share of the samples, above which the body moves fast
MARGIN = 3.0  # on the highest of them, up to which a line belongs to the motion
ISOLATED = 2.0  # level around a line over that of the white noise, below which the body shows no other motion there


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
            line = fitted_tone(x, recording, axis, peak, look.arcs)
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


NO_PEAK = Peak(1.0, 0.0, 0.0, False, 0.0)


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


def _strongest(x: Array, look: _Look, sample_s: float, tell: Callable[[], None] = lambda: None) -> Peak:
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
        spectra = np.abs(scipy.fft.rfft(_without_line(segments) * window, axis=1)) ** 2 / np.sum(window**2)
        spectrum += spectra.sum(axis=0) / places.size
    return spectrum, window, _independent([own.size for own in starts], window, step)


def _without_line(segments: Array) -> Array:
    """Segments (k, n) less the straight line that fits each best.

    It is scipy's ``detrend``, which asks a general solver for what two sums give, and takes longer than all spectra.
    """
    t = np.arange(segments.shape[1]) - 0.5 * (segments.shape[1] - 1)
    slope = segments @ t / (t @ t)
    return np.asarray(segments - segments.mean(axis=1, keepdims=True) - slope[:, None] * t)


def _peak(x: Array, look: _Look, n: int, sample_s: float) -> Peak:
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
    return Peak(max(p, IMPOSSIBLE), float(frequency[k]), float(amplitude), isolated, width)


def _outstanding(x: Array, look: _Look, sample_s: float) -> Peak:
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
                best = Peak(p, f, float(amplitude), bool(below.max() < STRONG * white), LOBE / (n * sample_s))
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
