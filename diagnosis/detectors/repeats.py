"""Samples that repeat the one before on all axes at once: a mixture of telemetry faults and of chance.

Continuous noise never repeats. Readings of a coarse number format do, and all axes at once with a probability C, the product
of their shares e. Those shares are taken among the samples that do not repeat on all axes, so that with the probability
p = e (1 − C) + C of each axis, C = ∏ p follows by iteration. Readings repeat where the rate is steady: the shares are those of
samples near in time whose rate changes as fast. Axes may repeat together for another reason, such as the mixing of a
calibration in the sensor. Repeats of two axes without the third one, which are no fault, show how often.

With a share f of faults a sample repeats with the probability f + (1 − f) C. The likelihood ratio of the best f against f = 0
is the test (Wilks; f lies on the boundary, which halves the p-value), and f/(f + (1 − f) C) is the probability that a repeat is
a fault. The number of chance repeats is uncertain by a few percent, and the evidence is lowered by that.

A fault is followed by another one with the probability r = 1 − 1/size, for runs of the mean length `size`. Each of two
neighbours may also repeat by chance, so that pairs exceed chance by r + 2 (1 − r) C of the faults.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage
import scipy.optimize
import scipy.special

from diagnosis.detectors.gap_interpolation import fill_gaps
from diagnosis.detectors.sample_report import IMPOSSIBLE, Findings, SampleTest, Stream, Symptom, mark_consecutive_samples
from gyrocal.arrays import Array, Mask
from gyrocal.mask_runs import find_mask_runs

NEARBY = 1500  # samples of a stretch of time in which the share of repeats is taken; short beside an orbit
ALIKE = 101  # of these, samples with nearly the same change of rate, over which it is taken
FEWEST_ALIKE = 10  # samples among these that do not repeat on all axes, below which chance may repeat all
SIDE = 2  # samples on either side of a repeat that are left out where the change of rate is taken
LEAST_CHANCE = 1e-3  # probability by chance on a number format, below which no estimate from so few samples goes
ALONE = 1e-3  # share of samples that repeat on one axis only, from which on repeats by chance are possible at all
MOST_CHANCE = 0.99  # the same, above which it is not certain either
# gain of the log likelihood by a common probability of two axes, from which on these are not independent; odds of 2e4
TIED = 10.0
# sigma of the number of repeats by chance, relative to it; it is off by 8 % on swaying bodies and coarse lattices
ROUGH = 0.1
MOST = 0.5  # share of all samples that repeat by chance, above which faults cannot be told
FEWEST = 500  # samples, below which nothing is said
SURE = 0.9  # probability of a fault from which on a sample is bridged
FAR = 8.0  # noise sigmas from its neighbours at which a value was not measured


@dataclass(frozen=True)
class Repeats:
    """Repeated samples."""

    count: int  # count, samples, expected: repeats among the samples looked at, and how many of them chance makes
    samples: int
    expected: float
    p_value: float  # of that
    fraction: float  # share of the samples that are faults
    size: float  # size, sigma: mean length of a run of faults and its sigma, samples
    sigma: float
    mask: Mask  # (n,) samples that are surely faults


def find_repeats(rates: Array, follows: Mask) -> Repeats | None:
    """Find samples of rates (n, 3) that repeat the one before on all axes; None where faults and chance look the same.

    Only samples that directly follow one of the same interval, `follows` (n,), are tested.
    """
    equal = np.zeros(rates.shape, dtype=bool)
    equal[1:] = rates[1:] == rates[:-1]
    joint = equal.all(axis=1) & follows
    n, count = int(follows.sum()), int(joint.sum())
    if n < FEWEST:
        return None
    chance, sigma = np.zeros(len(rates)), 0.0
    if ((equal & ~joint[:, None])[follows].mean(axis=0) > ALONE).all():
        chance = np.maximum(_compute_chance(equal, rates, follows), LEAST_CHANCE)
        sigma = ROUGH * float(chance[follows].sum())
        if max(count, float(chance[follows].sum())) > MOST * n:
            return None
    expected = float(chance[follows].sum())
    fraction, p = _test_share(joint[follows], chance[follows], sigma)
    posterior = np.where(joint, fraction / np.maximum(fraction + (1 - fraction) * chance, 1e-300), 0.0)
    size, error = _estimate_run(joint & follows, chance, follows)
    return Repeats(count, n, expected, p, fraction, size, error, np.asarray(posterior > SURE))


def _test_share(joint: Mask, chance: Array, sigma: float) -> tuple[float, float]:
    """Estimate the share of faults and the p-value that there are none; `sigma` is that of the number of repeats by chance."""
    count = int(joint.sum())
    if not count:
        return 0.0, 1.0
    if not chance.any():
        return count / joint.size, IMPOSSIBLE if count >= 3 else 1.0

    def compute_log_likelihood(log_share: float) -> float:
        """Compute the log likelihood of the repeats if a share of the samples repeats by faults and others by chance."""
        share = np.exp(log_share)
        p_repeat = share + (1 - share) * chance
        return float(np.sum(np.log(np.where(joint, p_repeat, 1 - p_repeat))))

    fit = scipy.optimize.minimize_scalar(
        lambda x: -compute_log_likelihood(x), bounds=(np.log(0.1 / joint.size), np.log(0.99)), method="bounded"
    )
    share = float(np.exp(fit.x))
    without_faults = float(np.sum(np.log(np.where(joint, chance, 1 - chance))))
    # An error of the number of repeats by chance reduces the evidence.
    weight = 1 / (1 + sigma**2 / max(float(np.sum(chance * (1 - chance))), 1e-300))
    ratio = max(-float(fit.fun) - without_faults, 0.0) * weight
    return share, max(0.5 * float(scipy.special.chdtrc(1, 2 * ratio)), IMPOSSIBLE)


def _compute_chance(equal: Mask, rates: Array, follows: Mask) -> Array:
    """Compute the probability (n,) that all axes repeat by chance."""
    n = len(rates)
    after, before = np.minimum(np.arange(n) + SIDE, n - 1), np.maximum(np.arange(n) - SIDE - 1, 0)
    change = np.abs(rates[after] - rates[before])
    others = follows & ~equal.all(axis=1)
    shares = np.column_stack([_average_alike(equal[:, k], others, change[:, k]) for k in range(equal.shape[1])])
    C = _solve_product(shares)
    by_axis = shares * (1 - C)[:, None] + C[:, None]
    joint, best = by_axis.prod(axis=1), TIED
    for axis in range(equal.shape[1]):
        pair, third_differs = np.asarray(np.delete(equal, axis, axis=1).all(axis=1)), follows & ~equal[:, axis]
        dependent = _average_alike(pair, third_differs, np.delete(change, axis, axis=1).max(axis=1))
        independent = np.delete(by_axis, axis, axis=1).prod(axis=1)
        gain = _compute_log_likelihood(pair[third_differs], dependent[third_differs]) - _compute_log_likelihood(
            pair[third_differs], independent[third_differs]
        )
        if gain > best:
            joint, best = by_axis[:, axis] * dependent, gain
    return np.asarray(np.minimum(joint, MOST_CHANCE))


def _compute_log_likelihood(event: Mask, chance: Array) -> float:
    p = np.clip(chance, 1e-4, 1 - 1e-4)
    return float(np.sum(np.log(np.where(event, p, 1 - p))))


def _average_alike(repeats: Mask, where: Mask, change: Array) -> Array:
    """Compute the share (n,) of repeats among the other samples of a mask near in time whose rate changes as fast."""
    share = np.zeros(repeats.size)
    for part in np.array_split(np.arange(repeats.size), max(1, repeats.size // NEARBY)):
        order = part[np.argsort(change[part], kind="stable")]
        samples, repeated = _count(where[order], ALIKE), _count((repeats & where)[order], ALIKE)
        # Where nearly all samples repeat on all axes, nothing shows that chance does not do it.
        share[order] = np.where(samples < FEWEST_ALIKE, 1.0, repeated / np.maximum(samples, 1.0))
    return share


def _solve_product(shares: Array) -> Array:
    """Solve C = ∏ (e (1 − C) + C) for C (n,), with the shares e (n, 3)."""
    C = np.prod(shares, axis=1)
    for _ in range(30):
        C = np.prod(shares * (1 - C)[:, None] + C[:, None], axis=1)
    return np.asarray(C)


def _count(mask: Mask, width: int) -> Array:
    """Count the marked samples (n,) in a window around each sample, without itself."""
    values = mask.astype(float)
    return np.asarray(width * scipy.ndimage.uniform_filter1d(values, width, mode="nearest") - values)


def _estimate_run(joint: Mask, chance: Array, follows: Mask) -> tuple[float, float]:
    """Estimate the mean length of the runs of faults and its sigma."""
    count, pairs = int(joint.sum()), int(np.sum(joint[1:] & joint[:-1]))
    c = float(chance[follows].mean())
    faults = max((count - c * follows.sum()) / (1 - c), 1.0)
    follow = (pairs - float(np.sum((chance[1:] * chance[:-1])[follows[1:] & follows[:-1]]))) / faults
    ratio = float(np.clip((follow - 2 * c) / (1 - 2 * c), 0.0, 0.95))
    error = np.sqrt(max(pairs, 1) + ratio**2 * count) / faults
    size = 1 / (1 - ratio)
    return size, float(size**2 * error)


def bridge_repeats(stream: Stream, event_p: float) -> tuple[Findings, Stream]:
    """Find samples that repeat the one before on all axes, and fill those that surely are faults with lines."""
    rates, gyro = stream.rates, stream.recording.gyro
    # A clipped reading stands at the largest one.
    is_largest = (np.abs(rates) >= np.abs(rates[stream.used]).max(axis=0) * (1 - 1e-12)).any(axis=1)
    repeats = find_repeats(rates, mark_consecutive_samples(stream.recording, stream.used) & ~is_largest)
    if repeats is None:
        return Findings(), stream
    test = SampleTest(
        "repeated_share", None, repeats.count / repeats.samples, repeats.expected / repeats.samples, repeats.p_value,
        "repeats", f"{repeats.count} of {repeats.samples} samples repeat the one before on all axes",
    )  # fmt: skip
    if repeats.p_value >= event_p:
        return Findings((test,)), stream
    kind, text = "repeats", ""
    if not is_measured(gyro.rates, repeats.mask):
        kind, text = "filled_samples", "samples repeat a value that is far from its neighbours, so that it was filled in"
    parameters: dict[str, float | str] = {"fraction": repeats.fraction}
    symptom = Symptom(kind, None, repeats.size, "samples", repeats.sigma, parameters, repeats.p_value, text)
    rates, factor, density = fill_gaps(gyro.t_s, rates, repeats.mask, gyro.sample_s, stream.sigma)
    density = stream.density * factor[:, None] + density
    return Findings((test,), (symptom,)), replace(stream, rates=rates, density=density, filled=stream.filled | repeats.mask)


def is_measured(rates: Array, repeated: Mask) -> bool:
    """Check whether the values that repeat lie among their neighbours, as samples held over do and filler does not."""
    edges = [(low, high) for low, high in find_mask_runs(repeated) if low >= 3 and high + 1 < len(rates)]
    if not edges:
        return True
    low, high = np.array(edges).T
    source, before, after = rates[low - 1], rates[low - 2], rates[high]
    share = 1.0 / (high - low + 2)[:, None]
    departure = np.abs(source - (before + share * (after - before)))
    noise = np.median(np.abs(np.diff(rates, 2, axis=0)), axis=0) / 0.6745 / np.sqrt(6)
    # On a lattice coarser than the noise both terms may be zero; a value equal to its neighbours has no departure then.
    limit = np.maximum(np.maximum(FAR * noise, np.abs(after - before)), 1e-300)
    return bool(np.median((departure / limit).max(axis=1)) < 1)
