r"""What the noise of calm blocks may depend on, each question with its p-value.

With ê the noise of a block b, n_bi the number of its sample i and w its level (`diagnosis.detectors.noise_patterns`,
`diagnosis.detectors.noise_blocks`), asked is whether

- the **mean** of ê goes with a cycle of k = 2 … 16 samples, counted from the interval's start or from the recording's, also
  where the cycle grows with a reading or with its change (a gain that alternates): Σ_b q_b Σ_i ê_bi exp(−2πi f n_bi), all
  f = h/k;
- the **power** does: the same of ê²;
- the mean of ê has a **step at one value** of the reading: the sum of ê beyond that value, the largest over values;
- the **level** differs with the time, the time since the interval's start, a reading, its size or its change, or with those of
  the other gyros: w in bins of each, where a rest of the motion is fitted beside it;
- the level goes with a **wave** of any period in time, over the whole recording or in one interval alone, or in the angle that
  one has turned about an axis: Σ_b w_b exp(−2πi f t_b) of the levels without their mean; the strongest has to show again
  between the halves of the wave, with a rest of the motion fitted beside the level;
- the noise is **uneven**: whether powers of blocks scatter or go together with the next more than white noise does.

Sums over blocks are compared with their own scatter, T² = sᵀ (Σ_b s_b s_bᵀ)⁻¹ s: blocks in which a motion is left weigh
little, and the tails are at most those of χ² (Efron, J. Am. Stat. Assoc. 64, 1969). What the place in a block makes of ê² is
taken out first. Each p-value counts as often as questions were asked.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from math import gcd

import numpy as np
import scipy.fft
import scipy.linalg
import scipy.special
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.noise_blocks import BACK, CUT, LEVEL_SPREAD, fitted, powers_of

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

LONGEST = 16  # samples, of a cycle
FAR = 4.0  # sigmas at which what is further out counts as being
VALUES = 300  # of the reading, at which a step is looked for
AT_ONCE = 512  # blocks that are looked at, so that memory stays small
STEPPED = 30  # blocks with a step in them, below which nothing is said
BINS = 6  # of blocks, in which levels are compared
HIGHEST = 12  # cosines from the highest down, whose power shows uneven noise
FINEST_TURN = 64  # of a turn, the shortest wave in the angle turned
LONGEST_GRID = 1 << 20  # places of a wave
FEWEST_OF_WAVE = 100  # blocks of an interval, in which waves are looked for
SHORT, FEW_WAVES = 4, 2  # places in the shortest wave, and times that the longest one fits
DRAWS = 200_000  # blocks of white noise, that show what is usual
CYCLES = np.array([h / k for k in range(2, LONGEST + 1) for h in range(1, k // 2 + 1) if gcd(h, k) == 1])


@dataclass(frozen=True)
class Answer:
    """One kind of question: its p-value, all questions of the kind counted, the size in terms of the noise, and a sentence."""

    p_value: float
    size: float
    text: str


@dataclass(frozen=True)
class Blocks:
    """The calm blocks of one gyro.

    Attributes
    ----------
    cosines : (b, SHOWING) in sigmas
    noise, rest : (b, n) ê in sigmas, and what is left, rad/s
    start : (b, 2) number of the first sample, from the recording's and from the interval's start
    readings : (b, 3) means of all gyros, this one first
    change : (b,) of this one's reading over a block
    turned : (b, 3) angles turned since the interval's start, by all gyros, this one first, rad
    """

    cosines: Array
    noise: Array
    rest: Array
    start: Indices
    readings: Array
    change: Array
    turned: Array


def cycles_of_mean(calm: Blocks) -> Answer:
    """The strongest cycle of the mean, one that is the same at all times or grows with a reading or its change."""
    grow = [("", np.ones(len(calm.noise))), (" and grows with a reading", calm.readings[:, 0])]
    grow += [(" and grows with the reading of another gyro", calm.readings[:, k]) for k in (1, 2)]
    grow += [(" and grows with the change of the reading", calm.change)]
    return _cycles(calm, calm.noise, grow, "its mean")


def cycles_of_power(calm: Blocks) -> Answer:
    """The strongest cycle of the power, of which a few samples that are far out are no great part."""
    shape = np.sum(BACK**2, axis=0)
    power = np.minimum(calm.noise**2, FAR**2 * shape)
    power = power - power.mean(axis=0) * (power.mean(axis=1) / power.mean())[:, None]
    grow = [("", np.ones(len(power))), (" and grows with the size of the reading", np.abs(calm.readings[:, 0]))]
    return _cycles(calm, power, grow, "its power")


def _cycles(calm: Blocks, values: Array, grow: list[tuple[str, Array]], of_what: str) -> Answer:
    """The strongest of all cycles of some values (b, n), both ways of counting, times all that they may grow with."""
    waves = np.exp(-2j * np.pi * np.arange(values.shape[1])[:, None] * CYCLES)
    own = values @ waves
    best, at, asked = 0.0, ("", 0.5), 0
    for count in np.unique(calm.start, axis=1).T if np.ptp(calm.start[:, 0] - calm.start[:, 1]) else calm.start[:, :1].T:
        turned = own * np.exp(-2j * np.pi * (count[:, None] * CYCLES % 1.0))
        for text, weight in grow:
            asked += CYCLES.size
            strength = _against_scatter(turned * weight[:, None])
            top = int(np.argmax(strength))
            if strength[top] > best:
                best, at = float(strength[top]), (text, float(CYCLES[top]))
    p = min(1.0, asked * float(np.exp(-0.5 * best)))
    text = f"{of_what} goes with a cycle of {1 / at[1]:.4g} samples{at[0]}"
    return Answer(p, float(np.sqrt(best / calm.cosines.size)), text)


def _against_scatter(values: Complex) -> Array:
    """(f,) T² of the sums of (b, f) complex values, as χ² with two degrees of freedom; of those that are real, with one."""
    re, im = values.real, values.imag
    return _t2(values.sum(axis=0), np.sum(re**2, axis=0), np.sum(re * im, axis=0), np.sum(im**2, axis=0))


def _t2(sums: Complex, a: Array, b: Array, c: Array) -> Array:
    """(f,) T² of complex sums, with the variances a and c of their real and imaginary parts and the covariance b."""
    s, t = sums.real, sums.imag
    determinant = a * c - b**2
    flat = determinant <= 1e-6 * (a + c) ** 2
    both = (c * s**2 - 2 * b * s * t + a * t**2) / np.where(flat, 1.0, determinant)
    # The tail of χ² with one degree of freedom lies below that with two.
    return np.asarray(np.where(flat, (s**2 + t**2) / np.maximum(a + c, 1e-300), both))


def step(calm: Blocks) -> Answer:
    """The strongest step of the mean at a value of the reading that blocks pass."""
    values = np.quantile(calm.rest, (np.arange(VALUES) + 0.5) / VALUES)
    total, squares, passed = np.zeros((3, VALUES))
    for first in range(0, len(calm.noise), AT_ONCE):
        sums = _beyond(calm.noise[first : first + AT_ONCE], calm.rest[first : first + AT_ONCE], values)
        total += sums.sum(axis=0)
        squares += np.sum(sums**2, axis=0)
        passed += np.count_nonzero(sums, axis=0)
    strength = np.where(passed >= STEPPED, total**2 / np.maximum(squares, 1e-300), 0.0)
    best, at = float(strength.max()), float(values[np.argmax(strength)])
    p = min(1.0, VALUES * float(scipy.stats.chi2.sf(best, 1)))
    text = f"its mean has a step where the reading passes {np.rad2deg(at):.4g} deg/s"
    return Answer(p, float(np.sqrt(best / calm.cosines.size)), text)


def _beyond(noise: Array, rest: Array, values: Array) -> Array:
    """(b, v) sums of a block's noise (b, n) where its rest (b, n) is beyond each value, zero where all of it is or none."""
    blocks, size = rest.shape
    where = (np.arange(blocks)[:, None] * (values.size + 1) + np.searchsorted(values, rest)).ravel()
    among = [np.bincount(where, one, blocks * (values.size + 1)) for one in (noise.ravel(), None)]
    sums, beyond = (np.cumsum(one.reshape(blocks, -1)[:, :0:-1], axis=1)[:, ::-1] for one in among)
    return np.where((beyond > 0) & (beyond < size), sums, 0.0)


def levels(calm: Blocks) -> Answer:
    """The largest difference of the level between bins of blocks: by all of them, and by their trend."""
    best, asked = Answer(1.0, 0.0, "its level is the same at all times"), 0
    for name, values in _given(calm):
        found = []
        for part in np.array_split(np.argsort(values, kind="stable"), BINS):
            fit = fitted(powers_of(calm.cosines[part]), part.size)
            if fit.still and fit.fits:
                found.append((float(part.size), fit.white))
        asked += 2
        if len(found) < 3:
            continue
        count, level = np.array(found).T
        mean = float(count @ level / count.sum())
        sigma = mean * np.sqrt(LEVEL_SPREAD / count)
        trend = np.linspace(-1, 1, count.size)
        trend -= np.sum(trend / sigma**2) / np.sum(1 / sigma**2)
        along = float(np.sum(trend * level / sigma**2) / np.sqrt(np.sum((trend / sigma) ** 2)))
        all_bins = float(scipy.stats.chi2.sf(float(np.sum(((level - mean) / sigma) ** 2)), count.size - 1))
        p = min(all_bins, float(2 * scipy.stats.norm.sf(abs(along))))
        if p < best.p_value:
            best = Answer(p, float(np.ptp(level) / mean / 2), f"its level differs with {name}")
    return Answer(min(1.0, asked * best.p_value), best.size, best.text)


def _given(calm: Blocks) -> Iterator[tuple[str, Array]]:
    """What a level may go with, one number of each block."""
    yield "the time", calm.start[:, 0].astype(float)
    if np.ptp(calm.start[:, 0] - calm.start[:, 1]):
        yield "the time since the interval's start", calm.start[:, 1].astype(float)
    yield "the change of the reading", np.abs(calm.change)
    yield "the rate of the body", np.linalg.norm(calm.readings, axis=1)
    for k, whose in enumerate(("the reading", "the next gyro's reading", "the reading of the gyro after the next")):
        yield whose, calm.readings[:, k]
        yield f"the size of {whose}", np.abs(calm.readings[:, k])


def waves_of_level(calm: Blocks) -> Answer:
    """The strongest wave of the level in time or in an angle that is turned."""
    power = np.mean(np.minimum(calm.cosines**2, CUT), axis=1)
    best, asked, at, text = 0.0, 0, (np.arange(0), np.empty(0)), ""
    for name, clock, place, part in _clocks(calm):
        strength, phase, period, count = _strongest(power[part] - power[part].mean(), clock, place)
        asked += count
        if strength > best:
            best, at, text = strength, (part, phase), f"its level goes with {name} in waves of {period:.4g}"
    if not text:
        return Answer(1.0, 0.0, "its level goes with no wave")
    part, phase = at
    halves = [part[half] for half in (np.cos(phase) > 0, np.cos(phase) <= 0)]
    fits = [fitted(powers_of(calm.cosines[half]), half.size) for half in halves]
    level, sizes = np.array([one.white for one in fits]), np.array([half.size for half in halves])
    difference, error = level[0] - level[1], float(np.sqrt(np.sum(level**2 * LEVEL_SPREAD / sizes)))
    again = float(scipy.stats.norm.sf(difference / error)) if all(one.still and one.fits for one in fits) else 1.0
    p = min(1.0, asked * float(np.exp(-0.5 * best)))
    return Answer(max(p, again), float(abs(difference) / level.mean() / 2), text)


def _clocks(calm: Blocks) -> Iterator[tuple[str, Array, float, Indices]]:
    """What a level may go with in waves: its name, its values at some blocks, the spacing of places, and which blocks."""
    whole, begin = np.arange(len(calm.start)), calm.start[:, 0] - calm.start[:, 1]
    spacing = float(np.median(np.diff(calm.start[:, 0])))
    yield "the number of a sample", calm.start[:, 0].astype(float), spacing, whole
    for first in np.unique(begin):
        part = np.flatnonzero(begin == first)
        if part.size < FEWEST_OF_WAVE:
            continue
        if part.size < whole.size:
            yield "the number of a sample in one interval", calm.start[part, 1].astype(float), spacing, part
        for k, whose in enumerate(("this gyro", "the next gyro", "the gyro after the next")):
            name = f"the angle turned about the axis of {whose}, in rad, in one interval"
            yield name, calm.turned[part, k], 2 * np.pi / FINEST_TURN / SHORT, part


def _strongest(left: Array, clock: Array, place: float) -> tuple[float, Array, float, int]:
    """The strongest wave of some values without their mean (b,) in a clock (b,), by places of some spacing.

    Returns
    -------
    Its T², the phase of each value from its crest on, its period, and for how many it was looked for
    """
    begin, span = float(clock.min()), float(np.ptp(clock))
    place = max(place, span / LONGEST_GRID)
    count = int(span / place) + 1
    if count <= 2 * SHORT * FEW_WAVES:
        return 0.0, np.empty(0), np.inf, 0
    places = ((clock - begin) / place).astype(np.intp)
    padded = scipy.fft.next_fast_len(2 * count, real=True)
    sums, squares = (scipy.fft.rfft(np.bincount(places, one, count), padded) for one in (left, left**2))
    low, high = FEW_WAVES * padded // count, padded // SHORT
    # cos² and sin² of a phase are those of the doubled one.
    total, doubled = squares[0].real, squares[2 * low : 2 * high : 2]
    strength = _t2(sums[low:high], 0.5 * (total + doubled.real), 0.5 * doubled.imag, 0.5 * (total - doubled.real))
    best = int(np.argmax(strength))
    frequency = (low + best) / padded
    phase = 2 * np.pi * frequency * places + np.angle(sums[low + best])
    return float(strength[best]), np.asarray(phase), place / frequency, high - low


def uneven(calm: Blocks) -> Answer:
    """Powers of blocks that scatter more than those of white noise, or are alike from one to the next."""
    highest = calm.cosines[:, :HIGHEST]
    # Noise of another colour does not swell for that.
    factor = np.linalg.cholesky(highest.T @ highest / len(highest))
    power = np.log(np.sum(scipy.linalg.solve_triangular(factor, highest.T, lower=True) ** 2, axis=0))
    variance, fourth = _logs_of_white()
    spread = FAR * float(np.sqrt(scipy.special.polygamma(1, HIGHEST / 2)))
    power = np.clip(power - np.median(power), -spread, spread)
    scatter = float(np.mean((power - power.mean()) ** 2))
    of_scatter = (scatter - variance) / np.sqrt((fourth - variance**2) * (1 / power.size + 1 / DRAWS))
    near = np.diff(calm.start[:, 0]) < 1.5 * calm.noise.shape[1]
    pairs = (power[1:] - power.mean())[near] * (power[:-1] - power.mean())[near]
    of_pairs = float(pairs.sum() / max(np.sqrt(np.sum(pairs**2)), 1e-300))
    p = min(1.0, 2 * float(scipy.stats.norm.sf(max(of_scatter, of_pairs))))
    size = max(scatter / variance - 1.0, float(pairs.sum() / max(pairs.size, 1) / variance))
    return Answer(p, 0.5 * size, "it swells and falls")


@cache
def _logs_of_white() -> tuple[float, float]:
    """Second and fourth central moment of the log power of blocks of white noise, without what is far out."""
    logs = np.log(np.random.default_rng(1).chisquare(HIGHEST, DRAWS))
    spread = FAR * float(np.sqrt(scipy.special.polygamma(1, HIGHEST / 2)))
    logs = np.clip(logs - np.median(logs), -spread, spread)
    return float(np.var(logs)), float(np.mean((logs - logs.mean()) ** 4))
