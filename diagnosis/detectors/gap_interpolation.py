"""What stands in for samples that show nothing of the motion, and how uncertain it is.

A bridge over a run of n bad samples is a linear map W, (n, 2m), of m readings on either side. Straight lines through these
give the run's edges p₀, p₁ and slopes s₀, s₁; between them goes the cubic with these (Hermite's). Runs of one or two are
short beside any corner of the rate: there the line between the neighbours does. Where the body swings fast beside the
sampling, a polynomial through the readings of both sides follows it better.

The readings are integrated themselves as well, so that with w = 1ᵀW their white noise σ gives the angle over all n + 2m
samples the variance σ²Δt² Σ (1 + w_i)², of which 2m σ²Δt² are their own.

What the motion adds, the good samples nearby say: the same bridge over n of them in a row misses the angle that they turn by
e = Δt (w·r − Σ r), of the mean square E e² = M² + σ²Δt² (w·w + n). M² is taken for the variance of what the motion makes of
the bridge, and the one with the least variance of all is chosen, if it is clearly less. If the rate has a corner in the
middle of a run of length L = (n + 1)Δt, as where a slew starts, the cubic is off by (s₀ − s₁) L²/24, which nothing nearby
shows; that is taken for a sigma as well. All of them are spread over the run as a noise density.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from gyrocal.arrays import Array, Indices, Mask
from gyrocal.mask_runs import find_mask_runs

SIDE = 8  # readings on either side
SHORT = 2  # samples of a run, up to which a line does
FEWEST = 3  # readings of a side, for a slope
# readings of a side and degree, in place of these
POLYNOMIALS = ((2, 3), (3, 3), (3, 5), (4, 5), (6, 5), (4, 7), (6, 7))
REACH = 150  # samples on either side, in which a bridge is tried
# places, below which nothing is said, and the nearest that count
FEWEST_TRIED = 12
MOST_TRIED = 64
CLEARLY = 0.8  # of the variance, below which another bridge is the better one


def fill_gaps(t_s: Array, rates: Array, bad: Mask, sample_s: float, sigma: float = 0.0) -> tuple[Array, Array, Array]:
    """Bridge the bad samples (n,) of rates (n, 3), rad/s, that start at `t_s` and have white noise `sigma`.

    Returns the rates, the factor (n,) by which the noise density of a sample grows, and what the motion adds to it, (n, 3)
    rad²/s.
    """
    out = rates.copy()
    factor, density = np.ones(len(rates)), np.zeros(rates.shape)
    good = np.flatnonzero(~bad)
    for axis in range(3):
        out[bad, axis] = np.interp(t_s[bad], t_s[good], rates[good, axis])
    follows = np.append(False, np.diff(t_s) < 1.5 * sample_s)
    for low, high in find_mask_runs(bad):
        n = high - low
        factor[max(low - 1, 0) : high + 1] = 1 + n / 2
        before = _collect_side(t_s, bad, range(low - 1, max(low - 1 - SIDE, -1), -1), sample_s)
        after = _collect_side(t_s, bad, range(high, min(high + SIDE, len(rates))), sample_s)
        m = min(before.size, after.size)
        if not m or not follows[low : high + 1].all():
            continue
        near = slice(max(low - REACH, 0), high + REACH)
        W, of_motion = _choose_bridge(rates[near], bad[near], follows[near], 0.5 * (low + high) - near.start, (n, m), sigma)
        m = W.shape[1] // 2
        out[low:high] = W @ np.concatenate([rates[low - m : low], rates[high : high + m]])
        factor[low - 1 : high + 1] = (float(np.sum((1 + W.sum(axis=0)) ** 2)) - 2 * (m - 1)) / (n + 2)
        density[low:high] = of_motion * sample_s / n
        if n > SHORT and min(before.size, after.size) >= FEWEST:
            span = float(t_s[high] - t_s[low - 1])
            change = _fit_slope(t_s, rates, before) - _fit_slope(t_s, rates, after)
            density[low:high] += (change * span**2 / 24) ** 2 / span
    return out, factor, density


def _choose_bridge(
    rates: Array, bad: Mask, follows: Mask, middle: float, run: tuple[int, int], sigma: float
) -> tuple[Array, Array]:
    """The bridge over n samples with m readings at a side, and M² (3,) over Δt², (rad/s)²; zero where nothing says it."""
    n, most = run
    usual = _build_polynomial_bridge(n, 1, 1) if n <= SHORT or most < FEWEST else _build_cubic_bridge(n, most)
    best, least, of_best = usual, np.inf, np.zeros(3)
    for W in (usual, *(_build_polynomial_bridge(n, m, degree) for m, degree in POLYNOMIALS if m <= most)):
        m, w = W.shape[1] // 2, W.sum(axis=0)
        kernel = np.concatenate([w[:m], -np.ones(n), w[m:]])
        whole = ~np.convolve(bad | ~follows, np.ones(kernel.size, dtype=int), "valid").astype(bool)
        places = np.flatnonzero(whole)
        if places.size < FEWEST_TRIED:
            if W is usual:
                break
            continue
        nearest = places[np.argsort(np.abs(places + 0.5 * kernel.size - middle))[:MOST_TRIED]]
        missed = np.einsum("pax,x->pa", np.lib.stride_tricks.sliding_window_view(rates, kernel.size, axis=0)[nearest], kernel)
        of_motion = np.maximum(np.mean(missed**2, axis=0) - sigma**2 * (w @ w + n), 0.0)
        of_noise = 3 * sigma**2 * float(np.sum((1 + w) ** 2) - 2 * m)
        variance = float(of_motion.sum()) + of_noise
        if W is usual and variance * CLEARLY < of_noise:  # no motion that another would follow better
            return usual, of_motion
        if variance < (CLEARLY if W is not usual else 1.0) * least:
            best, least, of_best = W, variance, of_motion
    return best, of_best


def _collect_side(t_s: Array, bad: Mask, places: range, sample_s: float) -> Indices:
    """Readings of a side, from the run outward until one is missing or bad."""
    kept: list[int] = []
    for place in places:
        if bad[place] or (kept and abs(t_s[place] - t_s[kept[-1]]) > 1.5 * sample_s):
            break
        kept.append(place)
    return np.array(kept, dtype=np.intp)


@cache
def _build_polynomial_bridge(n: int, m: int, degree: int) -> Array:
    """(n, 2m) to a run of n from the polynomial nearest to m readings on either side."""
    at = (np.arange(n + 2 * m) - 0.5 * (n + 2 * m - 1)) / (0.5 * (n + 2 * m))
    P = np.polynomial.legendre.legvander(at, degree)
    beside = np.concatenate([P[:m], P[m + n :]])
    return np.asarray(P[m : m + n] @ np.linalg.pinv(beside))


@cache
def _build_cubic_bridge(n: int, m: int) -> Array:
    """(n, 2m) to a run of n from the lines through m readings on either side, by Hermite's cubic."""
    ahead = np.arange(m) - 0.5 * (m - 1)
    slope = ahead / (ahead @ ahead)
    none = np.zeros(m)
    u, span = np.arange(1, n + 1)[:, None] / (n + 1), n + 1
    p0, s0 = np.append(1 / m + slope * 0.5 * (m - 1), none), np.append(slope, none)
    p1, s1 = np.append(none, 1 / m - slope * 0.5 * (m - 1)), np.append(none, slope)
    return np.asarray(
        (1 + 2 * u) * (1 - u) ** 2 * p0
        + u * (1 - u) ** 2 * span * s0
        + u**2 * (3 - 2 * u) * p1
        + u**2 * (u - 1) * span * s1
    )  # fmt: skip


def _fit_slope(t_s: Array, rates: Array, places: Indices) -> Array:
    """(3,) of the straight line through some readings, rad/s²."""
    t = t_s[places] - t_s[places].mean()
    return np.asarray(t @ rates[places] / (t @ t))
