"""Whether the noise of the samples is independent between the gyros, and the same at all times.

Both use differences of the sixth order, which leave nothing of a motion that is slow beside the sampling. Under M0 those of two
gyros are independent, so that their correlation coefficient over n differences has the variance Σρ²/n, with Σρ² the sum of
their squared autocorrelations; and their mean square is the same in every interval, at rest and in motion.

A motion that is not slow beside the sampling would pass for noise. It leaves far less in differences of the tenth order: parts
in which the two orders disagree are not compared. Both are of the same samples, so that white noise makes their mean squares,
scaled to the noise of one sample, differ little: by the variance (2/n) (Σρ_aa² + Σρ_bb² − 2 Σρ_ab²) of its square. Of a body
that shakes nearly as fast as it is sampled both orders may hold as much; windows in which a line shows that are left out.

Noise that swells and falls within the intervals shows in short windows of n differences each. Of their mean squares the
logarithm has the variance 2 Σρ²/n, and that of the squared medians of absolute values twice as much, nearly
(`spread_of_median`). To be called unsteady, both must scatter more than so, or both be alike from one window to the next. A
body that shakes at many rates for a while may fill one window with what both orders take for noise: the loudest one does not
count.
"""

from __future__ import annotations

from functools import cache
from math import comb, factorial

import numpy as np
import scipy.stats
from numpy.typing import ArrayLike, NDArray

from diagnosis.detectors.report import (
    AXES,
    IMPOSSIBLE,
    SampleReport,
    SampleTest,
    Symptom,
    Tell,
    arcs,
    consecutive,
    inside,
    silent,
)
from gyrocal.recording import Recording
from simulator.effects.recorded import interval_slices

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ORDER, HIGHER = 6, 10
AGREE = 3.0  # sigmas of the difference up to which the two orders say the same


def power_of(order: int) -> int:
    """Variance of a difference of unit white noise."""
    return comb(2 * order, order)


def autocorrelation_of(order: int) -> float:
    """Sum of the squared autocorrelations of differences of white noise."""
    return comb(4 * order, 2 * order) / power_of(order) ** 2


@cache
def disagreement_of(low: int, high: int) -> float:
    """Sum of squared correlations that stands for the difference of the mean squares of two orders."""
    a, b = ([comb(order, k) * (-1.0) ** k / np.sqrt(power_of(order)) for k in range(order + 1)] for order in (low, high))
    both = float(np.sum(np.correlate(a, b, "full") ** 2))
    return autocorrelation_of(low) + autocorrelation_of(high) - 2 * both


def agree(low: ArrayLike, high: ArrayLike, orders: tuple[int, int], count: ArrayLike) -> Mask:
    """Whether mean squares of two orders of differences of the same samples show one level, the lower no motion."""
    level = np.asarray(high, dtype=float)
    error = np.sqrt(2 * disagreement_of(*orders) / np.maximum(count, 1))
    return np.asarray(np.abs(np.subtract(low, level)) < AGREE * level * error)


@cache
def spread_of_median(order: int) -> float:
    """n times the variance of the logarithm of the squared median of n absolute values, of differences of white noise.

    The median m of |z| has the variance Σ_k C(ρ_k)/(n f²), with f the density of |z| there and C(ρ) the covariance of two
    being below it, whose series in ρ has the Hermite coefficients of that interval (Mehler).
    """
    m = float(scipy.stats.norm.ppf(0.75))
    density = 2 * float(scipy.stats.norm.pdf(m))
    lags = np.arange(-order, order + 1)
    correlation = np.array([(-1.0) ** k * comb(2 * order, order + k) for k in lags]) / power_of(order)
    own = lags == 0
    total = 0.25  # of a value with itself, where the series is slow
    for k in range(2, 40, 2):
        hermite = np.polynomial.hermite_e.hermeval(m, [0.0] * (k - 1) + [1.0]) * density
        total += float(hermite**2 / factorial(k) * np.sum(correlation[~own] ** k))
    return 4 * total / (density * m) ** 2


AUTOCORRELATION = autocorrelation_of(ORDER)
TRIM = 5.0  # robust sigmas beyond which a difference does not count
FEWEST = 400  # differences of a part, below which it is not compared
EFFICIENCY = 0.37  # of the median of absolute values, for the scale of normal noise
FAST = 0.7  # of half the rate of the samples, above which a line counts in differences of the sixth order
RINGING = 1e-3  # p-value of such a line, below which a window is left out: one in a thousand of white noise
WINDOWS = 12  # of an axis, below which nothing is said of how they scatter
NOTABLE = 0.05  # relative difference of the variance that matters
SPOILT = 3.0  # log odds of a dead zone, from which on the noise comes and goes with it
SWELLING = 0.01  # of the power, that matters where it comes and goes


def together(report: SampleReport, recording: Recording, quiet: Mask) -> None:
    """Noise that two gyros have in common."""
    parts = [np.diff(report.rates[low:high], ORDER, axis=0) for low, high in arcs(quiet & consecutive(recording, quiet))]
    if not parts:
        return
    d = np.concatenate(parts)
    scale = np.median(np.abs(d), axis=0) / 0.6745
    if len(d) < FEWEST or not np.all(scale > 0):
        return
    d = d[np.all(np.abs(d) < TRIM * scale, axis=1)]
    if not d.any(axis=0).all():  # readings that stand still
        return
    for i, j in ((0, 1), (0, 2), (1, 2)):
        coefficient = float(np.mean(d[:, i] * d[:, j]) / np.sqrt(np.mean(d[:, i] ** 2) * np.mean(d[:, j] ** 2)))
        p = max(float(2 * scipy.stats.norm.sf(abs(coefficient) / np.sqrt(AUTOCORRELATION / len(d)))), IMPOSSIBLE)
        pair = AXES[i] + AXES[j]
        text = f"the noise of gyros {AXES[i]} and {AXES[j]} correlates by {coefficient:.3f}"
        report.tests.append(SampleTest("noise_correlation", pair, coefficient, 0.0, p, "noise_correlation", text))
        if p < report.event_p and abs(coefficient) > NOTABLE:
            error = float(np.sqrt(AUTOCORRELATION / len(d)))
            report.symptoms.append(
                Symptom("noise_correlation", None, coefficient, "of the noise", error, {"gyros": pair}, p, text)
            )


def constancy(report: SampleReport, recording: Recording, used: Mask, tell: Tell = silent) -> None:
    """Noise that differs between intervals, or between slow and fast motion."""
    tell("noise over time: differences", 0.0)
    good = used & inside(recording) & ~report.filled & ~report.clipped
    follows = consecutive(recording, good)
    whole = np.convolve(follows, np.ones(HIGHER, dtype=int))[: follows.size] == HIGHER
    place = np.flatnonzero(whole)
    differences = {order: _scaled(report.rates, place, order) for order in (ORDER, HIGHER)}
    rate = np.linalg.norm(report.rates[place], axis=1)
    interval = np.full(report.rates.shape[0], -1)
    for number, part in enumerate(interval_slices(recording)):
        interval[part] = number
    owner = interval[place]
    fast = rate > 0.5 * (np.quantile(rate, 0.02) + np.quantile(rate, 0.98)) if rate.size else np.zeros(0, dtype=bool)
    for axis in range(3):
        z, higher = (differences[order][:, axis] for order in (ORDER, HIGHER))
        if z.size < 2 * FEWEST or not np.any(z):
            continue
        tell(f"noise of gyro {AXES[axis]} over time", 0.1 + 0.3 * axis)
        kept = (np.abs(z) < 2 * TRIM * float(np.median(np.abs(z))) / 0.6745) & ~_ringing(z, owner)
        parts = [kept & fast, kept & ~fast, *(kept & (owner == number) for number in np.unique(owner))]
        groups = [part for part in parts if part.sum() >= FEWEST and _at_rest(z[part], higher[part])]
        tell(f"noise of gyro {AXES[axis]} in each interval", 0.2 + 0.3 * axis)
        p, ratio, count = _least(z, higher, kept, groups)
        text = f"the noise of gyro {AXES[axis]} is {np.sqrt(ratio):.2f} times that of the whole in one part of the recording"
        report.tests.append(SampleTest("noise_constancy", AXES[axis], ratio, 1.0, p, "noise_constancy", text))
        if p < report.event_p and abs(ratio - 1) > 2 * NOTABLE:
            error = float(ratio * np.sqrt(2 * AUTOCORRELATION / max(count, 1)))
            report.symptoms.append(Symptom("noise_constancy", AXES[axis], ratio, "of its power", error, {}, p, text))
            continue
        if axis in report.zones and report.zones[axis].log_odds > SPOILT:
            continue
        p, swell = _swells(_windows(z, higher, kept, owner))
        text = f"the noise of gyro {AXES[axis]} swells and falls by {100 * swell:.0f} % of its power from window to window"
        _unsteady(report, axis, SampleTest("noise_steadiness", AXES[axis], swell, 0.0, p, "noise_constancy", text))


def _unsteady(report: SampleReport, axis: int, test: SampleTest) -> None:
    """Keep a test of the noise over time, and what it shows."""
    report.tests.append(test)
    if test.p_value < report.event_p and test.value > SWELLING:
        error = test.value / float(scipy.stats.norm.isf(0.5 * test.p_value))
        report.symptoms.append(
            Symptom("noise_constancy", AXES[axis], test.value, "of its power", error, {}, test.p_value, test.text)
        )


def _scaled(rates: Array, place: NDArray[np.intp], order: int) -> Array:
    """Differences that end at some samples, (n, 3), scaled to the noise of one."""
    return np.asarray(np.diff(rates, order, axis=0)[place - order] / np.sqrt(power_of(order)))


def _at_rest(z: Array, higher: Array) -> bool:
    """Whether differences of both orders show the same noise, so that no motion is left in the lower one."""
    return bool(agree(np.mean(z**2), np.mean(higher**2), (ORDER, HIGHER), z.size))


def _windows(z: Array, higher: Array, kept: Mask, owner: NDArray[np.intp]) -> Array:
    """(w, 2) logarithms of the power in windows, by the mean square and by the median; NaN where a motion is left."""
    found = [np.empty((0, 2))]
    for number in np.unique(owner):
        own = np.flatnonzero(owner == number)
        windows = own[: own.size // FEWEST * FEWEST].reshape(-1, FEWEST)
        there = kept[windows]
        count = there.sum(axis=1)
        low, high = (np.sum(np.where(there, one[windows], 0.0) ** 2, axis=1) / np.maximum(count, 1) for one in (z, higher))
        sizes = np.sort(np.where(there, np.abs(z[windows]), np.inf), axis=1)  # those that do not count are last
        each = np.arange(count.size)
        middle = 0.5 * (sizes[each, np.maximum(count - 1, 0) // 2] + sizes[each, np.minimum(count // 2, FEWEST - 1)])
        good = (count > 0.9 * FEWEST) & agree(low, high, (ORDER, HIGHER), count) & (middle > 0)
        logs = np.full((count.size, 2), np.nan)
        logs[good] = np.column_stack([np.log(low[good]), 2 * np.log(middle[good])])
        found += [logs, np.full((1, 2), np.nan)]  # the next interval is no neighbour
    return np.concatenate(found)


def _ringing(z: Array, owner: NDArray[np.intp]) -> Mask:
    """(n,) differences of sixth order in windows of an interval that have a line near half the rate of the samples.

    A body that shakes so fast leaves as much in differences of either order, but no white noise (Fisher's test of the largest
    ordinate of a periodogram). The last window of an interval ends with it.
    """
    out = np.zeros(z.size, dtype=bool)
    half_turn = np.pi * np.fft.rfftfreq(FEWEST)
    fast = half_turn > 0.5 * np.pi * FAST
    gain = (2 * np.sin(half_turn[fast])) ** (2 * ORDER)
    for number in np.unique(owner):
        own = np.flatnonzero(owner == number)
        begins = np.arange(0, own.size - FEWEST + 1, FEWEST)
        if not begins.size:
            continue
        windows = own[np.union1d(begins, own.size - FEWEST)[:, None] + np.arange(FEWEST)]
        power = np.abs(np.fft.rfft(z[windows], axis=1)[:, fast]) ** 2 / gain
        share = power.max(axis=1) / np.maximum(power.sum(axis=1), 1e-300)
        out[windows[gain.size * (1 - share) ** (gain.size - 1.0) < RINGING]] = True
    return out


def _swells(logs: Array) -> tuple[float, float]:
    """P-value of steady noise, by the less surprised of both columns, and by how much more than that the first scatters."""
    there = np.isfinite(logs[:, 0])
    if there.sum() <= WINDOWS:
        return 1.0, 0.0
    logs = logs.copy()
    logs[np.nanargmax(logs[:, 0])] = np.nan
    there = np.isfinite(logs[:, 0])
    expected = np.array([2 * AUTOCORRELATION, spread_of_median(ORDER)]) / FEWEST
    x = (logs - logs[there].mean(axis=0)) / np.sqrt(expected)
    scatter = np.sum(x[there] ** 2, axis=0)
    of_scatter = scipy.stats.chi2.sf(scatter, there.sum() - 1)
    pairs = x[1:] * x[:-1]
    pairs = pairs[np.isfinite(pairs[:, 0])]
    alike = pairs.sum(axis=0) / np.maximum(np.sqrt(np.sum(pairs**2, axis=0)), 1e-300)
    p = 2 * min(float(of_scatter.max()), float(scipy.stats.norm.sf(alike).max()))
    more = float(np.sqrt(max((scatter[0] / (there.sum() - 1) - 1.0) * expected[0], 0.0)))
    return min(1.0, max(p, IMPOSSIBLE)), more


def _least(z: Array, higher: Array, kept: Mask, groups: list[Mask]) -> tuple[float, float, int]:
    """The smallest p-value of a group having the power of the rest, corrected for their number; its ratio and size."""
    best = (1.0, 1.0, 0)
    for group in groups:
        rest = kept & ~group
        n, m = int(group.sum()), int(rest.sum())
        if min(n, m) < FEWEST or not _at_rest(z[rest], higher[rest]):
            continue
        ratio = float(np.mean(z[group] ** 2) / np.mean(z[rest] ** 2))
        # Each mean square is about χ² with n/Σρ² degrees of freedom.
        compared = scipy.stats.f(n / AUTOCORRELATION, m / AUTOCORRELATION)
        # A jerk adds to the mean square and not to the median.
        middle = float(np.log(np.median(np.abs(z[group])) / np.median(np.abs(z[rest]))))
        spread = float(np.sqrt(AUTOCORRELATION / (2 * EFFICIENCY) * (1 / n + 1 / m)))
        chances = min(compared.sf(ratio), compared.cdf(ratio)), scipy.stats.norm.sf(abs(middle) / spread)
        p = min(1.0, 2 * len(groups) * float(max(chances)))
        if p < best[0]:
            best = (max(p, IMPOSSIBLE), ratio, n)
    return best
