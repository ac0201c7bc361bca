"""Level and colour of the white noise of the samples, and where they are quiet enough to show it."""

from __future__ import annotations

import numpy as np
import scipy.ndimage
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.report import AXES, EVENT_P, StreamCause, StreamReport, StreamTest, consecutive, stretches
from diagnosis.detectors.stale_samples import IMPOSSIBLE
from gyrocal.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

HALF = 20  # samples on either side of one in the test for quiet
MOVING = 20.0  # sigmas of that change that count as visible; a slew's are hundreds, those of a vibration a few


def local_noise(rates: Array, sigma: float, coarse: Mask, steps: Array) -> Array:
    """(3,) robust noise of a sample, at least what is stated."""
    second = np.diff(rates, 2, axis=0)
    robust = np.median(np.abs(second), axis=0) / 0.6745 / np.sqrt(6)
    floor = np.where(coarse, np.sqrt(sigma**2 + steps**2 / 12), 0.0)
    return np.asarray(np.maximum(np.where(robust > 0, robust, sigma), floor))


def quiet(rates: Array, noise: Array) -> Mask:
    """Samples around which the mean rate does not visibly change on any axis."""
    ahead = scipy.ndimage.uniform_filter1d(rates, HALF, axis=0, origin=-HALF // 2, mode="nearest")
    behind = scipy.ndimage.uniform_filter1d(rates, HALF, axis=0, origin=HALF // 2 - 1, mode="nearest")
    change = np.abs(ahead - behind) / (noise * np.sqrt(2 / HALF))
    moving = (change > MOVING).any(axis=1)
    return ~scipy.ndimage.binary_dilation(moving, iterations=HALF)


def noise(report: StreamReport, recording: Recording, quiet: Mask, sigma: float, steps: Array, coarse: Mask, cut: Mask) -> None:
    """Level and colour of the white noise, from first and second differences."""
    # Tones are known, and taken out, in the long quiet stretches only.
    still = np.zeros(quiet.size, dtype=bool)
    for low, high in stretches(quiet & consecutive(recording, quiet)):
        still[low:high] = True
    pair = still & consecutive(recording, still) & ~scipy.ndimage.binary_dilation(report.filled, iterations=2)
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
