"""Single samples far outside of their neighbours, while the body rests and while it moves.

Where the body rests, a reading is compared with the median around it. Where it moves, the samples on either side tell what a
reading should be, with the weights that do it best in this recording: as far as it is stationary they are those of the inverse
of its covariance. A thrust or a torque that sets in, after which the rate goes on along another line, departs from that, too:
a spike explains more of the readings than a step and a bend before it or after it.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.ndimage
import scipy.stats
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

OUTLIER = 6.0  # noise sigmas; one sample in 5e8 under M0
SIDE = 6  # samples to either side that tell a spike from a step
CLEARLY = 4.0  # squared sigmas by which a spike fits better
NO_MORE = float(scipy.stats.chi2.isf(1e-3, 2 * SIDE))  # squared sigmas that it leaves of the readings around: a jolt rings on
BETWEEN = np.array([1.0, -6.0, 15.0, 0.0, 15.0, -6.0, 1.0]) / 20  # of a quintic through three samples on either side
AS_FAR = 0.75  # of its deviation, that a spike is off the curve through its neighbours
ALONE = 0.2  # of a spike, that may be left beside it
LEAST_POWER = 1e-3  # of the deviations, at a frequency that the motion fills
FEWEST_FITTED, MOST_FITTED = 300, 200_000  # readings that tell the weights of those around them
NEARBY = 101  # over which the size of their usual error is taken


def at_rest(x: Array, follows: Mask, noise: float, step: float) -> tuple[Mask, Array, float]:
    """Samples off the median of seven, how far all are off it, and the limit of that."""
    deviation = x - scipy.ndimage.median_filter(x, 7, mode="nearest")
    spread = float(np.median(np.abs(deviation[follows]))) / 0.6745 if follows.any() else noise
    limit = OUTLIER * max(spread, noise) + step
    # A repeated or slow event is no spike: both neighbours must be back.
    neighbours = np.maximum(np.abs(np.roll(deviation, 1)), np.abs(np.roll(deviation, -1)))
    far = follows & (np.abs(deviation) > limit) & (neighbours < 0.5 * np.abs(deviation))
    return _is_single(x, np.where(far, deviation, 0.0), noise), deviation, limit


def _is_single(x: Array, deviation: Array, noise: float) -> Mask:
    """Whether a sample that deviates is alone off the curve through three samples on either side of each.

    It is about as far off its own, and those of the samples beside it show it with the weights that it has in them and nothing
    else. A motion that bends within a few samples may be far off a median or off what one side tells, but not so.
    """
    off = x - scipy.ndimage.convolve1d(x, BETWEEN, mode="nearest")
    half = len(BETWEEN) // 2
    found = (off * deviation > 0) & (np.abs(off) > np.maximum(AS_FAR * np.abs(deviation), OUTLIER * noise))
    spread = noise * float(np.sqrt(1 + BETWEEN @ BETWEEN))
    for k in np.flatnonzero(found).tolist():
        low, high = max(k - 2 * half, 0), min(k + 2 * half + 1, x.size)
        pattern = np.zeros(4 * half + 1)
        pattern[half : 3 * half + 1] = -BETWEEN
        pattern[2 * half] = 1.0
        left = off[low:high] - off[k] * pattern[low - k + 2 * half : high - k + 2 * half]
        found[k] = np.abs(left).max() < max(ALONE * abs(off[k]), OUTLIER * spread)
    return np.asarray(found)


def in_motion(x: Array, follows: Mask, noise: float, step: float) -> tuple[Mask, Array, float, Mask, Array]:
    """The same off what the readings around tell of it; the limit is that where the motion adds nothing.

    The last two are all that are further off than the samples beside them, and how far off a reading must be at each.
    """
    follows = follows.copy()
    follows[:SIDE] = follows[-SIDE:] = False
    weights = _best_weights(x, follows)
    off = x - scipy.ndimage.convolve1d(x, np.concatenate([weights[::-1], [0.0], weights]), mode="nearest")
    usual = noise * float(np.sqrt(1 + 2 * weights @ weights))
    level = np.maximum(scipy.ndimage.median_filter(np.abs(off), NEARBY, mode="nearest") / 0.6745, usual)
    least = OUTLIER * level + step
    # Beside a spike a reading is off as well, by its share of the spike.
    highest = np.abs(off) >= scipy.ndimage.maximum_filter1d(np.abs(off), 2 * SIDE + 1, mode="nearest")
    far = follows & highest & (np.abs(off) > least)
    single = _is_single(x, np.where(far, off, 0.0), noise)
    known = _Shapes(weights)
    for k in np.flatnonzero(single).tolist():
        odds, left = known.odds(off[k - SIDE : k + SIDE + 1])
        single[k] = odds > CLEARLY * level[k] ** 2 and left < NO_MORE * level[k] ** 2
    return single, off, OUTLIER * usual + step, far, least


def _best_weights(x: Array, follows: Mask) -> Array:
    """(SIDE,) weights of the readings at each distance, on both sides, that leave the least of a reading; their sum is ½.

    White noise wants the mean of many, and a fast motion a curve through few; the readings tell what theirs want.
    """
    places = np.flatnonzero(follows)
    places = places[:: max(1, -(-places.size // MOST_FITTED))]
    if places.size < FEWEST_FITTED:
        half = len(BETWEEN) // 2
        return np.pad(BETWEEN[half + 1 :], (0, SIDE - half))
    sides = np.column_stack([x[places - lag] + x[places + lag] - 2 * x[places] for lag in range(1, SIDE + 1)])
    y, sides = -0.5 * sides[:, 0], sides[:, 1:] - sides[:, :1]
    for _ in range(2):
        others = np.asarray(np.linalg.lstsq(sides, y, rcond=None)[0])
        left = np.abs(y - sides @ others)
        kept = left <= OUTLIER * np.median(left) / 0.6745
        y, sides = y[kept], sides[kept]
    return np.append(0.5 - others.sum(), others)


class _Shapes:
    """Of what readings around a sample are off by, how much a spike explains and how much a step and a bend beside it.

    With K the filter that takes from a reading what those around tell of it, whose usual error is L, the readings x have the
    inverse covariance K/L², and deviations Kx the covariance L² K. So a shape u, which they show as s = Ku, explains
    (sᵀ K⁻¹ Kx)² / sᵀ K⁻¹ s, in squared deviations, where K is cut to the samples that are looked at.
    """

    def __init__(self, weights: Array) -> None:
        K = np.concatenate([-weights[::-1], [1.0], -weights])
        t = np.arange(-2.0 * SIDE, 2 * SIDE + 1)
        after = [t >= late for late in (0, 1)]
        shapes = [t[:, None] == 0.0, *(np.column_stack([one, one * t]) for one in after)]
        seen = [scipy.ndimage.convolve1d(one.astype(float), K, axis=0)[SIDE:-SIDE] for one in shapes]
        values, vectors = np.linalg.eigh(scipy.linalg.toeplitz(np.concatenate([[1.0], -weights, np.zeros(SIDE)])))
        inverse = vectors / np.maximum(values, LEAST_POWER) @ vectors.T
        self.all = inverse
        self.spike, *self.steps = (inverse @ one @ np.linalg.inv(one.T @ inverse @ one) @ one.T @ inverse for one in seen)

    def odds(self, off: Array) -> tuple[float, float]:
        """What a spike in the middle explains more than the better of a step and a bend before or after it; what it leaves."""
        explained = float(off @ self.spike @ off)
        return explained - max(float(off @ step @ off) for step in self.steps), float(off @ self.all @ off) - explained
