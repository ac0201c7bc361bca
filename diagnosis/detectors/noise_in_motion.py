"""Level of the noise of the samples of a body that never rests.

Of the short blocks (`diagnosis.detectors.noise_blocks`), the largest share of the calmest is taken in which no motion shows:
in which the spectrum is level, or rises as that of readout noise, and the blocks' powers scatter no more than those of white
noise, as they do where the motion has jerks. Blocks that pass zero, where a dead zone jumps, count if they show the same
level. Where a motion shows in all shares, but the spectrum is level beside a weak one, all that it adds counts as an
uncertainty of the level. Both templates are asked whether the noise is as stated, white noise of another level and readout
noise beside white noise as stated, and the smaller p-value counts twice. Nothing is said of the colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.noise_blocks import (
    BLOCK,
    OF_MOTION,
    ORDER,
    READ_OUT,
    SHOWING,
    WHITE,
    by_calm,
    fitted,
    has_spike,
    is_even,
    passes_zero,
    powers_of,
    samples_of,
    smooth_errors,
)
from diagnosis.detectors.readout_noise import Readout, readout

Array = NDArray[np.float64]

CALM_SHARES = (1.0, 0.9, 0.75, 0.5, 0.35, 0.25)
FEWEST_BLOCKS = 12
PRECISER = 0.8  # of the standard error at rest, below which the level in motion is taken
SAME = 2.0  # sigmas between blocks that pass zero and the rest, up to which they show one level
ALIKE = 3.0  # sigmas between the two, up to which they say the same


@dataclass(frozen=True)
class Level:
    """Noise of one axis.

    Attributes
    ----------
    variance, sigma : of a sample, (rad/s)², and the standard error of that
    colour, colour_sigma : m times the variance of means over that of samples; NaN where there are too few
    """

    variance: float
    sigma: float
    colour: float
    colour_sigma: float


@dataclass(frozen=True)
class InMotion:
    """What the samples of a body in motion show of their noise.

    Attributes
    ----------
    level : of it, without a colour
    p_value : under white noise as stated, that it has another level or rises as readout noise, both looked at
    reading : readout noise, if that explains it
    parts : the blocks of samples that were used
    still : whether no motion shows in them
    """

    level: Level
    p_value: float
    reading: Readout | None
    parts: list[Array]
    still: bool = True


def level_in_motion(x: Array, usable: list[tuple[int, int]], expected: float) -> InMotion | None:
    """Noise of some runs of samples that hold a motion, in the largest share of the calmest blocks that shows none.

    Where a motion shows in all shares, it is that of the share that tells the level best beside it; None where no share does.
    """
    samples = samples_of([x[low:high] for low, high in usable])
    blocks = np.diff(samples, ORDER, axis=1) @ WHITE.T
    # Spikes that are too small to be repaired beside the motion are no level.
    single = ~has_spike(blocks)
    samples, blocks = samples[single], blocks[single]
    through = passes_zero(samples, float(np.sqrt(expected)))
    if not _are_one(blocks[through], blocks[~through]):
        samples, blocks = samples[~through], blocks[~through]
    order = by_calm(blocks)
    moving: list[InMotion] = []
    for share in CALM_SHARES:
        chosen = np.sort(order[: int(share * order.size)])
        if chosen.size < FEWEST_BLOCKS:
            break
        found = _in_blocks(blocks[chosen, :SHOWING], samples[chosen], expected)
        if found is not None and found.still:
            return found
        moving += [found] if found is not None else []
    return min(moving, key=lambda one: one.level.sigma, default=None)


def _are_one(some: Array, rest: Array) -> bool:
    """Whether blocks that pass zero show the level of the rest, as those with the jumps of a dead zone do not."""
    levels: list[tuple[float, float]] = []
    for blocks in (some, rest):
        chosen = by_calm(blocks)
        if chosen.size < FEWEST_BLOCKS:
            return rest.size < some.size
        fit = fitted(powers_of(blocks[chosen, :SHOWING]), chosen.size)
        levels.append((fit.white, fit.sigma))
    (one, error), (other, other_error) = levels
    return bool(abs(one - other) < SAME * np.hypot(error, other_error))


def _in_blocks(blocks: Array, samples: Array, expected: float) -> InMotion | None:
    """What some blocks of samples show; None where that is more than noise and a weak motion."""
    powers = powers_of(blocks)
    if not powers.all():  # readings that stand still on a lattice in most of the blocks
        return None
    fit = fitted(powers / expected, len(blocks))
    reading = readout(powers, smooth_errors(powers, len(blocks)), READ_OUT, expected, OF_MOTION)
    if not (fit.fits or (fit.still and reading is not None and reading.probability >= 0.5)):
        return None
    if not is_even(blocks[:, : BLOCK // 2] / np.sqrt(powers[: BLOCK // 2])):
        return None
    if fit.white <= 0:
        return None
    nothing = float("nan")
    if not fit.still:
        beside = Level(expected * fit.white, expected * float(np.hypot(fit.sigma, fit.motion)), nothing, nothing)
        return InMotion(beside, chance_of(beside, expected), None, list(samples), still=False)
    found = Level(expected * fit.white, expected * fit.sigma, nothing, nothing)
    free = SHOWING * len(blocks)
    rising = float(scipy.stats.chi2.sf(free + fit.rise * np.sqrt(2 * free), free))
    return InMotion(found, min(1.0, 2 * min(chance_of(found, expected), rising)), reading, list(samples))


def chance_of(one: Level, expected: float) -> float:
    """P-value of a variance that is as stated: χ² with as many degrees of freedom as its standard error says."""
    free, ratio = 2 * (one.variance / one.sigma) ** 2, one.variance / expected
    return float(min(1.0, 2 * min(scipy.stats.chi2.sf(free * ratio, free), scipy.stats.chi2.cdf(free * ratio, free))))


def preciser(rest: Level, moving: InMotion) -> bool:
    """Whether the level in motion is that at rest, and known clearly better."""
    off = abs(moving.level.variance - rest.variance) < ALIKE * float(np.hypot(moving.level.sigma, rest.sigma))
    return bool(off and moving.level.sigma < PRECISER * rest.sigma)
