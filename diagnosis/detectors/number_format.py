"""Number formats of readings on a lattice: log odds of cutting toward zero against rounding.

All formats put a reading x into a bin and differ in the bins about zero, in steps:

    rounded    (k − ½, k + ½)                                      `numpy.round`
    floored    (k, k + 1)                                          an analogue converter
    cut        (−1, 1) for zero, (k, k + 1) above, mirrored below  a cast to an integer

Floored readings are rounded ones less half a step, which the bias takes up: the two are one hypothesis. Readings that keep one
sign cannot tell cut from floored ones for the same reason.

Short blocks of readings whose bins reach zero have a cubic mean and normal noise. For each format the maximum likelihood of the
interval-censored block follows by expectation maximisation (Dempster, Laird and Rubin, JRSS B 39, 1977). Blocks whose residuals
exceed the noise hold a motion that is no cubic, such as the end of a turn, and are left out. A block that passes from one side
of zero to the other has a random phase to the lattice, over which its likelihood is integrated. A block that rests has no
random phase, since a body rests at the same rate again: its likelihood is the maximum, and noise below half a step leaves it
alike for all formats. Truncation is as plausible beforehand as rounding, since both are one line of code.

Slow rates are given back what the lattice takes. A reading x + n of noise n ~ N(0, σ²) on a lattice of step q has the mean

    rounded  f(x) = q Σ_k Φ((x − (k + ½) q)/σ) over k ≥ 0, less q Σ_k Φ((−x − (k + ½) q)/σ)
    cut      f(x) = q Σ_k Φ((x − k q)/σ) over k ≥ 1, less q Σ_k Φ((−x − k q)/σ)

With noise above q/3 rounding hardly matters; below it f is a staircase. Cutting takes half a step off every rate that is
larger than one, whatever the noise. Means over a minute are inverted through f; where the rate moves, half a step is given
back to every reading but zero, and so it is where the noise spans many steps. What remains is the lattice's own noise, q²/12 a
sample where the noise spreads it, and worse on a stair, or where a swing turns round inside a step.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.ndimage
from scipy.special import expit, logsumexp, ndtr

from diagnosis.arrays import AXES
from diagnosis.detectors.sample_report import IMPOSSIBLE, Findings, SampleTest, Stream, Symptom
from gyrocal.arrays import Array, Mask
from simulator.effects.recording_view import find_interval_slices

FORMATS: tuple[Kind, Kind] = ("rounded", "cut")

# readings of a block, and degree of its mean
BLOCK = 16
DEGREE = 3
LOUD = 1.6  # root mean square of a block's residuals over the noise, above which the polynomial misses its motion
MOST_BLOCKS = 1000  # of one axis, evenly chosen
ROUNDS = 25  # of expectation maximisation
LEAST_SIGMA = 0.05  # of a block, steps
DITHERED = 0.4  # noise in steps, from which on a rest reaches more bins than one
# of the mean over which a block is integrated, steps
SHIFTS = tuple(np.linspace(-2.0, 2.0, 33).tolist())
SAME = 0.01  # relative difference of the steps of one converter
COARSE = 0.2  # a lattice finer than this share of the noise is a number format: its rounding has 0.3 % of the power
# sigmas of the angle random walk over all samples, that half steps must turn by for a finer lattice to matter
WORTH = 3.0
DECIDED = 8.0  # log odds below which blocks that are no cubic may say either, and both formats are as probable
POSSIBLE = 0.05  # probability of the other number format, from which on it is reported
HIDDEN = 0.1  # share of an interval in which a lattice hides the rate, from which on the gyro is blind there

LEAST_CELL_PROBABILITY = 1e-12  # of a probability

Kind = Literal["rounded", "cut"]

MEAN_S = 60.0  # s, of the means that are inverted
FEW = 20  # readings at least, of those
REACH = 10  # steps on either side of zero in which f is tabulated
LEAST_SLOPE = 0.15  # of f, below which nothing more can be said of the rate
FLAT = 0.3  # slope of f below which a reading hides the rate
SPREAD = 0.45  # noise over step, above which rounding does nothing to a mean
EXACT = 0.02  # steps, by which a value may be off the lattice
PRINTED = 5e-5  # relative error of a number printed with five digits, by which it may be off as well
UNTOLD = 0.2  # steps, of what may be off, beyond which a value says nothing of the lattice
FEWEST_TOLD = 50  # other values, by which the chance of a lattice is less than 1e-19
FINE = 5.0  # noise over step, above which the stairs of cut readings are lost in it


@dataclass(frozen=True)
class NumberFormats:
    """Number formats of the readings of three gyros."""

    steps: Array  # (3,) step of the lattice that readings lie on, rad/s; zero if on none
    log_odds: Array  # (3,) that readings were cut and not rounded, zero where the samples leave it open
    coarse: Mask  # (3,) whether the lattice matters beside the noise
    cut: Mask  # (3,) whether readings are taken as cut toward zero
    may_be_cut: Mask  # (3,) whether that is possible

    def describe(self) -> Findings:
        """Describe the lattice of each gyro; gyros on one lattice are one departure."""
        names = np.where(self.cut, "lattice_cut", "lattice_rounded")
        tests = []
        for axis, step in enumerate(np.rad2deg(self.steps).tolist()):
            p, text = 1.0, "readings lie on no lattice that matters beside the noise"
            if self.coarse[axis]:
                p, text = IMPOSSIBLE, f"all readings are multiples of {step:.4g} deg/s"
            tests.append(SampleTest("lattice_step", AXES[axis], step, 0.0, p, str(names[axis]), text))
        symptoms: list[Symptom] = []
        for kind in ("lattice_rounded", "lattice_cut"):
            axes = np.flatnonzero(self.coarse & (names == kind))
            steps = self.steps[axes]
            common = axes.size == 3 and np.ptp(steps) < SAME * steps.mean()
            each = [(None, axes[0], steps.mean())] if common else [(AXES[k], k, self.steps[k]) for k in axes]
            symptoms += [self._describe_lattice(kind, name, int(axis), float(step)) for name, axis, step in each]
        return Findings(tuple(tests), tuple(symptoms))

    def _describe_lattice(self, kind: str, name: str | None, axis: int, step: float) -> Symptom:
        size = float(np.rad2deg(step))
        text = f"all readings are multiples of {size:.4g} deg/s, {'cut toward zero' if kind == 'lattice_cut' else 'rounded'}"
        cut = float(expit(self.log_odds[axis]))
        other, share = ("lattice_rounded", 1 - cut) if kind == "lattice_cut" else ("lattice_cut", cut)
        rivals = ((other, share),) if share > POSSIBLE else ()
        return Symptom(kind, name, size, "deg/s", 1e-6 * size, {}, IMPOSSIBLE, text, rivals=rivals)


def find_number_formats(rates: Array, used: Mask, usable: Mask, parts: Sequence[slice], sigma: float) -> NumberFormats:
    """Find the lattices that readings (n, 3), rad/s, lie on, and how readings came there.

    The samples `used` are inside the intervals, `usable` ones were measured, `parts` are the samples of each interval, and
    `sigma` is the noise of a reading.
    """
    steps = np.array([find_lattice_step(rates[used, axis]) for axis in range(3)])
    coarse = steps > COARSE * sigma
    # A finer one is of no consequence if readings were rounded; cut ones are all half a step too near to zero.
    worth = ~coarse & (sigma > 0) & (0.5 * steps * np.sqrt(used.sum()) > WORTH * sigma)
    odds = compute_log_odds(rates, parts, usable, np.where(coarse | worth, steps, 0.0), sigma)
    odds[np.abs(odds) < DECIDED] = 0.0
    coarse = coarse | (worth & (odds > 0))
    # Readings that keep their sign and are cut toward zero are rounded ones but for a constant.
    both_signs = bool((coarse & (rates[used].min(axis=0) < 0) & (rates[used].max(axis=0) > 0)).any())
    cut = coarse & both_signs & (odds > 0)
    return NumberFormats(steps, odds, coarse, cut, coarse & (expit(odds) > POSSIBLE))


def compute_log_odds(rates: Array, parts: Sequence[slice], usable: Mask, steps: Array, sigma: float) -> Array:
    """Compute the log odds (3,) of cutting against rounding for each gyro; gyros with the same step have one converter.

    A step of zero leaves a gyro out; the other arguments are those of `find_number_formats`.
    """
    own = np.zeros(3)
    for axis in np.flatnonzero(steps > 0):
        rounded, cut = compute_log_likelihood([rates[p, axis][usable[p]] for p in parts], steps[axis], sigma)
        own[axis] = cut - rounded
    alike = np.abs(steps - steps[:, None]) < SAME * steps[:, None]
    return np.asarray(alike @ own)


def compute_log_likelihood(parts: Iterable[Array], step: float, sigma: float) -> Array:
    """Compute the (2,) log likelihoods of the formats from runs of one gyro's readings; noise before rounding in rad/s."""
    blocks = [np.round(x[: x.size // BLOCK * BLOCK] / step).reshape(-1, BLOCK) for x in parts]
    counts = np.concatenate([np.empty((0, BLOCK)), *blocks])
    counts = counts[(counts.min(axis=1) <= 1) & (counts.max(axis=1) >= -1) & (np.ptp(counts, axis=1) > 0)]
    left = counts - counts @ _build_polynomial_projection()
    noise = (sigma / step) ** 2 + 1 / 12
    counts = counts[np.sum(left**2, axis=1) < LOUD**2 * noise * (BLOCK - DEGREE - 1)]
    passes = (counts.min(axis=1) < -1) & (counts.max(axis=1) > 1)
    if sigma < DITHERED * step:
        counts, passes = counts[passes], passes[passes]
    if not len(counts):
        return np.zeros(len(FORMATS))
    chosen = np.unique(np.linspace(0, len(counts) - 1, min(len(counts), MOST_BLOCKS)).astype(np.intp))
    return np.array([_sum_over_blocks(*compute_bins(counts[chosen], name), passes[chosen]) for name in FORMATS])


def compute_bins(counts: Array, name: str) -> tuple[Array, Array]:
    """Compute the lower and upper edges of the bins of some counts, in steps."""
    size, sign = np.abs(counts), np.where(counts < 0, -1.0, 1.0)
    if name == "cut":
        low, high = np.where(size > 0, size, -1.0), size + 1.0
    else:
        low, high = size - 0.5, size + 0.5
    return np.minimum(sign * low, sign * high), np.maximum(sign * low, sign * high)


def _sum_over_blocks(low: Array, high: Array, passes: Mask) -> float:
    """Log likelihood of all blocks (k, `block`) of bins; integrated over the phase of those that pass through zero."""
    onto = _build_polynomial_projection()
    y, variance = 0.5 * (low + high), (high - low) ** 2 / 12
    for _ in range(ROUNDS):
        mean = y @ onto
        sigma = np.sqrt(np.maximum(np.mean((y - mean) ** 2 + variance, axis=1, keepdims=True), LEAST_SIGMA**2))
        a, b = (low - mean) / sigma, (high - mean) / sigma
        inside = np.maximum(_compute_normal_mass(a, b), LEAST_CELL_PROBABILITY)
        at_a, at_b = (np.exp(-0.5 * edge**2) / np.sqrt(2 * np.pi) for edge in (a, b))
        shift = (at_a - at_b) / inside
        y = np.clip(mean + sigma * shift, low, high)
        variance = np.clip(sigma**2 * (1 + (a * at_a - b * at_b) / inside - shift**2), 0.0, (high - low) ** 2 / 4)
    shifts = np.array(SHIFTS)
    shifted = mean[:, None] + shifts[:, None]
    likely = np.log(
        np.maximum(
            _compute_normal_mass(low[:, None] - shifted, high[:, None] - shifted, sigma[:, None]), LEAST_CELL_PROBABILITY
        )
    ).sum(axis=2)
    whole = logsumexp(likely, axis=1) + np.log(shifts[1] - shifts[0])
    return float(np.where(passes, whole, likely.max(axis=1)).sum())


def _build_polynomial_projection() -> Array:
    """(`block`, `block`) projection onto polynomials."""
    q, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, BLOCK), DEGREE + 1))
    return np.asarray(q @ q.T)


def _compute_normal_mass(low: Array, high: Array, sigma: Array | float = 1.0) -> Array:
    """Probability of a normal variable between two edges, exact in both tails."""
    a, b = low / sigma, high / sigma
    flipped = a > 0
    return np.asarray(ndtr(np.where(flipped, -a, b)) - ndtr(np.where(flipped, -b, a)))


def undo_lattices(stream: Stream, formats: NumberFormats) -> tuple[Stream, Mask]:
    """Undo what lattices do to slow rates, and add the noise that they make; also which gyros hide slow motion for long."""
    rates, density, hidden = stream.rates.copy(), stream.density.copy(), np.zeros(3, dtype=bool)
    sample_s = stream.recording.gyro.sample_s
    for axis in np.flatnonzero(formats.coarse):
        step, kind = float(formats.steps[axis]), FORMATS[int(formats.cut[axis])]
        density[:, axis] += step**2 / 12 * sample_s
        for part in find_interval_slices(stream.recording):
            rates[part, axis], factor, more = undo_lattice(rates[part, axis], sample_s, step, stream.sigma, kind)
            density[part, axis] = density[part, axis] * factor + more
            hidden[axis] |= bool(np.mean(more > 0) > HIDDEN)
    return replace(stream, rates=rates, density=density), hidden


def find_lattice_step(x: Array) -> float:
    """Find the step of the lattice that all values (n,) lie on; 0 if there is none."""
    values = np.unique(x)
    if values.size < 3:
        return 0.0
    gaps = np.diff(values)
    gaps = gaps[gaps > 1e-9 * max(float(np.abs(values).max()), 1e-30)]
    if not gaps.size:
        return 0.0
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    order = np.argsort(np.abs(values))
    for share in (0.01, 0.1, 1.0):
        chosen = values[order[: max(3, int(share * values.size))]]
        counts = np.round(chosen / step)
        if np.any(counts):
            step = float(counts @ chosen / (counts @ counts))
    off = np.abs(values / step - np.round(values / step))
    allowed = EXACT + PRINTED * np.abs(values / step)
    told = allowed < UNTOLD
    exact = off.max() < EXACT or (told.sum() >= FEWEST_TOLD and bool((off < allowed)[told].all()))
    return step if exact else 0.0


def compute_mean_reading(x: Array, step: float, sigma: float, kind: Kind) -> Array:
    """f(x): mean reading at true readings x with noise sigma, within `REACH` steps of zero."""
    shift = 0.5 if kind == "rounded" else 1.0
    out = np.zeros_like(x)
    for k in range(REACH + 8):
        edge = (k + shift) * step
        out += ndtr((x - edge) / sigma) - ndtr((-x - edge) / sigma)
    return out * step


def undo_lattice(x: Array, sample_s: float, step: float, sigma: float, kind: Kind) -> tuple[Array, Array, Array]:
    """Undo a lattice as far as the slow part of readings x (n,) of one interval goes; step and noise in rad/s.

    Returns the readings, what to multiply their noise density with, and what to add to it, rad²/s; (n,) each.
    """
    counts = np.round(x / step)
    half = 0.5 * step * np.sign(counts) if kind == "cut" else np.zeros_like(x)
    if (kind == "rounded" and sigma > SPREAD * step) or sigma > FINE * step:
        return x + half, np.ones_like(x), np.zeros_like(x)
    count = min(max(FEW, round(MEAN_S / sample_s)), x.size)
    mean = scipy.ndimage.uniform_filter1d(x, count, mode="nearest")
    few = scipy.ndimage.uniform_filter1d(x, min(FEW, x.size), mode="nearest")
    # A long mean of a fast swing stands still; that of few readings does not.
    moving = (np.abs(np.gradient(mean)) * count > step) | (np.abs(few - mean) > step + 4 * sigma / np.sqrt(FEW))
    # Away from zero the stairs are all alike, and cut readings are rounded ones half a step nearer to zero.
    stair = np.linspace(-0.5, 0.5, 401) * step
    level = np.round(mean / step) * step
    true, slope = _invert_mean_reading(
        mean - level, stair, compute_mean_reading(stair, step, max(sigma, 1e-3 * step), "rounded")
    )
    true = true + level
    if kind == "cut":
        near = np.abs(mean) < (REACH - 2) * step
        grid = np.linspace(-REACH, REACH, 4001) * step
        low, low_slope = _invert_mean_reading(mean, grid, compute_mean_reading(grid, step, max(sigma, 1e-3 * step), "cut"))
        true = np.where(near, low, true + 0.5 * step * np.sign(mean))
        slope = np.where(near, low_slope, slope)
    factor = np.where(moving, 1.0, 1.0 / np.clip(slope, LEAST_SLOPE, 1.0) ** 2)
    # On a flat stair the rate may be anywhere in between, and stay there for a while.
    hidden = np.where(~moving & (slope < FLAT), step**2 / 12 * MEAN_S, 0.0)
    width = step * np.where((kind == "cut") & (counts == 0), 2.0, 1.0)
    turning = np.where(moving, width**2 / 12 * (measure_hold_times(counts, sample_s) - sample_s), 0.0)
    return x + np.where(moving, half, true - mean), factor, hidden + turning


def measure_hold_times(counts: Array, sample_s: float) -> Array:
    """Measure the time for which each reading's error keeps its sign, s; one sample if the rate passes through its step.

    A rate that turns round inside a step is in error by up to half of it, on one side, for as long as it stays there.
    """
    first = np.flatnonzero(np.append(True, np.diff(counts) != 0))
    length = np.diff(np.append(first, counts.size))
    way = np.sign(np.diff(counts[first]))
    passes = np.append(0, way) * np.append(way, 0) > 0
    return np.repeat(np.where(passes, 1, length), length) * sample_s


def _invert_mean_reading(mean: Array, grid: Array, curve: Array) -> tuple[Array, Array]:
    """True readings whose mean is given, and the slope of the mean there."""
    # The grid is symmetric about zero: on a flat stair its middle is taken, not an edge.
    rising = np.maximum.accumulate(curve + 1e-9 * grid)
    true = np.interp(mean, rising, grid)
    return true, np.interp(true, grid, np.gradient(curve, grid))
