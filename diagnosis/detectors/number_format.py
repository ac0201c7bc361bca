"""Number formats of readings on a lattice: log likelihood of rounding, cutting toward zero and a dead zone of one step.

All formats put a reading x into a bin and differ in the bins about zero, in steps:

    rounded    (k − ½, k + ½)                                      `numpy.round`
    floored    (k, k + 1)                                          an analogue converter
    cut        (−1, 1) for zero, (k, k + 1) above, mirrored below  a cast to an integer
    dead zone  (−1, 1) for zero, (1, 1.5) for one, then as rounded

Floored readings are rounded ones less half a step, which the bias takes up: the two are one hypothesis. Readings that keep one
sign cannot tell cut from floored ones for the same reason.

Short blocks of readings whose bins reach zero have a cubic mean and normal noise. For each format the maximum likelihood of the
interval-censored block follows by expectation maximisation (Dempster, Laird and Rubin, JRSS B 39, 1977). Blocks whose residuals
exceed the noise hold a motion that is no cubic, such as the end of a turn, and are left out. A block that passes from one side
of zero to the other has a random phase to the lattice, over which its likelihood is integrated. A block that rests has no
random phase, since a body rests at the same rate again: its likelihood is the maximum, and noise below half a step leaves it
alike for all formats. Prior weights are those of the effects: truncation is as plausible as rounding, since both are one line
of code. A dead zone has the share of its log-uniform sizes that are one step.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, ndtr

from diagnosis.detectors.lattice import Kind, find_lattice_step, undo_lattice
from diagnosis.detectors.report import AXES, IMPOSSIBLE, Findings, SampleTest, Stream, Symptom
from simulator.effects import ALL_EFFECTS
from simulator.effects.recorded import interval_slices

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FORMATS = ("rounded", "cut", "dead_zone")
SYMPTOMS = ("lattice_rounded", "lattice_cut", "dead_zone")  # of the formats, see `simulator.effects.base.SYMPTOMS`
BLOCK = 16  # readings
DEGREE = 3  # of the mean
LOUD = 1.6  # root mean square of a block's residuals over the noise, above which the polynomial misses its motion
MOST_BLOCKS = 1000  # of one axis, evenly chosen
ROUNDS = 25  # of expectation maximisation
LEAST_SIGMA = 0.05  # steps
DITHERED = 0.4  # noise in steps, from which on a rest reaches more bins than one
PHASES = np.linspace(-2.0, 2.0, 33)  # steps, shifts of the mean over which a block is integrated
TINY = 1e-12
ONE_STEP = 1.5  # factor either way within which a dead zone is one step wide
SAME = 0.01  # relative difference of the steps of one converter
COARSE = 0.2  # a lattice finer than this share of the noise is a number format: its rounding has 0.3 % of the power
WORTH = 3.0  # sigmas of the angle random walk over all samples, that half steps must turn by for a finer lattice to matter
DECIDED = 8.0  # log odds of one number format from which on the references are not compared, and a finer lattice matters
HIDDEN = 0.1  # share of an interval in which a lattice hides the rate, from which on the gyro is blind there
OPEN = 0.05  # probability of another number format, from which on it is reported


@dataclass(frozen=True)
class NumberFormats:
    """Number formats of the readings of three gyros.

    Attributes
    ----------
    steps : (3,) step of the lattice that readings lie on, rad/s; zero if on none
    log_posterior : (3, 3) of each format for each gyro
    coarse : (3,) whether the lattice matters beside the noise
    cut : (3,) whether readings are taken as cut toward zero
    may_be_rounded, may_be_cut : (3,) whether that is possible
    cut_odds : log odds that readings were cut and not rounded, where the samples leave that open; else None
    """

    steps: Array
    log_posterior: Array
    coarse: Mask
    cut: Mask
    may_be_rounded: Mask
    may_be_cut: Mask
    cut_odds: float | None

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
        shares = zip(SYMPTOMS, np.exp(self.log_posterior[axis]).tolist(), strict=True)
        rivals = tuple((other, share) for other, share in shares if other != kind and share > OPEN)
        return Symptom(kind, name, size, "deg/s", 1e-6 * size, {}, IMPOSSIBLE, text, rivals=rivals)


def find_number_formats(
    rates: Array, used: Mask, usable: Mask, parts: Sequence[slice], sigma: float, lattice: Kind | None = None
) -> NumberFormats:
    """Find the lattices that readings lie on, and how readings came there.

    Parameters
    ----------
    rates : (n, 3) readings, rad/s
    used, usable : (n,) samples inside the intervals, and samples that were measured
    parts : samples of each interval
    sigma : noise of a reading, rad/s
    lattice : how readings came onto a lattice, if that is known
    """
    steps = np.array([find_lattice_step(rates[used, axis]) for axis in range(3)])
    coarse = steps > COARSE * sigma
    # A finer one is of no consequence if readings were rounded; cut ones are all half a step too near to zero.
    worth = ~coarse & (sigma > 0) & (0.5 * steps * np.sqrt(used.sum()) > WORTH * sigma)
    log_posterior = compute_log_posterior(rates, parts, usable, np.where(coarse | worth, steps, 0.0), sigma)
    odds = log_posterior[:, 1] - log_posterior[:, 0]
    coarse = coarse | (worth & (odds > DECIDED))
    # Readings that keep their sign and are cut toward zero are rounded ones but for a constant.
    both_signs = bool((coarse & (rates[used].min(axis=0) < 0) & (rates[used].max(axis=0) > 0)).any())
    cut = coarse & both_signs & (odds > 0 if lattice is None else lattice == "cut")
    if lattice is not None:
        return NumberFormats(steps, log_posterior, coarse, cut, coarse & ~cut, cut, None)
    strongest, mixed = float(odds[np.argmax(np.abs(odds))]), bool(cut.any() and (coarse & ~cut).any())
    is_open = both_signs and not mixed and abs(strongest) < DECIDED
    may_be_rounded, may_be_cut = (coarse & (log_posterior[:, k] > np.log(OPEN)) for k in (0, 1))
    return NumberFormats(steps, log_posterior, coarse, cut, may_be_rounded, may_be_cut, strongest if is_open else None)


def compute_log_prior(step: float) -> Array:
    """Compute the (3,) log prior probabilities of the formats; `step` in deg/s."""
    quantized, truncated, zone = (ALL_EFFECTS[f"rate_{name}"] for name in ("quantization", "truncation", "deadzone"))
    low, high = np.log(zone.prior)
    inside = np.clip([np.log(step / ONE_STEP), np.log(step * ONE_STEP)], low, high)
    share = max(float(np.diff(inside)[0]) / (high - low), TINY)
    weights = np.log([quantized.weight, truncated.weight, zone.weight * share])
    return np.asarray(weights - logsumexp(weights))


def compute_log_posterior(rates: Array, parts: Sequence[slice], usable: Mask, steps: Array, sigma: float) -> Array:
    """Compute the log posterior of each format for each gyro, (3, 3); gyros with the same step have one converter.

    Parameters
    ----------
    rates : (n, 3) readings, rad/s
    parts : samples of each interval
    usable : (n,) samples that were measured
    steps : (3,) of the lattices, rad/s, zero for a gyro that is left out
    sigma : noise of a reading before it was put on the lattice, rad/s
    """
    asked = np.flatnonzero(steps > 0)
    found = np.full((len(steps), len(FORMATS)), -np.log(len(FORMATS)))
    likely = {axis: compute_log_likelihood([rates[p, axis][usable[p]] for p in parts], steps[axis], sigma) for axis in asked}
    for axis in asked:
        alike = [other for other in asked if abs(steps[other] - steps[axis]) < SAME * steps[axis]]
        joint = compute_log_prior(float(np.rad2deg(steps[axis]))) + np.sum([likely[other] for other in alike], axis=0)
        found[axis] = joint - logsumexp(joint)
    return found


def compute_log_likelihood(parts: Iterable[Array], step: float, sigma: float) -> Array:
    """Compute the (3,) log likelihoods of the formats from one gyro's readings.

    Parameters
    ----------
    parts : readings that follow one another without a gap, rad/s, each (n,)
    step : of the lattice, rad/s
    sigma : noise of a reading before it was put on the lattice, rad/s
    """
    blocks = [np.round(x[: x.size // BLOCK * BLOCK] / step).reshape(-1, BLOCK) for x in parts]
    counts = np.concatenate([np.empty((0, BLOCK)), *blocks])
    counts = counts[(counts.min(axis=1) <= 1) & (counts.max(axis=1) >= -1) & (np.ptp(counts, axis=1) > 0)]
    left = counts - counts @ _projection()
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
    if name == "dead_zone":
        low, high = np.select([size == 0, size == 1], [-1.0, 1.0], low), np.where(size == 0, 1.0, high)
    return np.minimum(sign * low, sign * high), np.maximum(sign * low, sign * high)


def _sum_over_blocks(low: Array, high: Array, passes: Mask) -> float:
    """Log likelihood of all blocks (k, `BLOCK`) of bins; integrated over the phase of those that pass through zero."""
    onto = _projection()
    y, variance = 0.5 * (low + high), (high - low) ** 2 / 12
    for _ in range(ROUNDS):
        mean = y @ onto
        sigma = np.sqrt(np.maximum(np.mean((y - mean) ** 2 + variance, axis=1, keepdims=True), LEAST_SIGMA**2))
        a, b = (low - mean) / sigma, (high - mean) / sigma
        inside = np.maximum(_mass(a, b), TINY)
        at_a, at_b = (np.exp(-0.5 * edge**2) / np.sqrt(2 * np.pi) for edge in (a, b))
        shift = (at_a - at_b) / inside
        y = np.clip(mean + sigma * shift, low, high)
        variance = np.clip(sigma**2 * (1 + (a * at_a - b * at_b) / inside - shift**2), 0.0, (high - low) ** 2 / 4)
    shifted = mean[:, None] + PHASES[:, None]
    likely = np.log(np.maximum(_mass(low[:, None] - shifted, high[:, None] - shifted, sigma[:, None]), TINY)).sum(axis=2)
    whole = logsumexp(likely, axis=1) + np.log(PHASES[1] - PHASES[0])
    return float(np.where(passes, whole, likely.max(axis=1)).sum())


def _projection() -> Array:
    """(`BLOCK`, `BLOCK`) projection onto polynomials."""
    q, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, BLOCK), DEGREE + 1))
    return np.asarray(q @ q.T)


def _mass(low: Array, high: Array, sigma: Array | float = 1.0) -> Array:
    """Probability of a normal variable between two edges, exact in both tails."""
    a, b = low / sigma, high / sigma
    flipped = a > 0
    return np.asarray(ndtr(np.where(flipped, -a, b)) - ndtr(np.where(flipped, -b, a)))


def undo_lattices(stream: Stream, formats: NumberFormats) -> tuple[Stream, Mask]:
    """Undo what lattices do to slow rates, and add the noise that they make; also which gyros hide slow motion for long."""
    rates, density, hidden = stream.rates.copy(), stream.density.copy(), np.zeros(3, dtype=bool)
    sample_s = stream.recording.gyro.sample_s
    for axis in np.flatnonzero(formats.coarse):
        step, kind = float(formats.steps[axis]), "cut" if formats.cut[axis] else "rounded"
        density[:, axis] += step**2 / 12 * sample_s
        for part in interval_slices(stream.recording):
            rates[part, axis], factor, more = undo_lattice(rates[part, axis], sample_s, step, stream.sigma, kind)
            density[part, axis] = density[part, axis] * factor + more
            hidden[axis] |= bool(np.mean(more > 0) > HIDDEN)
    return replace(stream, rates=rates, density=density), hidden
