r"""Whether a reading's gain goes with a cycle of the samples: converters that take turns, droop between refreshes, a ripple.

A reading x of the rate ω with a gain 1 + g s, where s repeats every k samples, and white noise n of variance σ² has the
matched statistic Σ ω s (x − ω)/σ². In place of ω, which nobody knows, stands x̄, x smoothed over some of the longest cycles:
x x̄ = ω² + g s ω² + ω n + … has the noise of that statistic, and the motion below the end of its band. Asked is at f = h/k for
k = 2 … 64,

    Z(f) = Σ_a Σ_m w_m (x x̄)_{a m} exp(−2πi f (n_a + m)),    T(f) = |Z|² / Σ_a P_a(f),

with w a Blackman-Harris window over each unbroken run a of samples, which begins at number n_a from the interval's start or
from the recording's, and P_a the level of the spectrum around f; under M0 T has the distribution exp(1), and at half the
sampling rate, where Z is real, χ² with one degree of freedom. Runs in whose spectrum the motion still has a part at f are not
asked there.

A body moves with no regard to the number of a sample. One that shakes while it turns shows cross terms of both in x x̄, beside
the frequency at which x has the line itself; one that shakes the more the faster it turns shows a line in x x̄ at no whole
cycle. Both have a larger power beyond the motion's band and no further than its width from f, of x or of x x̄, than T is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import gcd

import numpy as np
import scipy.fft
import scipy.ndimage
import scipy.signal
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.spectral_lines import ISOLATED, LOBE, STRONG, band_edge

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

LONGEST = 64  # samples, of a cycle
SHORTEST = 1024  # samples of a run
AROUND = 241  # bins, over which the level is taken; of the window, one in four is independent
BETTER = 5.0  # by which T is larger than what anything else near its frequency explains
BY_CHANCE = 5.0  # on the logarithm of their number, that the strongest of some powers of noise exceeds once in e⁵
LOSS = 0.6  # of its power, that a line shows in the bin next to it where its frequency is within half a bin
CYCLES = np.array(sorted({h / k for k in range(2, LONGEST + 1) for h in range(1, k // 2 + 1) if gcd(h, k) == 1}))


@dataclass(frozen=True)
class GainCycle:
    """The cycle that a gain goes with most clearly.

    Attributes
    ----------
    p_value : under M0, all cycles counted
    cycle : its period, samples
    size : RMS of the share by which the gain differs, of the wave that is strongest
    sigma : the standard error of that
    """

    p_value: float
    cycle: float
    size: float
    sigma: float


def gain_cycle(x: Array, runs: Sequence[tuple[int, int]], starts: Indices) -> GainCycle | None:
    """The strongest cycle of the gain of a gyro; None where no run is long enough or motion is everywhere.

    Parameters
    ----------
    x : (n,) reading, rad/s
    runs : of samples that follow one another
    starts : (r, c) number of the first sample of each run, in c ways of counting
    """
    enough = np.array([high - low >= SHORTEST for low, high in runs], dtype=bool)
    if not enough.any():
        return None
    long = [(low, low + (high - low) // 2 * 2) for (low, high), one in zip(runs, enough, strict=True) if one]
    product, reading = zip(
        *(_both(x[low:high], first) for (low, high), first in zip(long, starts[enough], strict=True)), strict=True
    )
    of_product, of_reading = _together(product), _together(reading)
    half = CYCLES == 0.5
    asked = starts.shape[1] * int(of_product.asked.sum())
    if not asked:
        return None
    strength = np.abs(of_product.sums) ** 2 / np.maximum(of_product.level, 1e-300)
    # Half the sampling rate has one degree of freedom; in terms of its chance it is compared with the others.
    chance = np.where(half, scipy.stats.chi2.sf(strength, 1), np.exp(-strength))
    rivals = np.maximum(of_reading.rivals, LOSS * of_product.rivals) + BETTER
    chance = np.where(of_product.asked & (strength > rivals), chance, 1.0)
    way, place = np.unravel_index(int(np.argmin(chance)), chance.shape)
    # A wave has its power at two frequencies, and but at one if that is half the sampling rate.
    weight, waves = (of_product.power, 1.0) if half[place] else (of_product.power / np.sqrt(2.0), 2.0)
    error = float(np.sqrt(of_product.level[place] / waves) / weight)
    size = float(np.abs(of_product.sums[way, place]) / weight)
    return GainCycle(min(1.0, asked * float(chance[way, place])), float(1 / CYCLES[place]), size, error)


@dataclass(frozen=True)
class _Waves:
    """Of one run or the sum of some: (c, f) waves, (f,) their level, whether any run is asked, and Σ w y.

    The rivals (f,) are the sums of the strongest powers near each frequency, in terms of their level, where more than chance.
    """

    sums: Complex
    level: Array
    asked: NDArray[np.bool_]
    power: float
    rivals: Array

    def only(self, asked: NDArray[np.bool_]) -> _Waves:
        """The same, asked at some frequencies only."""
        return _Waves(self.sums * asked, self.level * asked, asked, self.power, self.rivals * asked)


def _together(runs: Sequence[_Waves]) -> _Waves:
    asked = np.any([one.asked for one in runs], axis=0)
    sums, level, rivals = (np.sum([getattr(one, name) for one in runs], axis=0) for name in ("sums", "level", "rivals"))
    return _Waves(sums, level, asked, sum(one.power for one in runs), rivals)


def _both(x: Array, first: Indices) -> tuple[_Waves, _Waves]:
    """Waves of a run's reading times its smoothed self and of itself, at frequencies beyond the motion of both."""
    product, reading = _waves(x * _smooth(x), first), _waves(x, first)
    asked = product.asked & reading.asked
    return product.only(asked), reading.only(asked)


def _smooth(x: Array) -> Array:
    """A reading without what is as fast as the longest cycle: the response of so long a window is nothing from there on."""
    kernel = scipy.signal.windows.blackmanharris(4 * LONGEST + 1)
    padded = np.pad(x, 2 * LONGEST, mode="edge")
    return np.asarray(scipy.signal.oaconvolve(padded, kernel / kernel.sum(), mode="valid"))


def _waves(y: Array, first: Indices) -> _Waves:
    n = y.size
    window = scipy.signal.windows.blackmanharris(n)
    spectrum: Complex = scipy.fft.rfft((y - y.mean()) * window)
    bins = np.round(CYCLES * n).astype(np.intp)
    around, beyond, strongest = _levels(np.abs(spectrum) ** 2, bins)
    # Within the lobe of zero or of half the sampling rate a wave and its mirror image are not told apart.
    inner = beyond & (bins > LOBE) & ((bins < n // 2 - LOBE) | (CYCLES == 0.5))
    turned = np.exp(-1j * np.pi * (CYCLES - bins / n) * (n - 1) - 2j * np.pi * (first[:, None] * CYCLES % 1.0))
    return _Waves(spectrum[bins] * turned, around, inner, float(window @ y), strongest)


def _levels(power: Array, bins: Indices) -> tuple[Array, NDArray[np.bool_], Array]:
    """Of a spectrum, the level around some bins, which of them are beyond the motion's band, and the strongest near them."""
    lowest = np.clip(bins - AROUND // 2, 0, power.size - AROUND)
    around = np.median(power[lowest[:, None] + np.arange(AROUND)], axis=1) / np.log(2)
    white = float(np.median(power[power.size // 2 :]) / np.log(2))
    edge = band_edge(np.flatnonzero(power > STRONG * white).astype(float))
    near = 2 * max(int(edge), 2 * LOBE) + 1
    outside = np.where(np.arange(power.size) > edge, power, 0.0)
    strongest = scipy.ndimage.maximum_filter1d(outside, near)[bins] / np.maximum(around, 1e-300)
    strongest = np.where(strongest > np.log(near) + BY_CHANCE, strongest, 0.0)
    return around, bool(white > 0) & (around < ISOLATED * white) & (bins > edge), strongest
