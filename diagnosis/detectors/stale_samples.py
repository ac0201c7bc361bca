"""Samples that repeat the one before on all axes at once, against what a coarse lattice makes by chance.

Off a lattice no two readings are the same. On one, an axis repeats itself often where the rate is steady, and the axes all at
once with about the product of these chances nearby. Two ways of telling a fault of the telemetry from that:

Where two axes repeat together for another reason, as those that a calibration in the sensor has mixed, their common repeats
count as those of one axis.

- where the product is below `RARE`, as in slews, most repeats are faults, and can be bridged; those of chance stand alone. The
  chance of an axis is that of the samples nearby or that of samples anywhere whose rate changes as fast, whichever is larger:
  a body that sways turns about several axes at once, for less time than the chance nearby is taken over;
- elsewhere faults only add up: repeats on all axes at once are counted, and again with the axes shifted against one another by
  some samples, which leaves each axis as it is and takes away what they share. Faults show on all axes, so that among the other
  samples repeats on an axis have the share e_a = (c_a − C)/(1 − C), of chance alone, C = ∏ c_a, which gives C and how many
  repeats are faults. A fault is followed by another with the probability r = 1 − 1/size, for runs of mean length size; it or
  the sample before it may lie beside a repeat by chance, so that two in a row exceed chance by r + 2 (1 − r) C of one alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.ndimage
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.gap_interpolation import runs
from diagnosis.detectors.report import IMPOSSIBLE

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CHANCE_SAMPLES = 301  # over which the chance of a repeat on a lattice is taken
CHANCE_CHANGES = 101  # samples of nearly the same change of rate, over which it is taken, too
SIDE = 2  # samples on either side of a repeat that are left out where the change of rate is taken
RARE = 0.01  # chance of a repeat on all axes below which a repeat tells something
NEARLY = 5.0  # times that chance, up to which a run that was found goes on
FEWEST_TELLING = 500  # such samples, below which nothing is said
SHIFTS = tuple(k for n in range(3, 43, 2) for k in (n, -n))  # samples; enough to be past a run
EXCESS = 7.0  # sigmas of the excess over shifted axes
ROUNDS = 30  # of C = ∏ (e_a (1 − C) + C)
ROUGH = 0.15  # relative error of a mean run beside that of counting
LARGEST_SHARE = 0.5  # of all samples that repeat by chance, above which nothing is told


@dataclass(frozen=True)
class StaleSamples:
    """What was found.

    Attributes
    ----------
    count, samples, expected : repeats among the samples looked at, and how many of them chance makes
    p_value : of that
    size, sigma : mean run and its sigma, samples; NaN without a finding
    mask : (n,) samples that surely repeat
    """

    count: int
    samples: int
    expected: float
    p_value: float
    size: float
    sigma: float
    mask: Mask

    @property
    def fraction(self) -> float:
        """Share of the samples that repeat beyond chance."""
        return (self.count - self.expected) / self.samples


def stale_samples(rates: Array, equal: Mask, follows: Mask, coarse: Mask, event_p: float) -> StaleSamples | None:
    """Repeats on all axes; None where nothing can be told.

    Parameters
    ----------
    rates : (n, 3) readings
    equal : (n, 3) reads as the sample before
    follows : (n,) directly follows one, and may be judged
    coarse : (3,) axes on a lattice
    event_p : p-value below which repeats are a finding
    """
    telling, near, expected = follows, follows, 0.0
    if coarse.any():
        # On a lattice, readings repeat by chance where the rate is steady: only where that is rare can each be told.
        # Repeats of all axes count here as well, or places with few of the others would be chosen.
        in_motion = _share_at_change(equal, rates, follows)
        chance = _largest_product(equal, np.where(coarse, np.maximum(_share(equal), in_motion), 0.0))
        telling, near = follows & (chance < RARE), follows & (chance < NEARLY * RARE)
        expected = float(chance[telling].sum())
    joint = equal.all(axis=1) & telling
    n, count = int(telling.sum()), int(joint.sum())
    p = 1.0
    if n >= FEWEST_TELLING and count >= 3:
        p = max(float(scipy.stats.poisson.sf(count - 1, expected)), IMPOSSIBLE) if expected > 0 else IMPOSSIBLE
    if p < event_p:
        # A run raises the chance that is found near it, and may so pass the limit itself.
        whole = [(low, high) for low, high in runs(equal.all(axis=1) & near) if joint[low:high].any()]
        mask = np.zeros(len(joint), dtype=bool)
        for low, high in whole:
            mask[low:high] = True
        # Faults themselves raise the chance above, which makes the test careful and would make runs too long.
        alone = float(np.maximum(_chance(equal), in_motion.prod(axis=1))[telling].sum()) if coarse.all() else expected
        faulty = max(len(whole) - alone, 1.0)
        size = max((int(mask.sum()) - alone) / faulty, 1.0)
        # A run is at least one sample long, and about geometric; how many are of chance is uncertain as well.
        spread = float(np.hypot(np.sqrt(max(size * (size - 1), 0.05) / faulty), size * np.sqrt(2 * alone) / faulty))
        return StaleSamples(count, n, alone, p, size, spread, mask)
    together = _together(equal, follows, joint, in_motion.prod(axis=1)) if coarse.all() else None
    if together is not None and together.p_value < event_p:
        return together
    return StaleSamples(count, n, expected, p, float("nan"), float("nan"), joint) if n >= FEWEST_TELLING else together


def _largest_product(equal: Mask, each: Array) -> Array:
    """(n,) chance that all axes repeat, from that of each axis, or of two that repeat together and the third."""
    found = np.prod(each, axis=1)
    for axis in range(3):
        goes_on = ~equal[:, axis]  # samples without a fault
        both = _share(np.delete(equal, axis, axis=1).all(axis=1) & goes_on) / np.maximum(_share(goes_on), 1e-3)
        found = np.maximum(found, both * each[:, axis])
    return np.asarray(found)


def _together(equal: Mask, follows: Mask, sure: Mask, in_motion: Array) -> StaleSamples | None:
    """Repeats of all axes at once, beyond those of axes that are shifted against one another and those of their motion."""
    n = int(follows.sum())
    joint = equal.all(axis=1) & follows
    count = int(joint.sum())
    if n == 0 or count > LARGEST_SHARE * n:
        return None
    shifted = _shifted(equal, follows)
    # Fast motion does not outlast the shifts.
    expected = max(float(shifted.mean(axis=1).max()), float(in_motion[follows].sum()))
    sigma = float(max(shifted.std(axis=1).max(), 0.5 * np.sqrt(expected), 1.0))
    p = float(scipy.stats.norm.sf((count - expected) / sigma)) if count - expected > EXCESS * sigma else 1.0
    if p == 1.0:
        return StaleSamples(count, n, expected, p, float("nan"), float("nan"), sure)
    chance = _chance(equal)[follows]
    share = (count / n - float(chance.mean())) / (1 - float(chance.mean()))
    size, spread = _mean_run(joint[follows], chance)
    return StaleSamples(count, n, count - share * n, max(p, IMPOSSIBLE), size, spread, sure)


def _shifted(equal: Mask, where: Mask) -> Array:
    """Repeats of all axes at once if these were shifted, as many as there would be of all samples there.

    Rows are of all axes shifted against one another, and of each against the other two, by the shifts of the columns.
    """
    ways = np.vstack([[0, 1, 2], np.eye(3, dtype=int)])
    counts = np.empty((len(ways), len(SHIFTS)))
    for column, k in enumerate(SHIFTS):
        for row, way in enumerate(k * ways):
            valid = np.logical_and.reduce([np.roll(where, shift) for shift in set(way.tolist())])
            repeats = np.logical_and.reduce([np.roll(one, shift) for one, shift in zip(equal.T, way.tolist(), strict=True)])
            counts[row, column] = np.sum(valid & repeats) * where.sum() / max(int(valid.sum()), 1)
    return counts


def _chance(equal: Mask) -> Array:
    """(n,) chance that all axes repeat, from the repeats nearby that are not of all axes."""
    others = np.logical_not(equal.all(axis=1))
    e = _share(equal & others[:, None]) / np.maximum(_share(others), 1e-3)[:, None]
    C = np.prod(e, axis=1)
    for _ in range(ROUNDS):
        C = np.prod(e * (1 - C)[:, None] + C[:, None], axis=1)
    return np.asarray(C)


def _share_at_change(equal: Mask, rates: Array, follows: Mask) -> Array:
    """(n, 3) share of repeats among the samples whose rate changes as fast, by the readings on both sides of the repeat.

    A share of faults raises that of each axis, and the product of the axes by far less.
    """
    n = len(equal)
    after = np.minimum(np.arange(n) + SIDE, n - 1)
    before = np.maximum(np.arange(n) - SIDE - 1, 0)
    change = np.abs(rates[after] - rates[before])
    share = np.zeros(equal.shape)
    where = np.flatnonzero(follows)
    for axis in range(equal.shape[1]):
        order = where[np.argsort(change[where, axis], kind="stable")]
        share[order, axis] = scipy.ndimage.uniform_filter1d(equal[order, axis].astype(float), CHANCE_CHANGES, mode="nearest")
    return share


def _share(mask: Mask) -> Array:
    return np.asarray(scipy.ndimage.uniform_filter1d(mask.astype(float), CHANCE_SAMPLES, axis=0, mode="nearest"))


def _mean_run(joint: Mask, chance: Array) -> tuple[float, float]:
    """Mean length of the runs of faults and its sigma."""
    count, pairs = int(np.sum(joint)), int(np.sum(np.logical_and(joint[1:], joint[:-1])))
    excess = max(count - float(chance.sum()), 1.0)
    c = float(chance.mean())
    more = (pairs - float(chance[1:] @ chance[:-1])) / excess
    ratio = float(np.clip((more - 2 * c) / (1 - 2 * c), 0.0, 0.95))
    error = np.sqrt(max(pairs, 1) + ratio**2 * count) / excess
    size = 1 / (1 - ratio)
    return size, float(np.hypot(size**2 * error, ROUGH * size))
