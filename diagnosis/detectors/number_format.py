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
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logsumexp, ndtr

from diagnosis.detectors.lattice import Kind, find_lattice_step, undo_lattice
from diagnosis.detectors.sample_report import AXES, IMPOSSIBLE, Findings, SampleTest, Stream, Symptom
from simulator.effects.recording_view import find_interval_slices

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

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


@dataclass(frozen=True)
class NumberFormats:
    """Number formats of the readings of three gyros."""

    steps: Array  # (3,) step of the lattice that readings lie on, rad/s; zero if on none
    log_odds: Array  # (3,) that readings were cut and not rounded, zero where the samples leave it open
    coarse: Mask  # (3,) whether the lattice matters beside the noise
    cut: Mask  # (3,) whether readings are taken as cut toward zero
    may_be_rounded: Mask  # may_be_rounded, may_be_cut: (3,) whether that is possible
    may_be_cut: Mask

    def describe(self) -> Findings:
        """Describe the lattice of each gyro; gyros on one lattice are one departure."""
        names = np.where(self.cut, "lattice_cut", "lattice_rounded")
        tests = tuple(self._describe_test(axis, str(names[axis])) for axis in range(3))
        symptoms: list[Symptom] = []
        for kind in ("lattice_rounded", "lattice_cut"):
            axes = np.flatnonzero(self.coarse & (names == kind))
            steps = self.steps[axes]
            common = axes.size == 3 and np.ptp(steps) < SAME * steps.mean()
            each = [(None, axes[0], steps.mean())] if common else [(AXES[k], k, self.steps[k]) for k in axes]
            symptoms += [self._describe_lattice(kind, name, int(axis), float(step)) for name, axis, step in each]
        return Findings(tests, tuple(symptoms))

    def _describe_test(self, axis: int, kind: str) -> SampleTest:
        step = float(np.rad2deg(self.steps[axis]))
        text = "readings lie on no lattice that matters beside the noise"
        if self.coarse[axis]:
            text = f"all readings are multiples of {step:.4g} deg/s"
        return SampleTest("lattice_step", AXES[axis], step, 0.0, IMPOSSIBLE if self.coarse[axis] else 1.0, kind, text)

    def _describe_lattice(self, kind: str, name: str | None, axis: int, step: float) -> Symptom:
        size = float(np.rad2deg(step))
        text = f"all readings are multiples of {size:.4g} deg/s, {'cut toward zero' if kind == 'lattice_cut' else 'rounded'}"
        cut = float(expit(self.log_odds[axis]))
        other, share = ("lattice_rounded", 1 - cut) if kind == "lattice_cut" else ("lattice_cut", cut)
        rivals = ((other, share),) if share > POSSIBLE else ()
        return Symptom(kind, name, size, "deg/s", 1e-6 * size, {}, IMPOSSIBLE, text, rivals=rivals)


def find_number_formats(rates: Array, used: Mask, usable: Mask, parts: Sequence[slice], sigma: float) -> NumberFormats:
    """Find the lattices that readings lie on, and how readings came there.

    Parameters
    ----------
    rates : (n, 3) readings, rad/s
    used, usable : (n,) samples inside the intervals, and samples that were measured
    parts : samples of each interval
    sigma : noise of a reading, rad/s
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
    may_be_rounded, may_be_cut = (coarse & (expit(sign * odds) > POSSIBLE) for sign in (-1, 1))
    return NumberFormats(steps, odds, coarse, cut, may_be_rounded, may_be_cut)


def compute_log_odds(rates: Array, parts: Sequence[slice], usable: Mask, steps: Array, sigma: float) -> Array:
    """Compute the log odds (3,) of cutting against rounding for each gyro; gyros with the same step have one converter.

    Parameters
    ----------
    rates : (n, 3) readings, rad/s
    parts : samples of each interval
    usable : (n,) samples that were measured
    steps : (3,) of the lattices, rad/s, zero for a gyro that is left out
    sigma : noise of a reading before it was put on the lattice, rad/s
    """
    own = np.zeros(3)
    for axis in np.flatnonzero(steps > 0):
        rounded, cut = compute_log_likelihood([rates[p, axis][usable[p]] for p in parts], steps[axis], sigma)
        own[axis] = cut - rounded
    alike = np.abs(steps - steps[:, None]) < SAME * steps[:, None]
    return np.asarray(alike @ own)


def compute_log_likelihood(parts: Iterable[Array], step: float, sigma: float) -> Array:
    """Compute the (2,) log likelihoods of the formats from one gyro's readings.

    Parameters
    ----------
    parts : readings that follow one another without a gap, rad/s, each (n,)
    step : of the lattice, rad/s
    sigma : noise of a reading before it was put on the lattice, rad/s
    """
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
