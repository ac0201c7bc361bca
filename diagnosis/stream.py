"""Tests that see every gyro sample: lattice, repeats, clipping, outliers, noise level and colour, lines.

They come before the attitude tests, since one clipped or repeated stretch spoils those. Under M0 a reading is a smooth motion
plus white noise with σ = ARW/√Δt and is never exactly the same twice. The motion is taken out by a local parabola; only
*quiet* samples count, where the mean does not change visibly over twenty samples on either side.

Every test states its p-value under M0; the ones that need an exact coincidence of floating-point numbers (lattice, repeats,
clipping) cannot happen at all under M0 and are given the smallest p.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.ndimage
import scipy.signal
import scipy.special
import scipy.stats
from numpy.typing import NDArray

from diagnosis.filling import filled, runs
from diagnosis.lattice import ODDS, Kind, lattice_step, sweep_odds, undone
from diagnosis.repeats import IMPOSSIBLE, repeats
from gyrocal.recording import Recording
from simulator.effects.recorded import interval_slices
from simulator.effects.smoothing import noise_level, smoothed

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

AXES = "xyz"
HALF = 20  # samples on either side of one in the test for quiet
MOVING = 20.0  # sigmas of that change that count as visible; a slew's are hundreds, those of a vibration a few
PARABOLA = 9  # samples of the local parabola
COARSE = 0.05  # a lattice finer than this share of the noise is the number format, not the gyro
EVENT_P = 1e-5  # p below which an event test names its effect
LOWEST_LINE = 0.04  # Hz: below it, lines are the body's own motion
LINE_P = 1e-8  # of a line to be a vibration: the level around it is itself estimated
CLEAR_TONE = 5.0  # sigmas of its amplitude over all stretches, for a line to be a tone
OUTLIER = 6.0  # noise sigmas; one sample in 5e8 under M0
FEWEST_CLIPPED = 5
FEWEST_PLATEAU = 20  # samples of a clipped stretch on a lattice
PLATEAU_P = 1e-8  # chance of a steady rate to stand still that long
SMOOTH_S = 20.0  # s, longest window of the smoothing


@dataclass(frozen=True)
class StreamTest:
    """One statistic.

    Attributes
    ----------
    statistic, axis : which
    value, expected : what was found, and what M0 gives
    p_value : under M0, not corrected
    effect : the effect it speaks for, or None
    text : a sentence
    """

    statistic: str
    axis: str | None
    value: float
    expected: float
    p_value: float
    effect: str | None
    text: str


@dataclass(frozen=True)
class StreamCause:
    """An effect seen in the samples."""

    effect: str
    axis: str | None
    size: float
    unit: str
    sigma: float
    parameters: dict[str, float | str]
    p_value: float


@dataclass
class StreamReport:
    """What the samples show, and the stream with it repaired as far as that goes.

    Attributes
    ----------
    tests, causes : all statistics, and the effects they establish
    rates : (n, 3) repaired raw rates, rad/s
    density : (n, 3) noise density of each repaired sample, rad²/s
    clipped, filled : (n,) samples that do not show the rate, and those that something was put in place of
    noise_factor : (3,) actual white noise relative to the stated one
    noise : (3,) noise of a sample as it shows, rad/s
    smooth : (n, 3) repaired raw rates without their noise: what effects follow, since a regressor with the noise of the
        residuals in it would explain that noise
    hidden : (3,) whether a coarse lattice hides the gyro's slow motion for long
    lattice : (3,) whether readings lie on one that is coarser than the noise
    undecided : readings lie on a lattice, and the samples do not say whether rounded or cut
    """

    tests: list[StreamTest]
    causes: list[StreamCause]
    rates: Array
    density: Array
    clipped: Mask
    filled: Mask
    noise_factor: Array = field(default_factory=lambda: np.ones(3))
    noise: Array = field(default_factory=lambda: np.zeros(3))
    smooth: Array = field(default_factory=lambda: np.empty((0, 3)))
    undecided: bool = False
    hidden: Mask = field(default_factory=lambda: np.zeros(3, dtype=bool))
    lattice: Mask = field(default_factory=lambda: np.zeros(3, dtype=bool))


def examine(recording: Recording, lattice: Kind | None = None) -> StreamReport:
    """All stream tests of a recording, and its repaired stream.

    Parameters
    ----------
    recording : what was recorded
    lattice : how readings on a lattice came there; by default as a sweep through zero shows, rounded if there is none
    """
    gyro = recording.gyro
    sigma = gyro.arw / np.sqrt(gyro.sample_s)
    none = np.zeros(gyro.t_s.size, dtype=bool)
    report = StreamReport([], [], gyro.rates.copy(), np.full(gyro.rates.shape, gyro.arw**2), none, none.copy())
    used = inside(recording)
    steps = np.array([lattice_step(gyro.rates[used, axis]) for axis in range(3)])
    coarse = steps > COARSE * sigma
    odds = _cut_odds(gyro.rates[used], steps, coarse)
    report.undecided = bool(coarse.any()) and lattice is None and float(np.abs(odds).max()) < ODDS
    cut = coarse & (odds > ODDS if lattice is None else lattice == "cut")
    report.lattice = steps > sigma
    _quantization(report, steps, coarse, cut)
    _stale(report, recording, used, coarse)
    _saturation(report, recording, used, coarse, steps, sigma)
    if sigma > 0:
        local = _local_noise(report.rates, sigma, coarse, steps)
        quiet = used & _quiet(report.rates, local)
        _spikes(report, recording, quiet, local, coarse)
        _lines(report, recording, quiet)
        _noise(report, recording, quiet, sigma, steps, coarse, cut)
        report.noise = sigma * report.noise_factor
        _zero_mass(report, recording, used, coarse)
        _off_the_lattice(report, recording, steps, coarse, cut, sigma)
    report.smooth = _smooth(report.rates, recording, sigma)
    return report


def _smooth(rates: Array, recording: Recording, sigma: float) -> Array:
    out = rates.copy()
    for part in interval_slices(recording):
        out[part] = smoothed(rates[part], recording.gyro.sample_s, SMOOTH_S, noise_level(rates[part], sigma))
    return out


def _cut_odds(rates: Array, steps: Array, coarse: Mask) -> Array:
    """(3,) log odds of cut against rounded readings; axes with one step have one converter, and count together."""
    odds = np.array([sweep_odds(rates[:, k], steps[k]) if coarse[k] else 0.0 for k in range(3)])
    alike = coarse & (np.abs(steps - np.median(steps[coarse])) < 0.01 * np.median(steps[coarse])) if coarse.any() else coarse
    return np.where(alike, odds[alike].sum(), odds)


def inside(recording: Recording) -> Mask:
    """Samples that belong to an interval."""
    t = recording.gyro.t_s
    out = np.zeros(t.size, dtype=bool)
    for interval in recording.intervals:
        low, high = np.searchsorted(t, [interval.start_s - 1e-6, interval.stop_s - 1e-6])
        out[low:high] = True
    return out


def _quantization(report: StreamReport, steps: Array, coarse: Mask, cut: Mask) -> None:
    for axis in range(3):
        found = bool(coarse[axis])
        p = IMPOSSIBLE if found else 1.0
        text = (
            f"all readings are multiples of {np.rad2deg(steps[axis]):.4g} deg/s"
            if found
            else "readings lie on no lattice that matters beside the noise"
        )
        report.tests.append(
            StreamTest("lattice_step", AXES[axis], float(np.rad2deg(steps[axis])), 0.0, p, "rate_quantization", text)
        )
    if not coarse.any():
        return
    for effect, axes in (("rate_quantization", coarse & ~cut), ("rate_truncation", coarse & cut)):
        if not axes.any():
            continue
        found_steps = steps[axes]
        common = bool(axes.all()) and np.ptp(found_steps) < 0.01 * found_steps.mean()
        groups = [(None, float(found_steps.mean()))] if common else [(AXES[k], float(steps[k])) for k in np.flatnonzero(axes)]
        for axis_name, step in groups:
            size = float(np.rad2deg(step))
            report.causes.append(StreamCause(effect, axis_name, size, "deg/s", 1e-6 * size, {}, IMPOSSIBLE))


def _consecutive(recording: Recording, used: Mask) -> Mask:
    """Samples that directly follow another of the same interval."""
    t = recording.gyro.t_s
    out = np.zeros(t.size, dtype=bool)
    out[1:] = (np.diff(t) < 1.5 * recording.gyro.sample_s) & used[1:] & used[:-1]
    return out


def _stale(report: StreamReport, recording: Recording, used: Mask, coarse: Mask) -> None:
    """Samples that repeat the one before on all axes at once, beyond what a coarse lattice makes."""
    rates = recording.gyro.rates
    equal = np.zeros(rates.shape, dtype=bool)
    equal[1:] = rates[1:] == rates[:-1]
    clipped = (np.abs(rates) >= np.abs(rates[used]).max(axis=0) * (1 - 1e-12)).any(axis=1)
    found = repeats(equal, _consecutive(recording, used) & ~clipped, coarse, EVENT_P)
    if found is None:
        return
    report.tests.append(
        StreamTest(
            "repeated_share", None, found.count / found.samples, found.expected / found.samples, found.p_value,
            "stale_samples", f"{found.count} of {found.samples} samples repeat the one before on all axes",
        )
    )  # fmt: skip
    if found.p_value >= EVENT_P:
        return
    parameters: dict[str, float | str] = {"fraction": found.fraction}
    report.causes.append(StreamCause("stale_samples", None, found.size, "samples", found.sigma, parameters, found.p_value))
    _fill(report, recording, found.mask)


def _fill(report: StreamReport, recording: Recording, bad: Mask) -> None:
    """Bridge bad samples; what they integrate to is then uncertain."""
    gyro = recording.gyro
    report.rates, factor, density = filled(gyro.t_s, report.rates, bad, gyro.sample_s)
    report.density = report.density * factor[:, None] + density
    report.filled |= bad


def _saturation(report: StreamReport, recording: Recording, used: Mask, coarse: Mask, steps: Array, sigma: float) -> None:
    rates = recording.gyro.rates
    # A largest reading that telemetry repeats stands still on all axes; of a clipped gyro the others go on.
    held = np.zeros(len(rates), dtype=bool)
    held[1:] = (rates[1:] == rates[:-1]).all(axis=1)
    for axis in range(3):
        x = rates[used, axis]
        largest = float(np.abs(x).max())
        at = np.abs(x) >= largest * (1 - 1e-12)
        count = int((at & ~held[used]).sum())
        found = count >= FEWEST_CLIPPED and (
            not coarse[axis] or _is_plateau(at, float(steps[axis]) / sigma if sigma else np.inf)
        )
        report.tests.append(
            StreamTest(
                "clipped_samples", AXES[axis], count, 1.0, IMPOSSIBLE if found else 1.0, "rate_saturation",
                f"{count} samples read exactly the largest rate, {np.rad2deg(largest):.4g} deg/s",
            )
        )  # fmt: skip
        if not found:
            continue
        size = float(np.rad2deg(largest))
        report.causes.append(StreamCause("rate_saturation", AXES[axis], size, "deg/s", 1e-6 * size, {}, IMPOSSIBLE))
        clipped = used & (np.abs(rates[:, axis]) >= largest * (1 - 1e-12))
        report.clipped |= clipped


def _is_plateau(at: Mask, step: float) -> bool:
    """Whether the largest values stand in one solid block, as a noisy reading on a lattice of so many sigmas cannot.

    A reading stays on its lattice point at best with the probability that noise is less than half a step.
    """
    longest = max(high - low for low, high in runs(at))
    stays = float(scipy.special.erf(0.5 * step / np.sqrt(2)))
    chance = np.log(at.size) + longest * np.log(stays) if stays < 1 else 0.0
    return longest >= FEWEST_PLATEAU and chance < np.log(PLATEAU_P)


def _zero_mass(report: StreamReport, recording: Recording, used: Mask, coarse: Mask) -> None:
    """Samples that read exactly zero on no lattice: a dead zone behind the noise."""
    for axis in np.flatnonzero(~coarse):
        x = recording.gyro.rates[used, axis]
        count = int(np.sum(x == 0.0))
        other = np.sort(np.abs(x[x != 0.0]))
        # Zeros beside readings that are as good as zero leave no zone.
        wide = other.size > 30 and other[:3].mean() > 0.01 * float(report.noise[axis])
        p = IMPOSSIBLE if count >= 3 and wide else 1.0
        report.tests.append(
            StreamTest("zero_samples", AXES[axis], count, 0.0, p, "rate_deadzone", f"{count} samples read exactly zero")
        )
        if p < EVENT_P:
            smallest = float(np.rad2deg(other[:3].mean()))
            spacing = float(np.rad2deg(other[3:30].mean())) - smallest
            report.causes.append(
                StreamCause("rate_deadzone", AXES[axis], smallest, "deg/s", max(spacing, 1e-3 * smallest), {}, IMPOSSIBLE)
            )


def _local_noise(rates: Array, sigma: float, coarse: Mask, steps: Array) -> Array:
    """(3,) robust noise of a sample, at least what is stated."""
    second = np.diff(rates, 2, axis=0)
    robust = np.median(np.abs(second), axis=0) / 0.6745 / np.sqrt(6)
    floor = np.where(coarse, np.sqrt(sigma**2 + steps**2 / 12), 0.0)
    return np.asarray(np.maximum(np.where(robust > 0, robust, sigma), floor))


def _quiet(rates: Array, noise: Array) -> Mask:
    """Samples around which the mean rate does not visibly change on any axis."""
    ahead = scipy.ndimage.uniform_filter1d(rates, HALF, axis=0, origin=-HALF // 2, mode="nearest")
    behind = scipy.ndimage.uniform_filter1d(rates, HALF, axis=0, origin=HALF // 2 - 1, mode="nearest")
    change = np.abs(ahead - behind) / (noise * np.sqrt(2 / HALF))
    moving = (change > MOVING).any(axis=1)
    return ~scipy.ndimage.binary_dilation(moving, iterations=HALF)


def _highpass(x: Array) -> Array:
    """Reading minus the local parabola through its neighbours but not itself, scaled to the noise of a sample."""
    kernel = scipy.signal.savgol_coeffs(PARABOLA, 2)
    own = kernel[PARABOLA // 2]
    residual = x - scipy.ndimage.convolve1d(x, kernel, axis=0, mode="nearest")
    return np.asarray(residual / np.sqrt(1 - own))


def _spikes(report: StreamReport, recording: Recording, quiet: Mask, noise: Array, coarse: Mask) -> None:
    """Single samples far outside, and the tails of all."""
    follows = quiet & _consecutive(recording, quiet) & np.roll(_consecutive(recording, quiet), -1)
    counts, sizes, places, limits = [], [], [], []
    n = max(int(follows.sum()), 1)
    for axis in range(3):
        x = report.rates[:, axis]
        level = scipy.ndimage.median_filter(x, 7, mode="nearest")
        scale = noise[axis]
        deviation = x - level
        spread = float(np.median(np.abs(deviation[follows]))) / 0.6745 if follows.any() else scale
        limit = OUTLIER * max(spread, scale) + (report_step(coarse, axis, recording) if coarse[axis] else 0.0)
        bad = follows & (np.abs(deviation) > limit)
        # A repeated or slow event is no spike: both neighbours must be back.
        neighbours = np.maximum(np.abs(np.roll(deviation, 1)), np.abs(np.roll(deviation, -1)))
        isolated = bad & (neighbours < 0.5 * np.abs(deviation))
        limits.append(limit)
        counts.append(int(isolated.sum()))
        sizes.append(np.abs(deviation[isolated]))
        places.append(isolated)
    expected = 2 * scipy.stats.norm.sf(OUTLIER) * 1.2
    for axis in range(3):
        p = max(float(scipy.stats.poisson.sf(counts[axis] - 1, n * expected)), IMPOSSIBLE)
        report.tests.append(
            StreamTest(
                "outliers", AXES[axis], counts[axis], n * expected, p if counts[axis] else 1.0, "spikes",
                f"{counts[axis]} of {n} quiet samples are off by more than {OUTLIER:g} noise sigmas",
            )
        )  # fmt: skip
    total = sum(counts)
    p = max(float(scipy.stats.poisson.sf(total - 1, 3 * n * expected)), IMPOSSIBLE) if total else 1.0
    if p >= EVENT_P or total < 2:
        return
    strongest = int(np.argmax(counts))
    # Three of three on one axis are 27 times likelier there than on all.
    alone = counts[strongest] >= 0.95 * total and total >= 3
    together = np.concatenate(sizes)
    beyond = together - min(limits)
    axes = 1 if alone else 3
    fraction = total / (axes * n)
    if total > 5 and beyond.std() > 0.5 * beyond.mean():
        # Outliers of all sizes: what exceeds a limit has, for exponential ones, the mean of all; the others are hidden.
        seen = float(beyond.mean())
        fraction *= float(np.exp(min(min(limits) / seen, 5.0)))
        error = seen * np.sqrt(1 / total + 0.1**2)
    else:
        seen = float(together.mean())
        error = float(np.hypot(together.std(), noise.mean()) / np.sqrt(total))
    report.causes.append(
        StreamCause(
            "spikes", AXES[strongest] if alone else None, float(np.rad2deg(seen)), "deg/s", float(np.rad2deg(error)),
            {"fraction": float(fraction)}, p,
        )
    )  # fmt: skip
    # Outside the quiet parts a spike must stand out of the motion as well before it is taken out.
    t = recording.gyro.t_s
    for axis in range(3):
        x = report.rates[:, axis]
        deviation = x - scipy.ndimage.median_filter(x, 7, mode="nearest")
        jump = np.abs(deviation) > max(0.4 * seen, 8 * noise[axis])
        bad = places[axis] | (jump & inside(recording) & ~quiet & (np.abs(_highpass(x)) > 8 * noise[axis]))
        good = ~bad
        report.rates[bad, axis] = np.interp(t[bad], t[good], x[good])
        report.filled |= bad


def report_step(coarse: Mask, axis: int, recording: Recording) -> float:
    """One step of an axis' lattice, rad/s."""
    return lattice_step(recording.gyro.rates[inside(recording), axis]) if coarse[axis] else 0.0


def _noise(
    report: StreamReport, recording: Recording, quiet: Mask, sigma: float, steps: Array, coarse: Mask, cut: Mask
) -> None:
    """Level and colour of the white noise, from first and second differences."""
    # Tones are known, and taken out, in the long quiet stretches only.
    still = np.zeros(quiet.size, dtype=bool)
    for low, high in _stretches(quiet & _consecutive(recording, quiet)):
        still[low:high] = True
    pair = still & _consecutive(recording, still) & ~scipy.ndimage.binary_dilation(report.filled, iterations=2)
    triple = pair & np.roll(pair, 1)
    n = int(triple.sum())
    if n < 200:
        return
    factors, errors, colours = np.ones(3), np.ones(3), np.zeros(3)
    for axis in range(3):
        x = report.rates[:, axis]
        second = (x - 2 * np.roll(x, 1) + np.roll(x, 2))[triple]
        first = (x - np.roll(x, 1))[triple]
        spread = np.median(np.abs(second)) / 0.6745
        kept = np.abs(second) < 5 * spread if spread > 0 else np.ones(second.size, dtype=bool)
        variance2, variance1 = float(np.mean(second[kept] ** 2)) / 6, float(np.mean(first[kept] ** 2)) / 2
        expected = sigma**2
        if coarse[axis]:
            if steps[axis] > 2.0 * sigma:
                continue  # the lattice hides the noise
            expected += steps[axis] ** 2 / 12
        # Second differences correlate (−4/6, 1/6): the variance of their mean square is (2/n)(1 + 2(16 + 1)/36).
        relative = np.sqrt(2 / n * (1 + 2 * 17 / 36))
        excess = (variance2 - expected) / sigma**2
        factors[axis] = np.sqrt(max(1 + excess, 1e-6))
        errors[axis] = 0.5 * relative * max(variance2 / sigma**2, 1e-6) / factors[axis]
        colours[axis] = variance2 / max(variance1, 1e-300) - 1
        z = excess / (relative * expected / sigma**2)
        p = max(float(2 * scipy.stats.norm.sf(abs(z))), IMPOSSIBLE)
        # Rounding to a few noise sigmas is not uniform noise, and cutting is not at all near zero.
        if coarse[axis] and (abs(factors[axis] - 1) < 0.1 or cut[axis]):
            p = 1.0
        report.tests.append(
            StreamTest(
                "noise_level", AXES[axis], float(factors[axis]), 1.0, p, "noise_excess",
                f"white noise is {factors[axis]:.3f} times what is stated",
            )
        )  # fmt: skip
        # First and second differences of the same white noise: their ratio scatters less than either.
        spread_ratio = np.sqrt(2 / n) * 0.85
        p = max(float(2 * scipy.stats.norm.sf(abs(colours[axis]) / spread_ratio)), IMPOSSIBLE)
        if coarse[axis]:
            p = 1.0
        report.tests.append(
            StreamTest(
                "noise_colour", AXES[axis], float(1 + colours[axis]), 1.0, p, None,
                f"noise power at the highest frequencies is {1 + colours[axis]:.3f} times that below",
            )
        )  # fmt: skip
    _name_noise(report, factors, errors)


def _name_noise(report: StreamReport, factors: Array, errors: Array) -> None:
    levels = {test.axis: test for test in report.tests if test.statistic == "noise_level"}
    off = [axis for axis in range(3) if AXES[axis] in levels and levels[AXES[axis]].p_value < EVENT_P]
    if not off:
        return
    mean = float(np.sum(factors / errors**2) / np.sum(1 / errors**2))
    common = len(off) == 3 and float(np.sum(((factors - mean) / np.maximum(errors, 0.01)) ** 2)) < 14
    groups = [(None, off)] if common else [(AXES[axis], [axis]) for axis in off]
    for name, axes in groups:
        size = float(np.mean(factors[axes]))
        error = float(np.sqrt(np.mean(errors[axes] ** 2) / len(axes)))
        p = min(levels[AXES[axis]].p_value for axis in axes)
        report.causes.append(StreamCause("noise_excess", name, size, "factor", error, {}, p))
    for axis in off:
        report.noise_factor[axis] = factors[axis]
        report.density[:, axis] *= factors[axis] ** 2


def _lines(report: StreamReport, recording: Recording, quiet: Mask) -> None:
    """The strongest line of each axis in the longest quiet stretches."""
    stretches = _stretches(quiet & _consecutive(recording, quiet))
    for axis in range(3):
        best: tuple[float, float, float] | None = None
        tried = 0
        for low, high in stretches:
            x = report.rates[low:high, axis]
            power, frequency, amplitude, count = _strongest(x, recording.gyro.sample_s)
            tried += count
            if best is None or power > best[0]:
                best = (power, frequency, amplitude)
        if best is None:
            continue
        power, frequency, amplitude = best
        p = max(min(1.0, tried * float(np.exp(-power))), IMPOSSIBLE)
        report.tests.append(
            StreamTest(
                "strongest_line", AXES[axis], float(np.rad2deg(amplitude)), 0.0, p, "vibration",
                f"strongest line at {frequency:.4f} Hz, {np.rad2deg(amplitude):.3g} deg/s",
            )
        )  # fmt: skip
        # Rounding a slow motion makes lines of its own.
        if p < LINE_P and not report.lattice[axis]:
            tone = _tone(report, recording, axis, frequency, stretches, p)
            if tone is not None:
                report.causes.append(tone)


def _stretches(mask: Mask) -> list[tuple[int, int]]:
    """Unbroken runs of at least 256 samples, as slices."""
    return [(low, high) for low, high in runs(mask) if high - low >= 256]


def _strongest(x: Array, sample_s: float) -> tuple[float, float, float, int]:
    """Power over the noise around it, frequency and amplitude of the strongest line, and how many were looked at."""
    n = x.size
    # A Hann window keeps the body's slow motion out of the frequencies looked at.
    window = scipy.signal.windows.hann(n, sym=False)
    spectrum = np.abs(np.fft.rfft(scipy.signal.detrend(x) * window)) ** 2 / np.sum(window**2)
    frequency = np.fft.rfftfreq(n, sample_s)
    allowed = np.flatnonzero((frequency > LOWEST_LINE) & (frequency < frequency[-1] * (1 - 1 / n)))
    if allowed.size < 20:
        return 0.0, 0.0, 0.0, 0
    # Against the level around it, so that coloured noise is no line.
    around = scipy.ndimage.median_filter(spectrum, 61, mode="nearest") / np.log(2)
    level = np.maximum(around, float(np.median(spectrum[allowed])) / np.log(2) * 0.5)
    power = spectrum[allowed] / np.maximum(level[allowed], 1e-300)
    k = int(allowed[np.argmax(power)])
    return (
        float(power.max()),
        float(frequency[k]),
        float(2 * np.sqrt(spectrum[k] * np.sum(window**2)) / np.sum(window)),
        int(allowed.size),
    )


def _tone(
    report: StreamReport, recording: Recording, axis: int, frequency: float, stretches: list[tuple[int, int]], p: float
) -> StreamCause | None:
    """Amplitude and frequency of a tone by least squares, stretch by stretch, each with its own phase.

    The strongest of many lines in one stretch may be chance; a tone is there in all of them. None if it is not.
    """
    sample = recording.gyro.sample_s
    longest = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
    span = (longest[1] - longest[0]) * sample
    trial = frequency + np.linspace(-1.5, 1.5, 61) / span
    x = scipy.signal.detrend(report.rates[slice(*longest), axis])
    t = recording.gyro.t_s[slice(*longest)]
    powers = [abs(np.exp(-2j * np.pi * f * t) @ x) for f in trial]
    f = float(trial[int(np.argmax(powers))])
    squares, samples, noise, left_over = 0.0, 0, 0.0, report.rates[:, axis].copy()
    for low, high in stretches:
        angle = 2 * np.pi * f * recording.gyro.t_s[low:high]
        waves = np.column_stack([np.cos(angle), np.sin(angle)])
        y = report.rates[low:high, axis]
        level = scipy.signal.detrend(y)
        fitted = np.linalg.lstsq(waves, level, rcond=None)[0]
        # What is left is what the other tests look at.
        left_over[low:high] = y - waves @ fitted
        left = float(np.mean((level - waves @ fitted) ** 2))
        squares += (float(fitted @ fitted) - 4 * left / y.size) * y.size
        noise += left * y.size
        samples += y.size
    size = float(np.sqrt(max(squares / samples, 0.0)))
    error = float(np.sqrt(2 * noise / samples / samples))
    if size < CLEAR_TONE * error:
        return None
    report.rates[:, axis] = left_over
    return StreamCause(
        "vibration", AXES[axis], float(np.rad2deg(size)), "deg/s", float(np.rad2deg(error)), {"apparent_hz": f}, p
    )


def _off_the_lattice(report: StreamReport, recording: Recording, steps: Array, coarse: Mask, cut: Mask, sigma: float) -> None:
    """Undo what the lattice does to slow rates, and account for the noise it makes."""
    t = recording.gyro.t_s
    for axis in np.flatnonzero(coarse):
        q = float(steps[axis])
        report.density[:, axis] += q**2 / 12 * recording.gyro.sample_s
        kind: Kind = "cut" if cut[axis] else "rounded"
        for interval in recording.intervals:
            low, high = np.searchsorted(t, [interval.start_s - 1e-6, interval.stop_s - 1e-6])
            x, factor, hidden = undone(report.rates[low:high, axis], recording.gyro.sample_s, q, sigma, kind)
            report.rates[low:high, axis] = x
            report.density[low:high, axis] = report.density[low:high, axis] * factor + hidden
            report.hidden[axis] |= bool(np.mean(hidden > 0) > 0.1)
