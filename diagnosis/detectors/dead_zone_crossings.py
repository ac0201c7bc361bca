"""A dead zone seen where the motion passes through it: no reading lies between zero and its edge.

Means of the reading over short windows, in units of a half width s that is tried, lie in the core (below 0.35), the hole (0.35
to 0.85), three bands above the edge (from 1, 1.5 and 2 to 2.5), or far off. A pass is the way from the core to far off, or
back. A body that speeds up or slows down stays in the hole about as long as in a band of the same width; with o windows in the
band that it passes fastest, since it may rest in one or on the border of two, their number h in the hole is negative binomial
with the mean ρ o. A gyro with a dead zone of half width s reads zero in the core and in the hole, and only a window across the
edge falls into the hole: h is Poisson with a mean below one. Passes too fast to have some windows in each band tell nothing,
nor do those in which the body rests in one or jumps over the core, which it would pass in several times as long as a band.
Behind a dead zone the rate goes on as it came: the first window outside is at the edge, within a few steps of the pass. A body
that thrusters push from one steady rate to another leaves a hole as well, and is anywhere behind it: at the edge by the chance
that so many steps have among those of a band. The log odds are summed over the passes, against motions of any ratio ρ and
dispersion of which any share of the passes are such jumps, all as likely beforehand, and with a few odd passes allowed to
either, so that no single one decides. In the core such a body rests at rates that are not zero, where a silent gyro reads none
but its noise. How many windows of the core read more is a binomial number, of a small share under a zone and of any under a
motion. All half widths that are tried share the odds.

The edge w is where the density of the passes' readings v rises, blurred by the noise of a window, s: it is
a + b Φ((v − w)/s) with shares of a and b that are not known, over all of which its likelihood is averaged. How fast a body
turns beyond the edge is not known either, so that no edge is known to better than that blur. Beforehand an edge has
the odds of the half widths whose hole ends before it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray
from scipy.special import betaln, gammaln, logsumexp, ndtr, xlog1py, xlogy

from diagnosis.detectors.sample_report import AXES, Stream, Tell, Zone
from simulator.effects.recording_view import find_interval_slices

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

RESOLVED = 6.0  # sigmas of a window's mean in the half width
LONGEST = 2000  # samples of a window
CORE = 0.35  # half widths, below which a mean lies in the core
HOLE = 0.85  # the same, of the hole
BAND = 0.5  # width of each of three bands above the edge, in half widths
TRIED = 60  # half widths
FEWEST_IN_BAND = 2  # windows of a pass that tells something
RESTING = 4  # times as many windows in one band as in another, beyond which the body rests in it
FEWEST_PASSES = 2  # one way through the zone, in and out again
# mean number of windows across the edge: of readings at a moment, and of means
STRADDLING = (0.05, 0.7)
JUMPS = (0.03, 0.3, 0.97)  # share of passes in which a body jumps over the hole
RATIOS = (0.5, 0.7, 1.0, 1.4, 2.0)  # of the time in the hole to that in the band, of a real motion
DISPERSIONS = (2.0, 20.0)  # shape of the negative binomial
ODD = 0.03  # share of odd passes, of a real motion or of a zone
LOUD = 4.0  # sigmas of a window in the core, beyond which it reads a rate
# mean steps and sigmas of a window, within which the first one outside is at the edge
STEPS = 3.0
CERTAIN = 3.0
EDGES = (0.5, 1.7)  # half widths within which the edge lies of one that was found
EDGES_TRIED = 121  # half widths
FEWEST_WINDOWS = 8  # of an interval
SHOWN = 3.0  # log odds of a dead zone from which on its edges are left out of the other tests
BESIDE = 10  # samples beside an edge
GRID = 1000  # readings over which a density is normalised

BAND_EDGES = (
    CORE,
    HOLE,
    *(1.0 + k * BAND for k in range(4)),
)  # upper ends of core, hole, edge and bands, in half widths
STRAY = np.geomspace(0.01, 0.9, 8)  # share of readings that are anywhere, not beyond the edge
LEAST_POSITIVE = 1e-300


def find_zones(stream: Stream, coarse: NDArray[np.bool_], tell: Tell) -> dict[int, Zone]:
    """Find the dead zones that motions pass through, of gyros on no coarse lattice."""
    found, parts = dict[int, Zone](), find_interval_slices(stream.recording)
    for axis in np.flatnonzero(~coarse).tolist():
        tell(f"dead zone of gyro {AXES[axis]}", 0.05 + 0.05 * axis)
        one = find_best_zone(stream.rates[:, axis], parts, stream.sigma)
        if one is not None:
            found[axis] = one
    return found


def find_near_edges(zones: Mapping[int, Zone], size: int) -> NDArray[np.bool_]:
    """Find samples beside an edge of a zone that passes show for certain."""
    jumps = np.zeros(size, dtype=bool)
    for one in zones.values():
        if one.log_odds > SHOWN:
            jumps[1:] |= np.diff(one.dead)
    return np.asarray(scipy.ndimage.binary_dilation(jumps, iterations=BESIDE)) if jumps.any() else jumps


def find_best_zone(x: Array, parts: Sequence[slice], noise: float) -> Zone | None:
    """The dead zone of one gyro that its passes show best; None if none is likelier than a motion.

    Parameters
    ----------
    x : (n,) raw rates, rad/s
    parts : samples of each interval
    noise : white noise of a sample, rad/s
    """
    if noise <= 0:
        return None
    top = float(np.quantile(np.abs(x), 0.9))
    low = max(RESOLVED * noise / np.sqrt(LONGEST), 1e-4 * top)
    if top <= low:
        return None
    sums = [np.append(0.0, np.cumsum(x[part])) for part in parts]
    tried = np.geomspace(low, top, TRIED)
    odds = np.array([_log_odds(sums, float(size), noise) for size in tried])
    log_odds = float(logsumexp(odds)) - float(np.log(TRIED))
    if log_odds <= 0:
        return None
    best = int(np.argmax(odds))
    size, sigma = _estimate_edge(sums, float(tried[best]), noise, lambda edge: _interpolate_edge_odds(edge, tried, odds))
    return Zone(size, sigma, log_odds, _find_dead(x, parts, size, _choose_window_length(size, noise)))


def _find_dead(x: Array, parts: Sequence[slice], size: float, count: int) -> NDArray[np.bool_]:
    """Find the samples (n,) whose window of so many samples is in a zone of some half width."""
    dead = np.zeros(x.size, dtype=bool)
    for part in parts:
        own = x[part]
        u = own[: own.size // count * count].reshape(-1, count).mean(axis=1) / size
        inside = np.repeat(np.abs(u) < 0.5 * (CORE + HOLE), count)
        dead[part] = np.pad(inside, (0, own.size - inside.size), mode="edge") if inside.size else False
    return dead


def _choose_window_length(size: float, noise: float) -> int:
    return max(1, int(np.ceil((RESOLVED * noise / size) ** 2)))


def _average_windows(total: Array, count: int) -> Array:
    """Means over windows of `count` samples, from cumulated sums."""
    return np.asarray(np.diff(total[::count]) / count)


def _log_odds(sums: Sequence[Array], size: float, noise: float) -> float:
    """log odds of a zone of some half width, over the passes of all intervals."""
    count = _choose_window_length(size, noise)
    windows = [_average_windows(total, count) / size for total in sums if total.size > FEWEST_WINDOWS * count]
    if not windows:
        return 0.0
    hole, band, behind = np.concatenate([_count_pass_windows(u) for u in windows], axis=1)
    telling = band >= FEWEST_IN_BAND
    if telling.sum() < FEWEST_PASSES:
        return 0.0
    h, o = hole[telling].astype(np.intp), band[telling].astype(np.intp)
    blur = noise / size / np.sqrt(count)
    near = STEPS + CERTAIN * blur * o / (3 * BAND)
    return _compute_pass_log_odds(h, o, behind[telling] < near, near) + _compute_core_log_likelihood(windows, blur)


def _compute_pass_log_odds(h: Indices, o: Indices, at_the_edge: NDArray[np.bool_], near: Array) -> float:
    """log odds of a zone against a motion, of the windows in the hole and in the band, and of where each pass goes on.

    Parameters
    ----------
    h, o : (p,) windows in the hole, and in the band that is passed fastest
    at_the_edge : (p,) whether the first window outside is there
    near : (p,) steps from the edge that count as there
    """
    wide = (HOLE - CORE) / BAND
    there = np.where(at_the_edge, np.log1p(-ODD), np.log(ODD))
    chance = np.clip(near / o, ODD, 1 - ODD)  # that a jump to anywhere in the bands ends there
    anywhere = np.where(at_the_edge, np.log(chance), np.log1p(-chance))
    empty = [_compute_log_poisson(h, mean) for mean in STRADDLING]
    smooth = [
        _compute_log_negative_binomial(h, shape, shape / (shape + ratio * wide * o)) + there
        for ratio in RATIOS
        for shape in DISPERSIONS
    ]
    odd = np.log(ODD) + _compute_log_negative_binomial(h, 1.0, 1 / (1 + wide * o))
    of_zone = [np.sum(np.logaddexp(np.log1p(-ODD) + own, odd) + there) for own in empty]
    of_motion = [
        np.sum(np.logaddexp(np.log1p(-share) + one, np.log(share) + own + anywhere))
        for one in smooth
        for own in empty
        for share in JUMPS
    ]
    return float(logsumexp(of_zone) - np.log(len(of_zone)) - logsumexp(of_motion) + np.log(len(of_motion)))


# The distributions of scipy.stats give the same numbers, but look at their arguments for ten times as long as they compute.


def _compute_log_poisson(h: Indices, mean: float) -> Array:
    """log of the probability of each count."""
    return np.asarray(xlogy(h, mean) - gammaln(h + 1) - mean)


def _compute_log_negative_binomial(h: Indices, shape: float, p: NDArray[np.floating[Any]]) -> Array:
    """log of the probability of each count, with the mean shape (1 − p)/p."""
    return np.asarray(gammaln(shape + h) - gammaln(h + 1) - gammaln(shape) + shape * np.log(p) + xlog1py(h, -p))


def _interpolate_edge_odds(edge: Array, tried: Array, odds: Array) -> Array:
    """log odds of a zone with its edge at some rates (k,), rad/s: those of the half widths whose hole ends before the edge."""
    fitting = edge[:, None] / np.linspace(HOLE, 1.0, 5)
    return np.asarray(np.interp(np.log(fitting), np.log(tried), odds).max(axis=1))


def _estimate_edge(sums: Sequence[Array], size: float, noise: float, odds: Callable[[Array], Array]) -> tuple[float, float]:
    """Half width and its sigma, rad/s: where the readings of the passes set in.

    Parameters
    ----------
    sums : cumulated sums of each interval's samples
    size : half width that was found, rad/s
    noise : of a sample, rad/s
    odds : log odds of a zone with its edge at some rates, rad/s
    """
    count, found = _choose_window_length(size, noise), []
    for total in sums:
        if total.size > FEWEST_WINDOWS * count:
            u = _average_windows(total, count) / size
            begin, end = _find_pass_ends(np.digitize(np.abs(u), BAND_EDGES), len(BAND_EDGES))
            within = np.zeros(u.size + 1)
            np.add.at(within, begin + 1, 1)
            np.add.at(within, end, -1)
            found.append(np.abs(u[np.cumsum(within[:-1]) > 0]))
    v = np.concatenate(found)
    v, blur = v[(v > CORE) & (v < BAND_EDGES[-1])], noise / size / np.sqrt(count)
    tried = np.linspace(*EDGES, EDGES_TRIED)
    middle, sigma = _estimate_edge_posterior(v, tried, blur, BAND_EDGES[-1], odds(size * tried))
    near = 4 * max(sigma, float(tried[1] - tried[0]))
    tried = np.linspace(max(middle - near, CORE), middle + near, EDGES_TRIED)
    middle, sigma = _estimate_edge_posterior(v, tried, blur, BAND_EDGES[-1], odds(size * tried))
    return size * middle, size * float(np.hypot(sigma, blur))


def _estimate_edge_posterior(v: Array, tried: Array, blur: float, top: float, odds: Array) -> tuple[float, float]:
    """Mean and sigma of the edge over some (k,) with odds beforehand, of readings (n,) from core to `top`; in half widths."""
    span = top - CORE
    grid = CORE + span * (np.arange(GRID) + 0.5) / GRID
    likely = np.empty(tried.size)
    for k, edge in enumerate(tried):
        beyond = ndtr((v - edge) / blur) / max(float(ndtr((grid - edge) / blur).mean()), LEAST_POSITIVE)
        likely[k] = logsumexp(np.log(STRAY[:, None] + (1 - STRAY[:, None]) * beyond).sum(axis=1))
    likely += odds
    weights = np.exp(likely - likely.max())
    weights /= weights.sum()
    middle = float(weights @ tried)
    return middle, float(np.sqrt(weights @ (tried - middle) ** 2))


def _compute_core_log_likelihood(windows: Sequence[Array], sigma: float) -> float:
    """log of the likelihood of the core's windows under a zone, in which they read nothing but noise, over that of a motion."""
    core = [np.abs(u) < CORE for u in windows]
    inside = [one[1:-1] & one[:-2] & one[2:] for one in core]
    u = np.concatenate([one[1:-1][own] for one, own in zip(windows, inside, strict=True)])
    if not u.size:
        return 0.0
    steps = np.concatenate([np.diff(one)[own[1:] & own[:-1]] for one, own in zip(windows, core, strict=True)])
    scatter = max(sigma, float(np.median(np.abs(steps))) / 0.6745 / np.sqrt(2))
    off = int(np.sum(np.abs(u) > LOUD * scatter))
    of_zone = betaln(off + 1, u.size - off + 1 / ODD) - betaln(1, 1 / ODD)
    return float(of_zone - betaln(off + 1, u.size - off + 1))


def _count_pass_windows(u: Array) -> Array:
    """(3, passes) windows in the hole and in the band that is passed fastest, on each way between the core and far off.

    None are counted in the bands where the body rests in one of them. The third is how far behind the edge the first window
    outside is, in mean steps from one window to the next.
    """
    level = np.digitize(np.abs(u), BAND_EDGES)
    begin, end = _find_pass_ends(level, len(BAND_EDGES))
    if not begin.size:
        return np.zeros((3, 0))
    counts = [np.append(0, np.cumsum(level == one)) for one in (1, 3, 4, 5)]
    hole, *bands = (count[end] - count[begin + 1] for count in counts)
    fastest, slowest = np.min(bands, axis=0), np.max(bands, axis=0)
    outside = np.append(np.flatnonzero(level >= 2), level.size - 1)
    out = level[begin] == 0
    first = outside[np.where(out, np.searchsorted(outside, begin + 1), np.maximum(np.searchsorted(outside, end) - 1, 0))]
    behind = (np.abs(u[first]) - 1) * np.sum(bands, axis=0) / (3 * BAND)
    low, high = np.flatnonzero(np.diff(np.concatenate([[False], level == 0, [False]]))).reshape(-1, 2).T
    stay = (high - low)[np.searchsorted(low, np.where(out, begin, end), side="right") - 1] if low.size else np.zeros(0)
    even = (slowest <= RESTING * (fastest + 1)) & (RESTING * stay >= fastest)
    return np.array([hole, np.where(even, fastest, 0), behind])


def _find_pass_ends(level: Indices, far: int) -> tuple[Indices, Indices]:
    """First and last window of each way between the core and far off."""
    ends = np.flatnonzero((level == 0) | (level == far))
    change = np.flatnonzero(np.diff(level[ends]) != 0)
    return ends[change], ends[change + 1]
