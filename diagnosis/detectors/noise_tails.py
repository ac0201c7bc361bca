"""Whether the noise of the samples has tails: single samples that stand out, too low to be outliers one by one.

Of blocks of samples in which no motion shows (`diagnosis.detectors.noise_blocks`), with the cosines c of unit power, the height
of a spike at place i is uᵢ·c, with uᵢ the unit cosines of a spike there: normal if the noise is, with a variance that does not
depend on the place, one of white noise and of any other what most blocks show. The height of a block is the largest of any
place, zero where the best step and bend of the rate, as a body has them, explain more of the block, or where more than noise is
left of it beside the spike. How many of b blocks are higher than some limit is binomial. Limits that more than one block in
30,000 exceeds are read off draws of white noise; beyond, with n places, no more than 2 n Q(limit) of the blocks are higher.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.noise_blocks import BACK, BLOCK, ORDER, SHOWING, powers_of
from diagnosis.detectors.noise_questions import Answer

Array = NDArray[np.float64]

DRAWS = 200_000  # blocks of white noise, that show what is usual
USUAL = (0.01, 0.003, 0.001, 0.0003, 0.0001, 0.00003)  # shares of these that are higher than a limit
RARE = (1e-6, 1e-8, 1e-10, 1e-13)  # shares of all blocks that at most are higher than a limit
FEW = 8192  # blocks that tell what is usual of all
NO_MORE = float(scipy.stats.chi2.isf(1e-3, SHOWING - 1))  # squared sigmas that a spike leaves of a block: a jolt rings on
AT_ONCE = 4096  # blocks that are looked at, so that memory stays small


def tails(white: Array) -> Answer:
    """Blocks with one sample that stands out, more than normal noise has; by the height from which on that is clearest.

    Parameters
    ----------
    white : (b, SHOWING) cosines of blocks, of unit power each
    """
    count, (limits, shares) = len(white), _limits()
    above = np.sum(_heights(white / _spread(white)) > limits[:, None], axis=1)
    chances = scipy.stats.binom.sf(above - 1, count, shares)
    best = int(np.argmin(chances))
    text = f"{above[best]} of {count} stretches of {BLOCK} samples have one that is off by {limits[best]:.2g} sigmas or more"
    return Answer(min(1.0, shares.size * float(chances[best])), float(limits[best]), text)


def _heights(white: Array) -> Array:
    """(b,) height in sigmas of the highest spike in blocks (b, SHOWING) of white cosines, zero where it explains too little."""
    return np.concatenate([np.empty(0), *(_highest(white[low : low + AT_ONCE]) for low in range(0, len(white), AT_ONCE))])


def _highest(white: Array) -> Array:
    """The same of a few blocks."""
    spikes, steps = _shapes()
    spike = np.abs(white @ spikes).max(axis=1)
    step = np.sqrt(np.sum((white @ steps).reshape(len(white), 2, -1) ** 2, axis=1).max(axis=1))
    alone = np.sum(white**2, axis=1) - spike**2 < NO_MORE
    return np.where((spike > step) & alone, spike, 0.0)


def _spread(white: Array) -> float:
    """Standard deviation of what blocks hold of a spike at any place, one of white noise: others have what goes together."""
    some = white[:: max(1, len(white) // FEW)]
    return float(np.sqrt(np.mean(powers_of(some @ _shapes()[0])))) if len(some) else 1.0


@cache
def _limits() -> tuple[Array, Array]:
    """Heights, and the shares of blocks of white noise that exceed them: `USUAL` by draws, `RARE` at most."""
    white = np.random.default_rng(2).standard_normal((DRAWS, SHOWING))
    places = 2 * _shapes()[0].shape[1]
    limits = [np.quantile(_heights(white), 1 - np.array(USUAL)), scipy.stats.norm.isf(np.array(RARE) / places)]
    return np.concatenate(limits), np.array(USUAL + RARE)


@cache
def _shapes() -> tuple[Array, Array]:
    """Unit cosines (SHOWING, n) of a spike at each inner place of a block, (SHOWING, 2 m) of a step and, beside it, of a bend.

    Of a sample at either end, differences of so high an order hold next to nothing; steps there show all the same.
    """
    t = np.arange(BLOCK + ORDER)[:, None]
    inner, places = np.arange(ORDER, BLOCK), np.arange(2, BLOCK + ORDER - 1)
    spike, step, bend = (BACK @ one for one in (1.0 * (t == inner), 1.0 * (t >= places), (t - places) * (t >= places)))
    spike, step = (one / np.linalg.norm(one, axis=0) for one in (spike, step))
    bend = bend - step * np.sum(step * bend, axis=0)
    return spike, np.concatenate([step, bend / np.linalg.norm(bend, axis=0)], axis=1)
