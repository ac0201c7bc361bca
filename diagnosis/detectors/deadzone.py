"""A dead zone seen at low frequency: slow readings that are zero, or outside of the zone, and nothing in between.

A dead zone acts on the rate; the white noise behind it goes on, so that no sample reads exactly zero and the noise level is
as ever. Two things show it. Where the true rate stays inside, the mean reading is zero to √n times better than the noise;
with s₀ the usual size of slow raw rates, s₁ that of their differences, and σ_m the sigmas of the stretches' means m, the log
odds of that are

    log N(m; 0, diag σ_m²) − log N(m; 0, diag σ_m² + s₀² 1 1ᵀ + s₁² I)

Where the body's slow motion r ~ N(μ, s²) takes the rate across the edge, means over a few seconds, of noise σ, have under M0
and under a dead zone of half width d the likelihoods

    p₀(m) = N(m; μ, s² + σ²)
    p_d(m) = P(|r| < d) N(m; 0, σ²) + N(m; μ, s² + σ²) P(|r| > d | m)

averaged over μ, s and d, and over a motion that sways, r = μ + √2 s cos φ, whose φ is summed over a grid. Means that follow
one another are not independent, so this ratio is tempered. Both count in favour of this cause only where the attitude shows
that rates are missing, since a gyro may happen to have no bias. The columns are a constant missing rate in each of the slow
stretches.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, ndtr
from scipy.stats import multivariate_normal, norm

from diagnosis.detectors.gap_interpolation import runs
from diagnosis.model.recording import RecordingModel
from gyrocal.recording import Recording

Array = NDArray[np.float64]

WINDOW_S = 5.0  # s, of the means: short beside the body's slow motion
SLOW = 24.0  # sigmas of a mean that count as a slow rate
SHORT_WINDOW_S = 2.0  # s, of the means that show its size
SHORTEST_S = 120.0  # s of a stretch
EDGE = 0.2  # relative error of the half width that means on the edge leave
TEMPER = 0.2  # share of the log ratio that counts
MOST_ODDS = 30.0
LEAST_ODDS = 1.0
LEAK = 0.2  # of the usual raw rate: what misalignments leak of the body's rate
DIFFERENCE = 0.4  # usual size of the differences between stretches beside what they have in common
STILL_S = 200.0  # s of a stretch whose mean is tested against zero
TRIED = 30  # half widths
NARROWEST = 3.5  # of them, in sigmas of a mean: within a narrower one noise and motion look alike
PHASES = 24  # of a swaying motion
SPREADS = 20  # of the motion: fewer, and none fits, so that a turning point at zero looks like a zone
BIN = 0.3  # of the means, in sigmas
REACH = 2.5  # half widths: stretches whose mean reading is beyond miss nothing


@dataclass(frozen=True)
class DeadStretches:
    """What one gyro shows of a dead zone.

    Attributes
    ----------
    axis : which gyro
    stretch : (n,) slow stretch that each sample may miss a rate in, counted from 0; −1 elsewhere
    log_odds : in favour of a dead zone, before the attitude is looked at
    size, sigma : half width as the motion across the edge shows it, rad/s; NaN if none goes across
    alive : smallest steady mean that is read, rad/s, an upper limit; infinite if there is none
    """

    axis: int
    stretch: NDArray[np.intp]
    log_odds: float
    size: float
    sigma: float
    alive: float


def dead_stretches(recording: Recording, rates: Array, noise: Array) -> list[DeadStretches]:
    """Gyros whose slow rates look like those of a dead zone.

    Parameters
    ----------
    recording : for the intervals
    rates : (n, 3) raw rates, repaired, rad/s
    noise : (3,) white noise of a sample, rad/s
    """
    found = []
    for axis in range(3):
        if noise[axis] > 0:
            one = _of_axis(recording, rates[:, axis], float(noise[axis]), axis)
            if one is not None and one.log_odds > LEAST_ODDS:
                found.append(one)
    return found


def missing(model: RecordingModel, one: DeadStretches) -> Array:
    """Observations of a missing rate, deg/s, in all slow stretches and of its differences between them; (N, 1 + stretches)."""
    step = np.searchsorted(model.recording.gyro.t_s, model.t_s, side="right") - 1
    stretch = one.stretch[step]
    numbers = np.unique(stretch[stretch >= 0])
    low = np.zeros((model.t_s.size, 3, 1 + numbers.size))
    low[stretch >= 0, one.axis, 0] = -np.deg2rad(1.0)
    for k, number in enumerate(numbers):
        low[stretch == number, one.axis, 1 + k] = -DIFFERENCE * np.deg2rad(1.0)
    return model.reading(low)


def half_width(one: DeadStretches, common: float, differences: Array, sigma: Array) -> tuple[float, float]:
    """Half width and its sigma, deg/s: as motion across the edge shows it, or between what is swallowed and what passes.

    Parameters
    ----------
    one : what the samples show
    common, differences, sigma : estimated amplitudes of `missing`, and the sigma of the latter, deg/s
    """
    if np.isfinite(one.size):
        return float(np.rad2deg(one.size)), float(np.rad2deg(one.sigma))
    rates = np.abs(common + DIFFERENCE * differences)
    sure = DIFFERENCE * sigma < 0.5 * rates.max()
    low = float(rates[sure].max() if sure.any() else rates.max())
    high = float(np.rad2deg(one.alive))
    if high > low:
        high = min(high, 4 * low)
        return 0.5 * (low + high), max((high - low) / np.sqrt(12), 0.1 * low)
    return 1.3 * low, 0.4 * low


def _of_axis(recording: Recording, x: Array, noise: float, axis: int) -> DeadStretches | None:
    zones = np.geomspace(NARROWEST, 1.5 * SLOW, TRIED)
    stretches, sigma = _slow(recording, x, noise, WINDOW_S)
    if not stretches:
        return None
    ratios = TEMPER * sum((_log_ratios(m, zones) for _, _, m in stretches), np.zeros(TRIED))
    shape = float(logsumexp(ratios) - np.log(TRIED))
    still, dead, alive = _still(x, noise, [(low, high) for low, high, _ in stretches], recording)
    size = spread = float("nan")
    limit = 0.5 * alive / sigma if np.isfinite(alive) else np.inf
    if shape > LEAST_ODDS:
        # The shorter the mean, the less of it is spent on the edge; the longer, the less its noise.
        short, fine = _slow(recording, x, noise, SHORT_WINDOW_S)
        finer = TEMPER * sum((_log_ratios(m, zones) for _, _, m in short), np.zeros(TRIED))
        weight = np.exp(finer - logsumexp(finer))
        size = float(weight @ zones) * fine
        spread = float(np.hypot(np.sqrt(weight @ (zones * fine - size) ** 2), EDGE * size))
        limit = max(limit, REACH * size / sigma)
    stretch = np.full(x.size, -1)
    number = 0
    for low, high, m in stretches:
        if abs(float(m.mean())) < limit and (shape > 0 or dead[low:high].any()):
            stretch[low:high] = number
            number += 1
    odds = min(still + max(shape, 0.0), MOST_ODDS)
    return DeadStretches(axis, stretch, odds, size, spread, alive) if number else None


def _slow(recording: Recording, x: Array, noise: float, window_s: float) -> tuple[list[tuple[int, int, Array]], float]:
    """Stretches of slow rates with their means over a window, in units of its noise; and that noise, rad/s."""
    count = max(2, round(window_s / recording.gyro.sample_s))
    sigma = noise / np.sqrt(count)
    t = recording.gyro.t_s
    stretches = []
    for interval in recording.intervals:
        low, high = np.searchsorted(t, [interval.start_s - 1e-6, interval.stop_s - 1e-6])
        windows = x[low:high][: (high - low) // count * count].reshape(-1, count).mean(axis=1)
        for a, b in runs(np.abs(windows) < SLOW * sigma):
            if (b - a) * window_s >= SHORTEST_S:
                stretches.append((int(low) + a * count, int(low) + b * count, windows[a:b] / sigma))
    return stretches, sigma


def _still(
    x: Array, noise: float, stretches: list[tuple[int, int]], recording: Recording
) -> tuple[float, NDArray[np.bool_], float]:
    """Log odds of the stretches that read zero throughout, those samples, and the least steady mean of the others."""
    usual = float(np.sqrt(np.mean(recording.gyro.apriori_bias**2)))
    dead = np.zeros(x.size, dtype=bool)
    means, sigmas, alive = [], [], np.inf
    for low, high in stretches:
        length = (high - low) // 8
        parts = x[low : low + 8 * length].reshape(8, length).mean(axis=1) * np.sqrt(length) / noise
        mean, sigma = float(x[low:high].mean()), noise / np.sqrt(high - low)
        if (high - low) * recording.gyro.sample_s < STILL_S or usual <= 0:
            continue
        if float(parts @ parts) < 26.0:  # the 0.1 % point of χ² with 8 degrees of freedom
            dead[low:high] = True
            means.append(mean)
            sigmas.append(sigma)
        elif abs(mean) > 5 * sigma:
            alive = min(alive, abs(mean))
    odds = 0.0
    if means:
        # Under M0 the stretches have one bias in common, and differ by what the body's rate leaks into the axis.
        own = np.diag(np.square(sigmas))
        other = own + usual**2 + (LEAK * usual) ** 2 * np.eye(len(means))
        odds = float(multivariate_normal.logpdf(means, cov=own) - multivariate_normal.logpdf(means, cov=other))
    return float(odds), dead, float(alive)


def _log_ratios(m: Array, zones: Array) -> Array:
    """log of the ratio of averaged likelihoods for each half width; all in units of the noise of a mean."""
    edges = np.arange(-SLOW, SLOW + BIN, BIN)
    counts = np.histogram(m, edges)[0]
    plain, both = _table(tuple(zones))
    base = logsumexp(plain @ counts)
    return np.array([logsumexp(one @ counts) - base for one in both])


@lru_cache(maxsize=2)
def _table(zones: tuple[float, ...]) -> tuple[Array, list[Array]]:
    """Log likelihoods of a mean in each bin, under M0 (μ and s, bins) and under each zone; the same for every recording."""
    m = np.arange(-SLOW + BIN / 2, SLOW, BIN)[None, :]
    mu, s = (grid.ravel()[:, None] for grid in np.meshgrid(np.linspace(-SLOW, SLOW, 97), np.geomspace(0.3, SLOW / 2, SPREADS)))
    total = s**2 + 1
    plain = -0.5 * ((m - mu) ** 2 / total + np.log(2 * np.pi * total))
    middle, width = (mu + m * s**2) / total, np.sqrt(s**2 / total)
    zero = -0.5 * (m**2 + np.log(2 * np.pi))
    r = mu + np.sqrt(2) * s * np.cos(np.linspace(0, np.pi, PHASES, endpoint=False) + np.pi / (2 * PHASES))
    each = norm.pdf(m[..., None], r[:, None]) / PHASES
    swaying = np.log(np.maximum(each.sum(axis=2), 1e-300))
    both = []
    for d in zones:
        inside = ndtr((d - mu) / s) - ndtr((-d - mu) / s)
        outside = 1 - (ndtr((d - middle) / width) - ndtr((-d - middle) / width))
        one = np.logaddexp(np.log(np.maximum(inside, 1e-300)) + zero, plain + np.log(np.maximum(outside, 1e-300)))
        out = (np.abs(r) >= d).astype(float)
        seen = np.einsum("ijk,ik->ij", each, out) + (1 - out.mean(axis=1))[:, None] * np.exp(zero)
        both.append(np.vstack([one, np.log(np.maximum(seen, 1e-300))]))
    return np.vstack([plain, swaying]), both
