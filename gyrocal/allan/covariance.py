"""Covariance of Allan variances of one record at several averaging times.

For Gaussian noise and z^a, z^b the second differences over a and b samples,

    Cov[Σ_i (z_i^a)², Σ_j (z_j^b)²] = Σ_ij [2 c_ab(i − j)² + 4 d_a d_b c_ab(i − j)],

with c_ab(k) = Σ_st α_s α_t κ(k + s a − t b), α = (1, −2, 1), κ of `gyrocal.allan.terms`, and d_a = R (a τ₀)² what a rate ramp
adds to every difference. The equivalent degrees of freedom are ν = 2 E²/Var, those of Greenhall & Riley (35th PTTI, 2003) for
any mixture of noise. c_ab is smooth on the scale of the shorter average, so that the sum takes steps of an
eighth of it; angle white noise, which sits at single lags, is added at these. Beyond `REACH` of the longer average it is
negligible.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from gyrocal.allan.deviation import Deviation
from gyrocal.allan.terms import ANGLE_WHITE, RAMP, compute_term_covariance

Array = NDArray[np.float64]
Lags = NDArray[np.intp]

DIFFERENCE_WEIGHTS = (1.0, -2.0, 1.0)
FINE_AVERAGE_STEPS = 8  # steps in the shorter average
REACH = 8  # longer averages, beyond which second differences have nothing in common
DECAY = 6  # time constants, beyond which Markov noise has not


def estimate_covariance(found: Deviation, squares: Mapping[str, float], time_constant_s: float) -> Array:
    """Covariance of the Allan variances of `found`, (t, t).

    Parameters
    ----------
    found : what they rest on
    squares : square of the coefficient of each term that is there
    time_constant_s : of the Markov noise
    """
    factors = [int(m) for m in found.factors]
    ramp = np.sqrt(squares.get(RAMP, 0.0)) * found.tau_s**2
    out = np.zeros((len(factors), len(factors)))
    reach_s = DECAY * time_constant_s / found.sample_s
    coloured = {term: square for term, square in squares.items() if square and term not in (ANGLE_WHITE, RAMP)}

    def compute_kappa(lags: Lags) -> Array:
        parts = (
            square * compute_term_covariance(term, np.asarray(lags * found.sample_s, dtype=np.float64), time_constant_s)
            for term, square in coloured.items()
        )
        return np.asarray(sum(parts, np.zeros(len(lags))))

    for i, a in enumerate(factors):
        for j, b in enumerate(factors[: i + 1]):
            lags, weights = _select_lags(a, b, found.lengths, REACH * a + int(min(reach_s, 8 * REACH * a)))
            c = _smooth(lags, a, b, compute_kappa)
            total = weights @ (2 * c**2 + 4 * ramp[i] * ramp[j] * c)
            white = squares.get(ANGLE_WHITE, 0.0)
            if white:
                single = _compute_white_weights(a, b)
                place = np.array(sorted(single), dtype=np.intp)
                own = white * np.array([single[int(k)] for k in place])
                smooth = _smooth(place, a, b, compute_kappa)
                pairs = _count_pairs(place, a, b, found.lengths)
                total += pairs @ (4 * smooth * own + 2 * own**2 + 4 * ramp[i] * ramp[j] * own)
            scale = 4.0 * found.counts[i] * found.counts[j] * found.tau_s[i] ** 2 * found.tau_s[j] ** 2
            out[i, j] = out[j, i] = total / scale
    return out


def _select_lags(a: int, b: int, lengths: tuple[int, ...], reach: int) -> tuple[Lags, Array]:
    """Lags i − j at which c_ab is summed, and the number of pairs that each stands for."""
    step = max(1, min(a, b) // FINE_AVERAGE_STEPS)
    furthest = min(reach, max(lengths))
    lags = step * np.arange(-(furthest // step), furthest // step + 1)
    return lags, step * _count_pairs(lags, a, b, lengths)


def _count_pairs(lags: Lags, a: int, b: int, lengths: tuple[int, ...]) -> Array:
    """Number of pairs of differences (i over a, j over b) of one stretch with i − j = lag, all stretches together."""
    total = np.zeros(len(lags))
    for n in lengths:
        first, second = n + 1 - 2 * a, n + 1 - 2 * b
        if first > 0 and second > 0:
            total += np.clip(np.minimum(first, second + lags) - np.maximum(0, lags), 0, None)
    return total


def _smooth(lags: Lags, a: int, b: int, kappa: Callable[[Lags], Array]) -> Array:
    """c_ab at some lags, ascending, for κ as a function of the lag."""
    single = _compute_white_weights(a, b)
    step = int(lags[1] - lags[0])
    if a % step or b % step or (np.diff(lags) != step).any():
        return np.asarray(sum(weight * kappa(lags - lag) for lag, weight in single.items()))
    # Moved by a multiple of their step the lags are mostly the same: κ is asked for once at each, not up to nine times.
    low, high = int(lags[0]) - max(single), int(lags[-1]) - min(single)
    at = kappa(np.arange(low, high + 1, step))
    first = {lag: (int(lags[0]) - lag - low) // step for lag in single}
    return np.asarray(sum(weight * at[first[lag] : first[lag] + len(lags)] for lag, weight in single.items()))


def _compute_white_weights(a: int, b: int) -> dict[int, float]:
    """c_ab of unit angle white noise at the lags where it is not zero."""
    out: dict[int, float] = {}
    for s, weight in enumerate(DIFFERENCE_WEIGHTS):
        for t, other in enumerate(DIFFERENCE_WEIGHTS):
            lag = t * b - s * a
            out[lag] = out.get(lag, 0.0) + weight * other
    return out
