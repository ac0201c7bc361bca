"""Time offset, clock rate, direction, mounting and scale factor between a gyro and attitudes, with their sigmas.

With t the time of the attitudes, the mean body rate of a window by the attitudes is

    w_ref(t) = s C w_gyro(t₀ + (t + τ − t₀)/f) + b + noise

τ is added to the attitudes' tags. f is the factor of the gyro's tags about its first one, t₀. C rotates the gyro's axes to
those of the attitudes. The search begins where both speeds correlate best over all τ and some hundred f: neither C nor the
direction of the attitudes changes a speed. Gauss-Newton steps on τ, f, C, s and b follow, for each direction of the attitudes.

Unequal scale factors and skew axes of the gyro are not in s C and can be mistaken for a time offset. If a free matrix fits
equally well with the tags as they are, τ and f are not significant: their sigmas are at least their values over the
significance of both, which counts as one if it is smaller. A rotation needs motion about two axes. If it explains less than
half of the motion across the main axis, errors of the gyro may cause its angle: its sigma is then at least the angle.

Windows overlap, and residuals of a wrong G are not white: the covariance is that of sums over blocks of time (a sandwich
estimator by clusters; White, Econometrica 48, 1980), for τ and f beside a free matrix in place of s C. A delay that differs
between parts of the recording, as by a clock that slips, leaves residuals over many blocks: a sigma is at least that with the
correlation of neighbouring blocks (Newey and West, Econometrica 55, 1987). An offset that is stated without a clock rate is
that of a fit without one, over the whole recording.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array, Mask
from gyrocal.importing.motion import MOST_WINDOW_TURN, Motion, build_motion, integrate_rates, rotate_onto

MOST_CLOCK_ERROR = 0.03  # of a clock rate, searched about one, powers of ten and the ratio of both durations
MOST_GRID = 1 << 14  # points of the search
MOST_CLOCKS = 300  # clock rates of one search
LEAST_COMMON = 0.5  # of the shorter side: overlap of a time offset
STARTS = 4  # maxima of the correlation from which the fit begins
CLUSTERS = 24  # of time, whose sums give the covariance
CORRELATED_CLUSTERS = 5  # that may correlate: about the square root of their number
FEWEST_ALIGNED_WINDOWS = 12
STEPS = 25
# Share of the data's information: a parameter that the motion does not determine keeps its start value, with a large sigma.
PRIOR_STRENGTH = 1e-6
SIGNIFICANT_IN_SIGMA = 3.0
DIRECTION_RATIO = 0.5  # times the residual as read: the other direction must fit so much better
LEAST_FACTOR = 0.1  # deviation of a scale factor from one: a smaller one is a gyro's own, which a calibration estimates
LEAST_TURN = np.deg2rad(1.0)
MOST_LEFT_ACROSS = 0.5  # share of the square of the motion across its main axis that a significant rotation may leave


@dataclass(frozen=True)
class Alignment:
    """Alignment of the gyro with the attitudes: time, rotation and scale."""

    # offset_s, offset_sigma: τ, s
    offset_s: float
    offset_sigma: float
    # time_factor, time_sigma: f
    time_factor: float
    time_sigma: float
    reverse: bool  # whether the attitudes' direction is the other one
    # C, turn_sigma: (3, 3), orthogonal, and (3,) 1-sigma of the rotation about the body's axes, rad
    C: Array
    turn_sigma: Array
    # factor, factor_sigma: s
    factor: float
    factor_sigma: float
    bias: Array  # (3,) rad/s
    residual: float  # over the motion

    @property
    def turn(self) -> Array:
        """(3,) rotation vector of C, rad."""
        return np.asarray(Rotation.from_matrix(self.C).as_rotvec())

    @property
    def is_turned(self) -> bool:
        """Whether C is more than its sigma and a gyro's own misalignment."""
        angle = float(np.linalg.norm(self.turn))
        return angle > max(LEAST_TURN, SIGNIFICANT_IN_SIGMA * float(np.linalg.norm(self.turn_sigma)))

    @property
    def is_scaled(self) -> bool:
        """Whether the factor is more than a gyro's own scale error."""
        return abs(self.factor - 1) > max(LEAST_FACTOR, SIGNIFICANT_IN_SIGMA * self.factor_sigma)

    @property
    def is_late(self) -> bool:
        """Whether the time offset differs from zero."""
        return abs(self.offset_s) > SIGNIFICANT_IN_SIGMA * self.offset_sigma

    @property
    def is_clock_off(self) -> bool:
        """Whether one clock is faster than the other."""
        return abs(self.time_factor - 1) > SIGNIFICANT_IN_SIGMA * self.time_sigma

    def describe_offset(self) -> str:
        """Describe the time offset with its sigma, and whether it differs from zero."""
        return (
            f"time offset by the rates: {self.offset_s:+.6g} ± {self.offset_sigma:.2g} s (1-sigma) to be added to the "
            f"attitudes' time tags, which {'differs' if self.is_late else 'does not differ'} from zero"
        )

    def describe(self) -> list[str]:
        """Describe each quantity with its sigma, a sentence each."""
        turn, sigma = np.rad2deg(self.turn), np.rad2deg(self.turn_sigma)
        ppm = 1e6 * (self.time_factor - 1)
        clock = f"{ppm:+.4g} ± {1e6 * self.time_sigma:.2g} ppm"
        if abs(ppm) > 1e5:
            clock = f"times {self.time_factor:.7g} ± {self.time_sigma:.2g}"
        mounting = ", ".join(f"{a:.4g} ± {b:.2g}" for a, b in zip(turn, sigma, strict=True))
        suffix = ", left to the calibration"
        return [
            self.describe_offset(),
            f"clock of the gyro: {clock}{'' if self.is_clock_off else ', which does not differ from zero'}",
            f"direction of the attitudes: {'the other one' if self.reverse else 'as stated'}",
            f"mounting of the gyro (rotation vector): {mounting} deg{'' if self.is_turned else suffix}",
            f"factor of the rates: {self.factor:.5g} ± {self.factor_sigma:.2g}{'' if self.is_scaled else suffix}",
        ]


def estimate_alignment(
    t_s: Array, rates: Array, sample_s: float, t_ref: Array, q: Array, accumulated: bool = False
) -> Alignment | None:
    """Estimate the alignment of a gyro with attitudes, whose time spans may differ; None if the motion does not determine it.

    accumulated: whether the rates are differences of an accumulated angle, which a factor of time makes smaller
    """
    candidates = []
    for offset, factor in search_starts(*integrate_rates(t_s, rates, sample_s), t_ref, q):
        windows = build_motion(t_s[0] + factor * (t_s - t_s[0]), rates, factor * sample_s, t_ref + offset, q)
        fit = None if windows is None else refine(windows)
        if fit is None:
            continue
        # τ and f of the fit are relative to the start of the search.
        time_factor = factor * fit.time_factor
        scale = time_factor if accumulated else 1.0
        fit = replace(fit, offset_s=offset + fit.offset_s, time_factor=time_factor, time_sigma=factor * fit.time_sigma)
        candidates.append(replace(fit, factor=fit.factor * scale, factor_sigma=fit.factor_sigma * scale))
    best = min(candidates, key=lambda candidate: candidate.residual, default=None)
    if best is None or best.is_clock_off:
        return best
    # Without a clock rate the offset is that of the whole recording.
    windows = build_motion(t_s, rates, sample_s, t_ref + best.offset_s, q)
    offset_fit = None if windows is None else refine(windows, best.reverse, with_clock=False)
    if offset_fit is None:
        return best
    return replace(best, offset_s=best.offset_s + offset_fit.offset_s)


def refine(windows: Motion, reverse: bool | None = None, with_clock: bool = True, mirrored: bool = False) -> Alignment | None:
    """Estimate the alignment near the tags as they are; None if there are too few windows.

    Without a clock rate the offset is that of the whole recording.

    reverse: direction of the attitudes; None takes the one that fits
    mirrored: whether C may be a reflection, as of axes that are exchanged
    """
    if reverse is not None:
        return _fit(windows, reverse, with_clock, mirrored)
    as_stated, reversed_fit = (_fit(windows, is_reversed, with_clock, mirrored) for is_reversed in (False, True))
    if as_stated is None or reversed_fit is None:
        return as_stated or reversed_fit
    return reversed_fit if reversed_fit.residual < DIRECTION_RATIO * as_stated.residual else as_stated


class _Parameters(NamedTuple):
    """Parameters of the fit."""

    C: Array
    scale: float
    bias: Array
    at_centre: float = 0.0  # offset at the centre of the time, s; it and the rate are nearly uncorrelated
    rate: float = 0.0  # 1/f − 1


def _fit(windows: Motion, reverse: bool, with_clock: bool, mirrored: bool) -> Alignment | None:
    """Fit all parameters by Gauss-Newton steps for one direction of the attitudes; None if there are too few windows."""
    reference = windows.compute_attitude_rates(reverse=reverse)
    current = _estimate_start(windows, reference, mirrored)
    if current is None:
        return None
    t0, middle = windows.t_s[0], 0.5 * (windows.start_s + windows.stop_s)
    centre, span = float(middle.mean()) - t0, float(windows.stop_s[-1] - windows.start_s[0])
    length = float(np.median(windows.stop_s - windows.start_s))
    since_centre = with_clock * (middle - t0 - centre)
    for _ in range(STEPS):
        offset, factor = _convert_to_offset(current.at_centre, current.rate, centre), 1 / (1 + current.rate)
        mean, slope, inside = _differentiate_rates(windows, offset, factor, 0.25 * length)
        if inside.sum() < FEWEST_ALIGNED_WINDOWS:
            return None
        model = current.scale * mean @ current.C.T
        residual = reference[inside] - model - current.bias
        J, size, N = _scale_columns(_build_columns(model, current.scale * slope @ current.C.T, since_centre[inside]))
        step = np.linalg.solve(N, J.T @ residual.ravel()) / size
        current, is_done = _take_step(current, step, length, span)
        if is_done:
            break
    time_share = (middle[inside] - middle[inside][0]) / max(span, 1e-300)
    cov = _compute_covariance(J, residual, N, time_share) / np.outer(size, size)
    r0 = reference[inside] - reference[inside].mean(axis=0)
    turn_sigma = _compute_turn_sigma(np.sqrt(np.diag(cov)[2:5]), current.C, residual, r0)
    offset, factor = clock = _convert_to_offset(current.at_centre, current.rate, centre), 1 / (1 + current.rate)
    sigmas = _compute_time_sigmas(windows, reference, clock, inside, since_centre, with_clock * centre)
    share = float(np.sqrt(np.sum(residual * residual) / max(np.sum(r0 * r0), 1e-300)))
    scale, scale_sigma = current.scale, float(current.scale * np.sqrt(cov[5, 5]))
    times = offset, sigmas[0], factor, sigmas[1]
    return Alignment(*times, reverse, np.asarray(current.C), turn_sigma, scale, scale_sigma, current.bias, share)


def _estimate_start(windows: Motion, reference: Array, mirrored: bool) -> _Parameters | None:
    """Estimate rotation, scale factor and bias with the tags as they are; None if there are too few windows or no motion."""
    gyro, inside = _average_rates(windows, 0.0, 1.0)
    if inside.sum() < FEWEST_ALIGNED_WINDOWS:
        return None
    r, g = reference[inside], gyro[inside]
    r0, g0 = r - r.mean(axis=0), g - g.mean(axis=0)
    if not np.sum(r0 * r0) > 0 or not np.sum(g0 * g0) > 0:
        return None
    C, common = rotate_onto(r0, g0, mirrored)
    scale = max(common, 1e-3 * np.sum(g0 * g0)) / float(np.sum(g0 * g0))
    return _Parameters(C, scale, r.mean(axis=0) - scale * C @ g.mean(axis=0))


def _take_step(current: _Parameters, step: Array, length: float, span: float) -> tuple[_Parameters, bool]:
    """Add a step (9,), which is clipped, to the parameters; also return whether the step is negligible."""
    step[0] = np.clip(step[0], -0.5 * length, 0.5 * length)
    step[1] = np.clip(step[1], -length / span, length / span)
    C = Rotation.from_rotvec(np.clip(step[2:5], -0.5, 0.5)).as_matrix() @ current.C
    scale = current.scale * float(np.exp(np.clip(step[5], -0.5, 0.5)))
    is_done = abs(step[0]) + abs(step[1]) * span < 1e-6 * length and np.abs(step[2:6]).max() < 1e-7
    return _Parameters(C, scale, current.bias + step[6:], current.at_centre + step[0], current.rate + step[1]), bool(is_done)


def _compute_turn_sigma(sigma: Array, C: Array, residual: Array, r0: Array) -> Array:
    """Raise the sigma (3,) of the rotation to at least its angle if the rotation explains little across the main axis, rad."""
    across = np.linalg.eigh(r0.T @ r0)[1][:, :2]
    floor = np.finfo(float).eps * np.sum(r0**2)  # where all rates are along one line
    if np.sum((residual @ across) ** 2) > MOST_LEFT_ACROSS * np.sum((r0 @ across) ** 2) + floor:
        return np.maximum(sigma, np.linalg.norm(Rotation.from_matrix(C * np.sign(np.linalg.det(C))).as_rotvec()))
    return sigma


def _compute_time_sigmas(
    windows: Motion, reference: Array, clock: tuple[float, float], inside: Mask, since_centre: Array, centre: float
) -> tuple[float, float]:
    """Compute the sigma of the offset, s, and of the factor, which are at least their values over the significance of both.

    clock: offset, s, and factor; since_centre, centre: (n,) s from the centre to each window, and s from t₀ to the centre;
    zeros where no clock rate is fitted
    """
    offset, factor = clock
    cov = _compute_time_covariance(windows, reference, offset, factor, since_centre)
    to_offset = np.array([factor, -factor * centre])  # the offset is f (τ_c − rate·centre)
    offset_sigma, time_sigma = float(np.sqrt(to_offset @ cov @ to_offset)), float(factor**2 * np.sqrt(cov[1, 1]))
    # In sigma, by the likelihood ratio of as many independent rates as windows side by side have.
    independent = 3 * inside.sum() / float(np.median(windows.rows[:, 1] - windows.rows[:, 0]))
    before, after = (_compute_matrix_misfit(windows, reference, *trial) + np.finfo(float).tiny for trial in ((0.0, 1.0), clock))
    least = 1 / np.sqrt(max(independent * np.log(before / after), 1.0))
    return max(offset_sigma, least * abs(offset)), max(time_sigma, least * abs(factor - 1))


def _compute_time_covariance(windows: Motion, reference: Array, offset: float, factor: float, since: Array) -> Array:
    """Compute the covariance (2, 2) of the offset at the centre and of 1/f, fitted together with a free matrix and a bias.

    With a rotation and a scale factor the estimate is nearly the same, but its residuals hold the gyro's other errors.

    since: (n,) s from the centre of the time to each window; zeros where no clock rate is fitted
    """
    length = float(np.median(windows.stop_s - windows.start_s))
    mean, slope, inside = _differentiate_rates(windows, offset, factor, 0.25 * length)
    free = np.linalg.qr(np.column_stack([mean, np.ones(len(mean))]))[0]
    M = np.linalg.lstsq(mean - mean.mean(axis=0), reference[inside], rcond=None)[0]
    J = np.stack([slope @ M, (slope @ M) * since[inside, None]], axis=2)
    J = (J - np.tensordot(free, np.tensordot(free.T, J, axes=1), axes=1)).reshape(-1, 2)
    residual = reference[inside] - free @ (free.T @ reference[inside])
    J, size, N = _scale_columns(J)
    middle = 0.5 * (windows.start_s + windows.stop_s)[inside]
    time_share = (middle - middle[0]) / max(float(windows.stop_s[-1] - windows.start_s[0]), 1e-300)
    return _compute_covariance(J, residual, N, time_share) / np.outer(size, size)


def _scale_columns(J: Array) -> tuple[Array, Array, Array]:
    """Scale derivatives (n, p) to unit length; return them, their lengths (p,), and the normal matrix (p, p) with its prior."""
    size = np.sqrt(np.sum(J * J, axis=0))
    size[size == 0] = 1.0
    return J / size, size, (J / size).T @ (J / size) + PRIOR_STRENGTH * np.eye(size.size)


def _compute_matrix_misfit(windows: Motion, reference: Array, offset: float, factor: float) -> float:
    """Compute the mean square residual of a free matrix and a bias at an offset and a clock rate, (rad/s)²."""
    gyro, inside = _average_rates(windows, offset, factor)
    columns = np.column_stack([gyro[inside], np.ones(np.count_nonzero(inside))])
    residual = reference[inside] - columns @ np.linalg.lstsq(columns, reference[inside], rcond=None)[0]
    return float(np.mean(np.square(residual)))


def _differentiate_rates(windows: Motion, offset: float, factor: float, h: float) -> tuple[Array, Array, Mask]:
    """Compute mean rates of the gyro, their slopes per s of its time, and the windows in which both are known."""
    (gyro, inside), (later, a), (earlier, b) = (_average_rates(windows, offset + k * h * factor, factor) for k in (0, 1, -1))
    inside = inside & a & b
    return gyro[inside], (later - earlier)[inside] / (2 * h), inside


def _build_columns(model: Array, slope: Array, since_centre: Array) -> Array:
    """Build the derivatives (3 n, 9) of the modelled rates by τ at the centre, 1/f, the rotation, ln s and b."""
    columns = np.empty((len(model), 3, 9))
    columns[:, :, 0] = slope
    columns[:, :, 1] = slope * since_centre[:, None]
    for k, axis in enumerate(np.eye(3)):
        columns[:, :, 2 + k] = np.cross(axis, model)
    columns[:, :, 5] = model
    columns[:, :, 6:] = np.eye(3)
    return columns.reshape(-1, 9)


def _compute_covariance(J: Array, residual: Array, N: Array, time_share: Array) -> Array:
    """Compute the sandwich covariance (p, p) of scaled derivatives (3 n, p) by clusters of time; time_share (n,) is 0 to 1."""
    scores = (J * residual.ravel()[:, None]).reshape(len(residual), 3, -1).sum(axis=1)
    cluster = np.minimum((CLUSTERS * time_share).astype(int), CLUSTERS - 1)
    sums = np.stack([scores[cluster == k].sum(axis=0) for k in np.unique(cluster)])
    inverse = np.linalg.inv(N)
    variance = sums.T @ sums
    correlated = variance.copy()
    for lag in range(1, min(CORRELATED_CLUSTERS, len(sums) - 1) + 1):
        product = sums[lag:].T @ sums[:-lag]
        correlated += (1 - lag / (CORRELATED_CLUSTERS + 1)) * (product + product.T)
    # A parameter that only the prior determines has at least the uncertainty given by the size of the residual.
    prior_variance = PRIOR_STRENGTH * float(np.mean(np.square(residual))) * np.eye(len(N))
    degrees = max(len(sums) - 5, 1)
    C, slow = (inverse @ (scatter * len(sums) / degrees + prior_variance) @ inverse for scatter in (variance, correlated))
    inflation = np.sqrt(np.maximum(np.diag(slow) / np.diag(C), 1.0))
    return np.asarray(C * np.outer(inflation, inflation))


def _convert_to_offset(at_centre: float, rate: float, centre: float) -> float:
    """Convert a gyro's time t + τ_c + rate (t − t₀ − centre) to τ of t₀ + (t + τ − t₀)/f with 1/f = 1 + rate."""
    return (at_centre - rate * centre) / (1 + rate)


def _average_rates(windows: Motion, offset: float, factor: float) -> tuple[Array, Mask]:
    """Compute the mean rates (n, 3) of the gyro over the windows, its tags times a factor, and the windows that it covers."""
    t0 = windows.t_s[0]
    return windows.average_gyro_rates(*(t0 + (edge + offset - t0) / factor for edge in (windows.start_s, windows.stop_s)))


def search_starts(edges: Array, angle: Array, t_ref: Array, q: Array) -> list[tuple[float, float]]:
    """Search the offsets and time factors at which the speeds of both correlate best; the first are the tags as they are.

    edges, angle: (n,) s and (n, 3) rad of the gyro, see `integrate_rates`
    """
    attitude, step = Rotation.from_quat(q), float(np.median(np.diff(t_ref)))
    fast = float(np.percentile((attitude[:-1].inv() * attitude[1:]).magnitude() / np.diff(t_ref), 90))
    span_ref, span_gyro = float(t_ref[-1] - t_ref[0]), float(edges[-1] - edges[0])
    # Windows as long as a slow turn allows, and a grid of half of them.
    stride = max(round(max(min(MOST_WINDOW_TURN / max(fast, 1e-12), span_ref / 60), step) / step), 1)
    length = stride * step
    dt = max(length / 2, 2 * max(span_ref, span_gyro) / MOST_GRID) if span_gyro < 100 * span_ref else length / 2
    by_attitudes = (attitude[:-stride].inv() * attitude[stride:]).magnitude() / (t_ref[stride:] - t_ref[:-stride])
    grid = np.arange(0, span_ref - length, dt)
    speed_ref = np.interp(t_ref[0] + 0.5 * length + grid, 0.5 * (t_ref[stride:] + t_ref[:-stride]), by_attitudes)
    scored: list[tuple[float, float, float]] = []
    for factor in _list_time_factors(span_ref, span_gyro, length):
        begin = np.arange(0, factor * span_gyro - length, dt)
        if not 8 < begin.size < 4 * MOST_GRID or speed_ref.size < 8:
            continue
        first, last = edges[0] + begin / factor, edges[0] + (begin + length) / factor
        turn = np.stack([np.interp(last, edges, x) - np.interp(first, edges, x) for x in angle.T], axis=1)
        score, lag = _correlate(speed_ref, np.linalg.norm(turn, axis=1))
        # The attitudes' first window, at t_ref[0], lies at the gyro's edges[0] + lag·dt.
        scored.append((score, edges[0] + lag * dt - t_ref[0], factor))
    best = [(offset, factor) for _, offset, factor in sorted(scored, reverse=True)[:STARTS]]
    return [(0.0, 1.0), *best]


def _list_time_factors(span_ref: float, span_gyro: float, length: float) -> set[float]:
    """List the factors of the gyro's tags to search: near one, near a power of ten and near the ratio of both spans.

    length: of a window, s, by which the spans may be wrong
    """
    ratio = span_ref / span_gyro
    bases = [1.0, *(10.0**k for k in (-6, -5, -4, -3, -2, -1, 1, 2, 3, 4, 5, 6) if 0.2 < ratio / 10.0**k < 5)]
    if abs(ratio - 1) > MOST_CLOCK_ERROR:
        bases.append(ratio)
    fine = max(length / max(span_ref, 1e-12), 2 * MOST_CLOCK_ERROR / MOST_CLOCKS)
    half = int(MOST_CLOCK_ERROR / fine)
    return {base * (1 + fine * k) for base in bases for k in range(-half, half + 1)}


def _correlate(reference: Array, gyro: Array) -> tuple[float, int]:
    """Find the largest normalised correlation of reference(i) and gyro(i + lag) over their common points, and the lag."""
    reference, gyro = reference - reference.mean(), gyro - gyro.mean()
    ones_a, ones_b = np.ones(reference.size), np.ones(gyro.size)
    # Count, sums and sums of squares and products of the common points at each lag.
    n = np.maximum(np.round(_sum_products(ones_b, ones_a)), 1)
    sa, sb = _sum_products(ones_b, reference), _sum_products(gyro, ones_a)
    aa, bb = _sum_products(ones_b, reference * reference), _sum_products(gyro * gyro, ones_a)
    ab = _sum_products(gyro, reference)
    va, vb = aa - sa**2 / n, bb - sb**2 / n
    is_valid = (n >= LEAST_COMMON * min(reference.size, gyro.size)) & (va > 1e-9 * aa.max()) & (vb > 1e-9 * bb.max())
    score = np.where(is_valid, (ab - sa * sb / n) / np.sqrt(np.maximum(va * vb, 1e-300)), -1.0)
    best = int(np.argmax(score))
    return float(score[best]), best - (reference.size - 1)


def _sum_products(b: Array, a: Array) -> Array:
    """Compute the sums of b(i + lag) a(i) at all lags, the smallest first, by their Fourier transforms."""
    size = a.size + b.size - 1
    length = next_fast_len(size, real=True)
    return np.asarray(irfft(rfft(b, length) * rfft(a[::-1], length), length)[:size])
