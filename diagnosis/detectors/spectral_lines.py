"""Lines in the spectrum of the samples: tones that are there, with one frequency, in all arcs of the samples.

Quiet arcs show lines of any frequency. Arcs in which the body moves show them above the band of its motion, where the level of
the spectrum is that of the white noise.

A line is a vibration only if the body does not move so. The samples cannot tell that; the attitude does
(`diagnosis.model.lines`). Here a line is found, its frequency and amplitude are estimated, and its waveform is kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage
import scipy.signal
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.report import AXES, IMPOSSIBLE, SampleReport, SampleTest, arcs, consecutive
from gyrocal.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FEWEST_CYCLES = 4.0  # of a line in the longest quiet arc: fewer are a trend
CLEAR_LINE = 5.0  # sigmas of its amplitude over all arcs, for a line to be a tone
SHORTEST = 256  # samples of a segment
HALVINGS = 6  # lengths of segments that are tried, from the longest arc down
LEVEL_BINS = 61  # of the spectrum, over which the level around a line is taken
MUCH_MORE = 1.3  # times as many samples as there are quiet ones, from which on those in motion are worth a look
MOST_LINES = 4  # of one axis
AVERAGED_CYCLES = (4, 4.5, 5, 5.5, 6, 7, 8, 9, 10)  # of a line, over which the motion beside it may be followed
SUDDEN = 6.0  # robust sigmas beyond which a sample does not count
DEGREE = 6  # of the polynomial that follows it
PART_CYCLES = 12  # of a line in a part of the samples in which its amplitude is compared
MOST_PARTS = 8  # of one arc
UNSTEADY = 0.1  # relative change of the amplitude that a tone may have
STEADY_P = 1e-3  # of the amplitudes being one
STRONG = 30.0  # times the white noise: what a motion has, and no chance
NEXT = 3.0  # factor from one frequency of a motion to the next
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
    steady : whether its amplitude is the same in all parts of the samples, as that of a tone is and that of a sway is not
    """

    axis: int
    frequency_hz: float
    amplitude: float
    sigma: float
    p_value: float
    waveform: Array
    isolated: bool
    steady: bool


def lines(report: SampleReport, recording: Recording, quiet: Mask, used: Mask) -> list[Line]:
    """The lines of each axis, the strongest first, in quiet samples and in all that can be used."""
    looks = [_Look(arcs(quiet & consecutive(recording, quiet)), beyond=False)]
    if np.count_nonzero(used) > MUCH_MORE * np.count_nonzero(quiet):
        looks.append(_Look(arcs(used & consecutive(recording, used)), beyond=True))
    looks = [look for look in looks if look.arcs]
    out: list[Line] = []
    if not looks:
        return out
    for axis in range(3):
        x = report.rates[:, axis].copy()
        for number in range(MOST_LINES):
            peak, found = _strongest(x, looks, recording.gyro.sample_s)
            p = peak.p_value
            if number == 0:
                report.tests.append(
                    SampleTest(
                        "strongest_line", AXES[axis], float(np.rad2deg(peak.amplitude)), 0.0, p, None,
                        f"strongest line at {peak.frequency_hz:.4f} Hz, {np.rad2deg(peak.amplitude):.3g} deg/s",
                    )
                )  # fmt: skip
            # Rounding a slow motion makes lines of its own.
            if p >= report.line_p or report.lattice[axis]:
                break
            line = _tone(x, recording, axis, peak, found)
            if line is None:
                break
            out.append(line)
            x = x - line.waveform
    return out


@dataclass(frozen=True)
class _Peak:
    """The strongest line of a spectrum."""

    p_value: float
    frequency_hz: float
    amplitude: float
    isolated: bool


@dataclass(frozen=True)
class _Look:
    """Arcs of samples, and whether only what is beyond the band of the body's motion is looked at."""

    arcs: list[tuple[int, int]]
    beyond: bool


def _strongest(x: Array, looks: list[_Look], sample_s: float) -> tuple[_Peak, list[tuple[int, int]]]:
    """The strongest line of spectra averaged over segments, of the arcs and the length of segments that show it best.

    Long segments gather the power of a tone in one bin, short ones use more of the arcs.
    """
    peaks = []
    for look in looks:
        longest = max(high - low for low, high in look.arcs)
        for length in sorted({max(longest >> k, SHORTEST) for k in range(HALVINGS)}):
            peaks.append((_peak(x, look, length, sample_s), look.arcs))
    best, found = min(peaks, key=lambda pair: pair[0].p_value)
    return replace(best, p_value=min(1.0, best.p_value * len(peaks))), found


def _peak(x: Array, look: _Look, n: int, sample_s: float) -> _Peak:
    """The strongest line of the spectrum averaged over all segments of n samples."""
    segments = [x[start : start + n] for low, high in look.arcs for start in range(low, high - n + 1, n)]
    # A window keeps the body's slow motion out of the frequencies looked at; where it moves, one of far lower side lobes.
    window = scipy.signal.windows.blackmanharris(n, sym=False) if look.beyond else scipy.signal.windows.hann(n, sym=False)
    spectra = np.abs(np.fft.rfft(scipy.signal.detrend(np.array(segments), axis=1) * window, axis=1)) ** 2 / np.sum(window**2)
    spectrum = spectra.mean(axis=0)
    frequency = np.fft.rfftfreq(n, sample_s)
    count = len(segments)
    lowest = FEWEST_CYCLES / (n * sample_s)
    # Against the level around it, so that coloured noise is no line. The median of a mean of `count` exponentials:
    median = float(scipy.stats.gamma.median(count)) / count
    around = scipy.ndimage.median_filter(spectrum, LEVEL_BINS, mode="nearest") / median
    white = float(np.median(spectrum[spectrum.size // 2 :])) / median
    if look.beyond:
        lowest = max([lowest, _edge(frequency[spectrum > STRONG * white]), *frequency[around > ISOLATED * white]])
    allowed = np.flatnonzero((frequency > lowest) & (frequency < frequency[-1] * (1 - 1 / n)))
    if allowed.size < 20:
        return _Peak(1.0, 0.0, 0.0, False)
    power = spectrum[allowed] / np.maximum(np.maximum(around, 0.5 * white)[allowed], 1e-300)
    k = int(allowed[np.argmax(power)])
    p = min(1.0, allowed.size * float(scipy.stats.gamma.sf(count * float(power.max()), count)))
    amplitude = 2 * np.sqrt(spectrum[k] * np.sum(window**2)) / np.sum(window)
    beside = spectrum[max(k - LEVEL_BINS // 2, 0) : k + LEVEL_BINS // 2]
    isolated = float(np.median(beside)) / median < ISOLATED * white
    return _Peak(max(p, IMPOSSIBLE), float(frequency[k]), float(amplitude), isolated)


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
    power = np.zeros(trial.size)
    for low, high in found:
        y = _without_motion(x[low:high], peak.frequency_hz * sample)
        y = np.where(_calm(y), y, 0.0)
        power += np.abs(_transform(y, recording.gyro.t_s[low:high], trial)) ** 2 / y.size
    f = float(trial[int(np.argmax(power))])
    squares, samples, noise, waveform = 0.0, 0, 0.0, np.zeros_like(x)
    amplitudes, sigmas = [], []
    for low, high in found:
        angle = 2 * np.pi * f * recording.gyro.t_s[low:high]
        waves = np.column_stack([np.cos(angle), np.sin(angle)])
        level = _without_motion(x[low:high], f * sample)
        fitted = np.linalg.lstsq(waves, level, rcond=None)[0]
        calm = _calm(level - waves @ fitted)
        fitted = np.linalg.lstsq(waves[calm], level[calm], rcond=None)[0]
        waveform[low:high] = waves @ fitted
        waves, level = waves[calm], level[calm]
        left = float(np.mean((level - waves @ fitted) ** 2))
        squares += (float(fitted @ fitted) - 4 * left / level.size) * level.size
        noise += left * level.size
        samples += level.size
        count = int(np.clip(level.size * sample * f // PART_CYCLES, 1, MOST_PARTS))
        for part in np.array_split(np.arange(level.size), count):
            own = np.linalg.lstsq(waves[part], level[part], rcond=None)[0]
            amplitudes.append(float(np.hypot(*own)))
            sigmas.append(np.sqrt(2 * left / part.size))
    size = float(np.sqrt(max(squares / samples, 0.0)))
    error = float(np.sqrt(2 * noise / samples / samples))
    steady = _is_steady(np.array(amplitudes), np.array(sigmas))
    return Line(axis, f, size, error, peak.p_value, waveform, peak.isolated, steady) if size > CLEAR_LINE * error else None


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
    return np.asarray(
        scipy.signal.czt(y, frequencies.size, np.exp(-2j * np.pi * step * dt), np.exp(2j * np.pi * frequencies[0] * dt))
    )


def _is_steady(amplitudes: Array, sigmas: Array) -> bool:
    """Whether amplitudes of several parts are one, within their noise and a tenth of it."""
    if amplitudes.size < 2:
        return False
    weights = 1 / sigmas**2
    mean = float(weights @ amplitudes / weights.sum())
    chi2 = float(np.sum((amplitudes - mean) ** 2 / (sigmas**2 + (UNSTEADY * mean) ** 2)))
    return bool(scipy.stats.chi2.sf(chi2, amplitudes.size - 1) > STEADY_P)
