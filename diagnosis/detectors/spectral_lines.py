"""Lines in the spectrum of the samples: a vibration, if it is there in all quiet stretches."""

from __future__ import annotations

import numpy as np
import scipy.ndimage
import scipy.signal
from numpy.typing import NDArray

from diagnosis.detectors.report import AXES, StreamCause, StreamReport, StreamTest, consecutive, stretches
from diagnosis.detectors.stale_samples import IMPOSSIBLE
from gyrocal.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LOWEST_LINE = 0.04  # Hz: below it, lines are the body's own motion
LINE_P = 1e-8  # of a line to be a vibration: the level around it is itself estimated
CLEAR_TONE = 5.0  # sigmas of its amplitude over all stretches, for a line to be a tone


def lines(report: StreamReport, recording: Recording, quiet: Mask) -> None:
    """The strongest line of each axis in the longest quiet stretches."""
    found = stretches(quiet & consecutive(recording, quiet))
    for axis in range(3):
        best: tuple[float, float, float] | None = None
        tried = 0
        for low, high in found:
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
            tone = _tone(report, recording, axis, frequency, found, p)
            if tone is not None:
                report.causes.append(tone)


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
