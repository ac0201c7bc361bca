"""Lines in the spectrum of the samples: sinusoids with one frequency in all arcs of the samples.

Quiet arcs show lines of any frequency. Arcs in which the body moves show those that stand far above all slower motion.

A line is a vibration only if the body does not move so, which the samples cannot decide. It is a finding with its frequency and
amplitude, and its waveform is kept, so that the noise can be estimated without it.

A sinusoid is fitted beside the motion of the body. A local polynomial follows the motion that is slow beside the sinusoid. The
same filter that subtracts it from the readings is applied to the waves that are fitted. Each arc has its own phase.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
import scipy.fft
import scipy.ndimage
import scipy.special

from diagnosis.arrays import AXES
from diagnosis.detectors.sample_report import IMPOSSIBLE, Findings, Line, SampleTest, Stream
from diagnosis.sinusoids import (
    Arcs,
    Piece,
    SinusoidFit,
    compute_log_p,
    compute_power,
    compute_segment_spectrum,
    convolve,
    find_frequency,
    fit_sinusoid,
    make_waves,
    remove_line,
)
from gyrocal.arrays import Array, Mask
from gyrocal.recording import Recording

FEWEST_CYCLES = 4.0  # of a line in a segment; fewer are a trend
P_OF_PEAK = 0.01  # p-value of a peak below which a sinusoid is fitted; the fit decides, with all of its power
# of an axis in one look: a bound of the time
MOST_LINES = 4
MOST_PEAKS = 8
STRONG = 30.0  # power over the white noise that a motion has and chance has not (e⁻³⁰)
# power over that of motion beside it and below, down to a third of the frequency, above which a line stands out
OUTSTANDING = 8.0
FEWEST_BELOW = 40  # bins below a strong line in samples of a moving body; fewer do not show that it stands out
JOLT = 15.0  # medians of the second differences, ten sigmas of noise, above which the rate jumps
MOST_JOLTS = 0.02  # share of the samples above which the body moves fast, and nothing is left out
SHORTEST = 256  # samples of a segment
HALVINGS = 6  # lengths of segments that are tried, from the longest arc down
LEVEL_BINS = 61  # of the spectrum, over which the level around a line is taken
LOBE = 4  # bins on either side of a line, over which its peak spreads
FEWEST_BINS = 20  # of a spectrum in which a line is looked for

# lengths of the local polynomial, in cycles; the one that leaves the sinusoid whole is taken
SMOOTHING_CYCLES = (4, 4.5, 5, 5.5, 6, 7, 8, 9, 10)
DEGREE = 6  # of the polynomial
SUDDEN = 6.0  # robust sigmas beyond which a sample does not count: what jolts leave
FREQUENCIES_PER_SAMPLE = 2.0  # independent frequencies of a fit; oversampling finds twice the Fourier frequencies
CLEAR = 5.0  # sigmas of the amplitude below which there is no line
# resolutions of an arc from the sinusoid, at which the level of the noise is taken
BESIDE = tuple(range(3, 11))
NEARBY = 0.25  # share of the frequency within which that is


@dataclass(frozen=True)
class Peak:
    """The strongest line of a spectrum, and the half width of its peak in it."""

    p_value: float = 1.0
    frequency_hz: float = 0.0
    amplitude: float = 0.0
    width_hz: float = 0.0


@dataclass(frozen=True)
class Look:
    """Arcs of samples, and whether the body may move in them."""

    arcs: Arcs
    moving: bool


def find_lines(stream: Stream, quiet: Mask, lattice: Mask, line_p: float) -> tuple[tuple[Line, ...], Findings]:
    """Find the lines of each axis: first in all samples that can be used, then in the quiet ones (n,).

    The readings of some gyros (3,) lie on a coarse lattice and have no line; the p-value of a line is below `line_p`.
    """
    rates, recording = stream.rates, stream.recording
    smooth = stream.used & ~find_jolts(rates, stream.used)
    looks = [Look(stream.find_arcs(smooth), moving=True), Look(stream.find_arcs(quiet), moving=False)]
    all_lines: list[Line] = []
    tests = []
    for axis in range(rates.shape[1]):
        # Constant readings of a clipped or dead gyro have no noise to compare a line with.
        usable = [replace(look, arcs=[arc for arc in look.arcs if np.ptp(rates[slice(*arc), axis]) > 0]) for look in looks]
        searched = [look for look in usable if look.arcs]
        lines, test = _find_lines_of_axis(rates[:, axis], searched, recording, axis, bool(lattice[axis]), line_p)
        all_lines += lines
        tests.append(test)
    return tuple(all_lines), Findings(tuple(tests))


def find_jolts(rates: Array, used: Mask) -> Mask:
    """Mark the samples (n,) beside which a rate jumps or breaks off; none where most do, as in fast motion.

    The spectrum of an arc that holds such a moment is full of waves that are neither motion nor noise.
    """
    if not used.any():
        return np.zeros(used.size, dtype=bool)
    second_differences = np.zeros_like(rates)
    second_differences[1:-1] = np.abs(np.diff(rates, 2, axis=0))
    median = np.median(second_differences[used], axis=0)
    jolts = scipy.ndimage.binary_dilation((second_differences > JOLT * median).any(axis=1), iterations=2)
    return np.asarray(jolts) if jolts[used].mean() < MOST_JOLTS else np.zeros_like(jolts)


def _find_lines_of_axis(
    rates: Array, looks: list[Look], recording: Recording, axis: int, lattice: bool, line_p: float
) -> tuple[list[Line], SampleTest]:
    """Find the lines of an axis and its strongest peak; each look has its own limit of lines, since slow motions have many."""
    x, lines, strongest = rates.copy(), list[tuple[Line, float]](), Peak()
    for look in looks:
        limit = len(lines) + MOST_LINES
        for number in range(MOST_PEAKS):
            peak = find_peak(x, look, recording.gyro.sample_s)
            if number == 0 and peak.p_value <= strongest.p_value:
                strongest = peak
            # Rounding a slow motion makes lines of its own.
            if peak.p_value >= P_OF_PEAK or lattice or len(lines) == limit:
                break
            line = fit_line(x, recording, axis, peak.frequency_hz, peak.width_hz, look.arcs)
            if line is None or line.p_value >= line_p:
                break
            x = x - line.waveform
            lines = _add_line(lines, line, peak.width_hz)
    p = min(1.0, strongest.p_value * max(len(looks), 1))
    size = np.rad2deg(strongest.amplitude)
    text = f"strongest line at {strongest.frequency_hz:.4f} Hz, {size:.3g} deg/s; the body may move so"
    test = SampleTest("strongest_line", AXES[axis], float(np.rad2deg(strongest.amplitude)), 0.0, p, None, text)
    return [line for line, _ in lines], test


def _add_line(lines: list[tuple[Line, float]], line: Line, width_hz: float) -> list[tuple[Line, float]]:
    """Add a line to lines and their widths; within the width of an earlier line it is that line's residual and adds to it."""
    for place, (earlier, width) in enumerate(lines):
        if abs(earlier.frequency_hz - line.frequency_hz) < width:
            summed = replace(earlier, waveform=earlier.waveform + line.waveform)
            return [*lines[:place], (summed, width), *lines[place + 1 :]]
    return [*lines, (line, width_hz)]


def find_peak(x: Array, look: Look, sample_s: float) -> Peak:
    """Find the strongest line of spectra averaged over segments, of the length of segments that shows it best.

    Long segments gather the power of a sinusoid in one bin, short ones use more of the arcs.
    """
    longest = max(high - low for low, high in look.arcs)
    lengths = {scipy.fft.prev_fast_len(max(longest >> k, SHORTEST), real=True) for k in range(HALVINGS)}
    peaks = list(map(partial(_find_peak_in_segments, x, look, sample_s), sorted(lengths)))
    best = min(peaks, key=lambda peak: peak.p_value)
    return replace(best, p_value=min(1.0, best.p_value * len(peaks)))


def _find_peak_in_segments(x: Array, look: Look, sample_s: float, length: int) -> Peak:
    """Find the strongest line of the spectrum averaged over all segments of so many samples."""
    # A window of far lower side lobes keeps the body's motion out of other frequencies, where it moves.
    spectrum = compute_segment_spectrum(x, look.arcs, length, sample_s, "blackmanharris" if look.moving else "hann")
    first = int(FEWEST_CYCLES) + 1
    if spectrum is None or spectrum.power.size - 1 - first < FEWEST_BINS:
        return Peak()
    power, around = spectrum.power, spectrum.compute_level(LEVEL_BINS)
    white = float(np.median(around[around.size // 2 :]))
    # Of few bins, the level around may be low by chance; the white noise is that of many.
    level = np.maximum(np.maximum(around, white), 1e-300)
    ratio = power / level
    tops = first + np.flatnonzero((power[first:-1] >= power[first - 1 : -2]) & (power[first:-1] >= power[first + 1 :]))
    for k in tops[np.argsort(-ratio[tops])]:
        slower, faster = power[int(k / 3) : k - LOBE], power[k + LOBE + 1 : k + LEVEL_BINS]
        motion = max(float(slower.max(initial=0.0)), float(faster.max(initial=0.0))) if look.moving else 0.0
        has_motion = motion > STRONG * white
        is_slow = look.moving and k < FEWEST_BELOW and power[k] > STRONG * white
        if is_slow or (has_motion and power[k] < OUTSTANDING * motion):
            continue
        log_p = float(compute_log_p(ratio[k], spectrum.count[0], power.size - 1 - first))
        p = max(float(np.exp(log_p)), IMPOSSIBLE)
        amplitude = spectrum.amplitude_of_one * float(np.sqrt(power[k]))
        width = (LOBE if look.moving else 2) * float(spectrum.frequency_hz[1])
        return Peak(p, float(spectrum.frequency_hz[k]), amplitude, width)
    return Peak()


def fit_line(x: Array, recording: Recording, axis: int, centre_hz: float, width_hz: float, arcs: Arcs) -> Line | None:
    """Fit a sinusoid to the readings (n,) of a gyro, rad/s, near a peak of their spectrum; None where it is not clear."""
    sample_s, t_s = recording.gyro.sample_s, recording.gyro.t_s
    span_s = max(high - low for low, high in arcs) * sample_s
    observe = partial(remove_motion, cycles=centre_hz * sample_s)
    pieces = [Piece(t_s[low:high], observe(x[low:high]), observe) for low, high in arcs]
    without_jolts = [replace(piece, data=np.where(_is_calm(piece.data), piece.data, 0.0)) for piece in pieces]
    f = find_frequency(without_jolts, centre_hz, max(width_hz, 1.5 / span_s), sample_s)
    first = fit_sinusoid(pieces, f, 0.0, steps=0)
    calm = [_is_calm(residual) for residual in first.residuals]
    pieces = [piece.select(rows) for piece, rows in zip(pieces, calm, strict=True)]
    fit = fit_sinusoid(pieces, f, 0.2 / span_s, steps=2)  # the frequency is found to a twentieth of the resolution
    size, sigma = fit.size
    if not size > CLEAR * sigma:
        return None
    samples = sum(piece.data.size for piece in pieces)
    level = _compute_level([piece.t_s[rows] for piece, rows in zip(pieces, calm, strict=True)], fit)
    chance = scipy.special.chdtrc(2 * len(pieces), fit.chi2 / level)
    p = float(np.clip(FREQUENCIES_PER_SAMPLE * samples * chance, IMPOSSIBLE, 1.0))
    waveform = np.zeros(t_s.size)
    for (low, high), amplitudes in zip(arcs, fit.amplitudes, strict=True):
        waveform[low:high] = make_waves(fit.frequency_hz, t_s[low:high]) @ amplitudes
    return Line(axis, fit.frequency_hz, size, sigma, p, waveform)


def remove_motion(x: Array, cycles: float) -> Array:
    """Remove from series (n,) or (n, k) the motion that is slow beside a sinusoid of so many cycles in a sample.

    A slew that begins gently is quiet to the noise tests, but would pass for noise of the sinusoid's amplitude.
    """
    kernel, gain = _choose_smoothing(cycles, len(x))
    if kernel is None:
        return remove_line(x.T).T
    count = kernel.size
    ends = np.clip(np.arange(-(count // 2), len(x) + count // 2), 0, len(x) - 1)
    smooth = convolve(x[ends].T, kernel)[..., count - 1 : ends.size].T
    return np.asarray((x - smooth) / (1 - gain))


@lru_cache(maxsize=64)
def _choose_smoothing(cycles: float, size: int) -> tuple[Array | None, float]:
    """Choose the weights of a local polynomial that least attenuates a sinusoid, and its gain; None where an arc is too short.

    The weights come from orthogonal polynomials, since windows may be long.
    """
    counts = np.unique(np.round(np.array(SMOOTHING_CYCLES) / cycles).astype(np.intp) // 2 * 2 + 1)
    best, least = None, np.inf
    for count in counts[(counts > DEGREE + 2) & (counts < size)]:
        Q = np.linalg.qr(np.polynomial.legendre.legvander(np.linspace(-1, 1, count), DEGREE))[0]
        kernel = Q @ Q[count // 2]
        gain = float(kernel @ np.cos(2 * np.pi * cycles * (np.arange(count) - count // 2)))
        if abs(gain) < abs(least):
            best, least = kernel, gain
    return best, least


def _is_calm(residual: Array) -> Mask:
    """Mark the samples whose residual holds no jolt of the motion."""
    spread = float(np.median(np.abs(residual))) / 0.6745
    return np.asarray(np.abs(residual) <= SUDDEN * spread)


def _compute_level(times_s: Sequence[Array], fit: SinusoidFit) -> float:
    """Compute the noise power around the sinusoid over that of all frequencies, at least one: a hump of the noise is no line.

    The median of n powers of noise is ln 2, with the error 1/√n.
    """
    powers = [np.empty(0)]
    for t_s, residual in zip(times_s, fit.residuals, strict=True):
        span_s = max(float(np.ptp(t_s)), 1e-300)
        offsets_hz = np.array([k for k in BESIDE if k < NEARBY * fit.frequency_hz * span_s]) / span_s
        frequencies_hz = np.concatenate([fit.frequency_hz - offsets_hz, fit.frequency_hz + offsets_hz])
        powers.append(compute_power(t_s, residual[:, None], frequencies_hz)[:, 0] / max(float(np.mean(residual**2)), 1e-300))
    all_powers = np.concatenate(powers)
    return (
        max(1.0, (float(np.median(all_powers)) - 1 / np.sqrt(all_powers.size)) / float(np.log(2))) if all_powers.size else 1.0
    )
