"""Whether what the samples show looks like the fault that it is taken for.

A test of the samples sees that something is there; which fault it is follows from how that behaves. Repeats of a telemetry that
misses samples begin at random and last a geometric time; outliers come at random with heights that are exponential, as
of lost counts, or scatter about a mean; white
noise of another level is normal, and as strong from one moment to the next. The p-value of what is seen, under that, weighs the
cause against something unlisted (`diagnosis.inference.attribution`).

The statistics are general. Of times counted in samples, the strongest of the periods up to `LONGEST`: for a period q the
resultant R² = |Σ exp(2πi k/q)|²/m of m random times has an exponential distribution of mean one. Of whatever times may go with,
the smallest share of all moments that holds some of them; the ranks of it must not go with their signs. Of lengths and
heights, the largest distance of their distribution to that of the fault with the mean that they have (Lilliefors), against
draws of it.
Of noise, the kurtosis of differences, and the mean log of its power in short windows, which lulls and bursts lower: their
distribution comes from draws of white noise. The power of those windows must not depend on the reading either, as it does where
a gyro jumps across a dead zone, or where its noise grows with the rate. Strong windows in which differences of a higher order
have less are those of a motion that starts or stops, and are left out; a burst of white noise is as strong in both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from math import comb

import numpy as np
import scipy.ndimage
import scipy.special
import scipy.stats
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

LONGEST = 64  # samples, of a period
FEWEST = 8  # times, lengths or heights, below which nothing is said
MOST = 2000  # of them that are looked at
NARROW = 0.02  # of all moments
SOME = 300  # events, of which any number is asked whether it comes together
DRAWS = 2000
WINDOW = 6  # differences whose power is taken together
FEWEST_WINDOWS = 60
ORDER = 2  # of the differences
HIGHER = 4  # orders above that in which a motion is weaker
STRONG = 3.0  # times the usual power, from which on a window may be one of a motion
WEAKER = 1.5  # times its power in the higher order, from which on it is
SIDES = 5  # windows, over which the two are compared
WHITE_WINDOWS, WHITE_DRAWS = 400, 400  # of white noise, that show what is usual
SHARES = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 3 / 4, 15 / 16)  # of the windows, from the smallest reading on


def of_runs(starts: Indices, lengths: Indices, seed: int = 0) -> float:
    """P-value of runs of repeats that begin at random and last a geometric time.

    Parameters
    ----------
    starts : first sample of each run, counted from its interval's first
    lengths : samples
    """
    if starts.size < FEWEST:
        return 1.0
    mean = float(lengths.mean())
    kept = lengths[:MOST]
    regular = of_times(starts)
    if mean < 1.05:  # nearly all runs are of one sample: nothing to compare
        return regular
    odd = _lilliefors(
        kept, lambda rng, shape: rng.geometric(1 / mean, shape), lambda x, m: 1 - (1 - 1 / m) ** np.floor(x), seed
    )
    return min(1.0, 2 * min(regular, odd))


def of_times(times: Indices) -> float:
    """P-value of the strongest period of times that are random, in samples."""
    if times.size < FEWEST:
        return 1.0
    periods = np.arange(2, LONGEST + 1)
    angle = 2 * np.pi * (times[None, :MOST] % periods[:, None]) / periods[:, None]
    resultant = np.abs(np.exp(1j * angle).sum(axis=1)) ** 2 / angle.shape[1]
    resultant[0] *= 0.5  # of period 2 it is real: χ² with one degree of freedom
    return min(1.0, periods.size * float(np.exp(-resultant.max())))


def of_heights(beyond: Array, seed: int = 0) -> float:
    """P-value of heights beyond a limit that are exponential or scatter about a mean; the larger of the two."""
    if beyond.size < FEWEST:
        return 1.0
    kept = beyond[:MOST]
    tail = _lilliefors(kept, lambda rng, shape: rng.exponential(1.0, shape), lambda x, m: 1 - np.exp(-x / m), seed)

    def about(x: Array, m: Array) -> Array:
        return np.asarray(scipy.special.ndtr((x - m) / np.maximum(x.std(axis=1, ddof=1, keepdims=True), 1e-300)))

    return max(tail, _lilliefors(kept, lambda rng, shape: rng.standard_normal(shape), about, seed))


def some(events: Indices, seed: int = 0) -> Indices:
    """At most `SOME` of events, by chance: the first of them would come together."""
    return events if events.size <= SOME else np.sort(np.random.default_rng(seed).choice(events, SOME, replace=False))


def of_places(values: Sequence[tuple[Array, Array]]) -> float:
    """P-value of events that come at random, by the smallest range that holds some of them of whatever they may go with.

    A range that holds a share d of all moments has j of m events or more with a probability of at most C(m, j) j d^(j−1). Only
    ranges of at most `NARROW` count: what happens at rest alone, or in a part of the time, is still the same fault.

    Parameters
    ----------
    values : of each quantity, at all moments at which an event would have been seen, and at the events
    """
    found = [_nearest(np.sort(every), np.sort(own)) for every, own in values if own.size > 1]
    return min(1.0, len(found) * min(found)) if found else 1.0


def of_signs(up: NDArray[np.bool_], values: Sequence[Array]) -> float:
    """P-value of signs of events that go with nothing, by the ranks of whatever they may go with.

    Parameters
    ----------
    up : (m,) which events go up
    values : of each quantity, (m,) at the events
    """
    signs = np.where(up, 1.0, -1.0) - (2 * float(up.mean()) - 1 if up.size else 0.0)
    if up.size < FEWEST or not signs.any():
        return 1.0
    ranks = [scipy.stats.rankdata(one) - 0.5 * (up.size + 1) for one in values]
    # Their sum over all orders of the signs has this variance (Hájek, Šidák and Sen, Theory of Rank Tests, 1999).
    variance = [float(np.sum(signs**2) * np.sum(one**2)) / (up.size - 1) for one in ranks]
    far = max((abs(float(signs @ one)) / np.sqrt(v) for one, v in zip(ranks, variance, strict=True) if v > 0), default=0.0)
    return min(1.0, len(values) * 2 * float(scipy.stats.norm.sf(far)))


def _nearest(every: Array, own: Array) -> float:
    """The smallest bound over all numbers of events, each of which is asked."""
    m = own.size
    below, up_to = np.searchsorted(every, own, side="left"), np.searchsorted(every, own, side="right")
    best = 0.0
    for j in range(2, m + 1):
        share = max(int((up_to[j - 1 :] - below[: m - j + 1]).min()), 1) / every.size
        if share > NARROW:
            break
        ways = -scipy.special.betaln(m - j + 1, j + 1) - np.log(m + 1)  # log C(m, j)
        best = min(best, float(ways + np.log(j) + (j - 1) * np.log(share)))
    return float(min(1.0, (m - 1) * np.exp(best)))


def _lilliefors(
    values: NDArray[np.number],
    draw: Callable[[np.random.Generator, tuple[int, int]], NDArray[np.number]],
    distribution: Callable[[Array, Array], Array],
    seed: int,
) -> float:
    """P-value of the largest distance of an empirical distribution to that with its own mean, against draws."""
    rng = np.random.default_rng(seed)
    draws = max(200, min(DRAWS, int(2e6 / values.size)))

    def distance(rows: NDArray[np.number]) -> Array:
        x = np.sort(rows.astype(float), axis=1)
        expected = distribution(x, x.mean(axis=1, keepdims=True))
        upper = np.arange(1, x.shape[1] + 1) / x.shape[1]
        # Of equal values, only the last shows the empirical distribution.
        last = np.append(np.diff(x, axis=1) > 0, np.ones((len(x), 1), dtype=bool), axis=1)
        return np.asarray(np.max(np.where(last, np.abs(upper - expected), 0.0), axis=1))

    own = float(distance(values[None])[0])
    others = distance(draw(rng, (draws, values.size)))
    return _beyond(own, others)


def of_noise(parts: list[Array], order: int = ORDER) -> float:
    """P-value of noise that is normal, and as strong from one moment to the next and from one reading to another.

    Parameters
    ----------
    parts : runs of samples in which nothing but noise is fast
    order : of the differences that leave nothing of the motion
    """
    powers, fourths, readings = [np.empty(0)], [np.empty(0)], [np.empty(0)]
    usual = _median_square(parts, order)
    for part in parts:
        d = np.diff(part, order)
        d = d[: d.size // WINDOW * WINDOW].reshape(-1, WINDOW)
        power = np.mean(d**2, axis=1)
        strong = power > STRONG * usual
        moving = scipy.ndimage.binary_dilation(strong & _moving(power, part, order), iterations=SIDES)
        kept = ~(strong & moving)
        powers.append(power[kept])
        fourths.append(np.mean(d[kept] ** 4, axis=1))
        readings.append(np.abs(np.mean(part[: d.size].reshape(-1, WINDOW), axis=1))[kept])
    power = np.concatenate(powers)
    if power.size < FEWEST_WINDOWS:
        return 1.0
    if not power.all():
        return 0.0
    lull = float(np.log(power.mean()) - np.mean(np.log(power)))
    peak = float(np.concatenate(fourths).mean() / power.mean() ** 2)
    steady = [_compared(value, *moments, power.size) for value, moments in zip((lull, peak), _white(order), strict=True)]
    return min(1.0, 3 * min(*steady, _over_readings(power, np.concatenate(readings))))


def _median_square(parts: list[Array], order: int) -> float:
    """Mean square of the differences of normal noise, by their median."""
    d = np.concatenate([np.empty(0), *(np.diff(part, order) for part in parts)])
    return float(np.median(np.abs(d)) / 0.6745) ** 2 if d.size else 0.0


def _moving(power: Array, part: Array, order: int) -> NDArray[np.bool_]:
    """Windows around which differences of a higher order have clearly less power, in terms of white noise."""
    higher = np.diff(part, order + HIGHER)[: power.size * WINDOW]
    higher = np.pad(higher, (0, power.size * WINDOW - higher.size), mode="edge").reshape(-1, WINDOW)
    ratio = comb(2 * (order + HIGHER), order + HIGHER) / comb(2 * order, order)
    both = (scipy.ndimage.uniform_filter1d(one, SIDES) for one in (power * ratio, np.mean(higher**2, axis=1)))
    low, high = both
    return np.asarray(low > WEAKER * high)


def _over_readings(power: Array, reading: Array) -> float:
    """P-value of a power that is the same at every size of the reading: by ranks (Kruskal and Wallis, JASA 47, 1952)."""
    order = np.argsort(reading, kind="stable")
    ends = np.unique((power.size * np.array(SHARES)).astype(int))
    groups = [power[part] for part in np.split(order, ends) if part.size >= FEWEST]
    return float(scipy.stats.kruskal(*groups).pvalue) if len(groups) > 1 else 1.0


def _compared(value: float, mean: float, sigma: float, windows: int) -> float:
    spread = sigma * np.sqrt(1 / windows + 1 / (WHITE_WINDOWS * WHITE_DRAWS))  # the mean is one of draws, too
    return float(2 * scipy.stats.norm.sf(abs(value - mean) / spread))


@cache
def _white(order: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Mean and sigma, times √windows, of both statistics of white noise."""
    x = np.random.default_rng(1).standard_normal((WHITE_DRAWS, WHITE_WINDOWS * WINDOW + order))
    d = np.diff(x, order, axis=1).reshape(WHITE_DRAWS, WHITE_WINDOWS, WINDOW)
    power = np.mean(d**2, axis=2)
    lull = np.log(power.mean(axis=1)) - np.log(power).mean(axis=1)
    peak = np.mean(d**4, axis=(1, 2)) / power.mean(axis=1) ** 2
    scale = np.sqrt(WHITE_WINDOWS)
    return (float(lull.mean()), float(lull.std() * scale)), (float(peak.mean()), float(peak.std() * scale))


def _beyond(own: float, others: Array) -> float:
    return (1 + int(np.sum(others >= own))) / (1 + others.size)
