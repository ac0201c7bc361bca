"""Estimates of an import for quantities that are not stated: start bias, angle random walk, sigma of the references."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gyrocal import attitude
from gyrocal.allan.deviation import FEWEST_STRETCH_SAMPLES, overlapping_allan_deviation
from gyrocal.arrays import Array, Indices
from gyrocal.calibration.propagation import Propagation, propagate
from gyrocal.calibration.sampling import TAG_ROUNDING, Measurements, prepare_measurements
from gyrocal.errors import InputError
from gyrocal.importing.column_mapping import Mapping
from gyrocal.importing.gyro_samples import GAP_SAMPLES
from gyrocal.importing.motion import Motion
from gyrocal.importing.reference_join import SensorReferences
from gyrocal.importing.reference_sigma import MAD_TO_SIGMA, ReferenceSigma, Turns, fit_reference_sigma
from gyrocal.importing.streams import BodyAttitudes, Streams
from gyrocal.importing.units import format_degrees
from gyrocal.recording import Attitudes, GyroStream, Interval, Recording

FEWEST_PAIRS = 12
FEWEST_ARRIVALS = 3
BIAS_STEPS = 5
LARGEST_MISS_DEG = 10.0  # median miss of attitudes far apart up to which they determine a bias
ALLAN_S = 0.1  # averaging time at which the angle random walk is read, s
MOST_TURNS = 2000  # used to estimate the sigma of references, in blocks of consecutive turns
BLOCK = 50  # turns
LEAST_CHANGE_TO_NOISE = 100.0  # mean squares of a change of the rate and of the noise of one sample


def estimate_bias(
    mapping: Mapping,
    rates: Array,
    rests: list[tuple[int, int]],
    windows: Motion,
    body: BodyAttitudes,
    streams: Streams,
    notes: list[str],
) -> Array:
    """Estimate the start bias b (3,) of ω = ω_raw + b, rad/s."""
    if mapping.bias_deg_s is not None:
        return np.deg2rad(mapping.bias_deg_s)
    if rests:
        first, stop = rests[0]
        bias, how = -rates[first:stop].mean(axis=0), "minus the mean of the first rest"
    elif windows.is_coarse:
        bias, median_miss = _estimate_bias_of_turns(rates, body, streams)
        how = "from the turns between attitudes far apart"
        if median_miss > np.deg2rad(LARGEST_MISS_DEG):
            notes.append(
                "bias to start from is zero: the attitudes are too far apart to tell it; give bias_deg_s if it is known"
            )
            return np.zeros(3)
    else:
        gyro, inside = windows.compute_gyro_rates()
        bias = (windows.compute_attitude_rates()[inside] - gyro[inside]).mean(axis=0)
        how = "the mean difference of attitudes' and gyro's rates"
        # Without a rest the mean difference holds errors of G too: it is used only where it is larger than they may be.
        if np.linalg.norm(bias) < 0.02 * np.linalg.norm(gyro[inside], axis=1).mean():
            notes.append("bias to start from is zero")
            return np.zeros(3)
    notes.append(f"bias to start from, b = {format_degrees(bias)} deg/s, is {how}")
    return np.asarray(bias)


def _estimate_bias_of_turns(rates: Array, body: BodyAttitudes, streams: Streams) -> tuple[Array, float]:
    """Estimate b (3,), rad/s, from the turns between successive attitudes by Gauss-Newton; also return the median miss, rad."""
    inside = np.flatnonzero((body.t_s >= streams.t_s[0]) & (body.t_s <= streams.t_s[-1] + streams.sample_s))
    gyro = GyroStream(streams.t_s, rates, streams.sample_s, 0.0, np.eye(3), np.zeros(3))
    pairs = _list_pairs(gyro, body.t_s, [inside])
    bias, median_miss = np.zeros(3), np.inf
    try:
        for _ in range(BIAS_STEPS):
            gyro = replace(gyro, apriori_bias=bias)
            theta, _, run = propagate_pairs(gyro, body.t_s, body.q, pairs)
            median_miss = float(np.median(np.linalg.norm(theta, axis=1)))
            bias = bias - np.linalg.lstsq(run.Theta[:, :, 9:].reshape(-1, 3), theta.ravel(), rcond=None)[0]
    except InputError:
        return np.zeros(3), np.inf
    return bias, median_miss


def estimate_walk(
    mapping: Mapping, streams: Streams, rates: Array, rests: list[tuple[int, int]], notes: list[str]
) -> tuple[float, float]:
    """Estimate the angle random walk, rad/sqrt(s), and its degrees of freedom: infinite if stated, 0 of an upper bound."""
    stated, gyros = mapping.arw_deg_per_sqrt_s, streams.gyros
    gain = 1.0 if gyros is None else gyros.gain
    if stated is not None:
        stated_deg = float(np.sqrt(np.mean(np.square(stated)))) if gyros is None or not isinstance(stated, list) else 1.0
        return float(np.deg2rad(stated_deg)) * gain, np.inf
    if gyros is not None:
        parity = (gyros.residuals / gyros.spread)[:, np.isfinite(gyros.residuals).any(axis=0)]
        stretches, how = [parity[np.isfinite(parity).all(axis=1)]], "the parity of the gyros"
    else:
        stretches, how = [rates[a:b] for a, b in rests], f"the Allan deviation of the rests at {ALLAN_S:g} s"
    walk = estimate_walk_at_rest(stretches, streams.sample_s)
    degrees = 0.0 if walk is None else count_walk_degrees(stretches, streams.sample_s)
    if walk is None and gyros is not None:
        raise InputError("gyro: too few samples to tell its noise; give arw_deg_per_sqrt_s")
    if walk is None:
        walk, how = estimate_walk_in_motion(rates, streams.sample_s), "third differences in motion, an upper bound"
    arw = float(np.sqrt(np.mean(np.square(walk)))) * gain
    if not arw > 0:
        raise InputError("gyro: its noise cannot be told from these rates; give arw_deg_per_sqrt_s")
    notes.append(f"angle random walk {np.rad2deg(arw):.4g} deg/sqrt(s), from {how}")
    return arw, degrees


def estimate_reference_sigma(
    gyro: GyroStream, body: BodyAttitudes, interval_rows: list[Indices], notes: list[str]
) -> tuple[Array, float]:
    """Estimate the 1-sigma (3,) of the references about the body's axes, rad, and its degrees of freedom."""
    fit = _find_reference_sigma(gyro, body.t_s, body.q, interval_rows, np.eye(3))
    if fit is None:
        raise InputError(
            f"{len(_list_pairs(gyro, body.t_s, interval_rows))} turns between references are too few to take their sigma from; "
            "give --sigma DEG, or sigma_deg in a mapping"
        )
    if not fit.sigma.any():
        raise InputError(
            "the references scatter less than the gyro between two of them, as smoothed ones do: give the 1-sigma that they "
            "are stated to have, --sigma DEG, or sigma_deg in a mapping"
        )
    text = f"sigma of the references {format_degrees(fit.sigma)} deg, from the turns between them"
    notes.append(f"{text}{_describe_bounds(fit)}; errors that they share are not in it")
    return fit.sigma, fit.degrees


def estimate_sensor_sigma(
    gyro: GyroStream, sensor: SensorReferences, M: Array, interval_rows: list[Indices], notes: list[str]
) -> tuple[Array, float]:
    """Estimate the 1-sigma (3,) of one of several sensors about its own axes, rad, and its degrees of freedom.

    It is the smaller of the sigma from the turns between attitudes and the sigma from second differences. Motion that a gyro
    follows adds to the latter, motion that it does not follow to both.

    sensor: has the sigma of its second differences, an upper bound; M: (3, 3) body to sensor; interval_rows: rows of the sensor
    """
    q = attitude.quaternion_from_matrix(M.T @ attitude.matrix_from_quaternion(sensor.quaternions))
    fit = _find_reference_sigma(gyro, sensor.t_s, q, interval_rows, M)
    sigma, degrees, how = sensor.sigma[0], 0.0, "second differences"
    if fit is not None and 0 < fit.sigma @ fit.sigma < sigma @ sigma:
        sigma, degrees, how = fit.sigma, fit.degrees, f"the turns between its attitudes{_describe_bounds(fit)}"
    notes.append(
        f"1-sigma about the axes of {sensor.name}: {format_degrees(sigma)} deg, from {how}; errors that last are not in it"
    )
    return sigma, degrees


def _describe_bounds(fit: ReferenceSigma) -> str:
    """Describe the axes that the gyro's noise hides; empty without any."""
    axes = ", ".join(axis for axis, hidden in zip("xyz", fit.hidden, strict=True) if hidden)
    return f" (about {axes} an upper bound of 95 %, since the gyro's noise hides it)" if axes else ""


def _find_reference_sigma(gyro: GyroStream, t_s: Array, q: Array, thinned: list[Indices], M: Array) -> ReferenceSigma | None:
    """Estimate the sigma of body attitudes (m, 4) about the body's axes rotated by M; None if there are too few.

    It is zero if the attitudes scatter less than the gyro. All attitudes of the intervals are used. If the thinned ones (rows
    by interval) scatter significantly more, neighbouring attitudes share errors, and the thinned ones are used.
    """
    thinned_pairs = _list_pairs(gyro, t_s, thinned)
    if len(thinned_pairs) < FEWEST_PAIRS:
        return None
    fit = fit_reference_sigma(compute_turns(gyro, t_s, q, thinned_pairs).rotate(M), gyro.arw, gyro.arw_degrees)
    all_pairs = _list_pairs(gyro, t_s, [_select_all_rows(t_s, rows, gyro.sample_s) for rows in thinned])
    if all_pairs == thinned_pairs or not fit.sigma.any():
        return fit
    dense_fit = fit_reference_sigma(compute_turns(gyro, t_s, q, all_pairs).rotate(M), gyro.arw, gyro.arw_degrees)
    return fit if not dense_fit.sigma.any() or fit.exceeds(dense_fit) else dense_fit


def _select_all_rows(t_s: Array, rows: Indices, sample_s: float) -> Indices:
    """Select all rows from the first to the last, at least about a gyro's sample apart: nearer ones share its noise."""
    if rows.size < 2:
        return rows
    all_rows = np.arange(rows[0], rows[-1] + 1, dtype=np.intp)
    return all_rows[:: max(int(np.ceil((1 - TAG_ROUNDING) * sample_s / np.median(np.diff(t_s[all_rows])))), 1)]


def _list_pairs(gyro: GyroStream, t_ref: Array, interval_rows: list[Indices]) -> list[tuple[int, int]]:
    """List neighbouring references of the intervals without a gap of the gyro between them, at most about `MOST_TURNS`."""
    longest = GAP_SAMPLES * gyro.sample_s
    sample = np.clip(np.searchsorted(gyro.t_s, t_ref + TAG_ROUNDING * gyro.sample_s, side="right") - 1, 0, None)
    # Number of the stretch without a gap; a reference in a gap has the half after it.
    stretch = np.append(0.0, np.cumsum(np.diff(gyro.t_s) > longest))[sample] + 0.5 * (t_ref - gyro.t_s[sample] > longest)
    pairs = [(a, b) for rows in interval_rows for a, b in pairwise(rows.tolist()) if stretch[a] == stretch[b]]
    # Of many pairs, blocks of consecutive ones at even distances.
    blocks = [pairs[k : k + BLOCK] for k in range(0, len(pairs), BLOCK)]
    step = -(-len(pairs) // MOST_TURNS)
    return [pair for block in blocks[:: max(step, 1)] for pair in block]


def compute_turns(gyro: GyroStream, t_s: Array, q: Array, pairs: list[tuple[int, int]]) -> Turns:
    """Compute the turns between pairs of body attitudes (m, 4), with their derivatives by G, the bias and the gyro's time."""
    miss, prepared, run = propagate_pairs(gyro, t_s, q, pairs)
    ends = np.array(pairs)
    follows = np.append(False, ends[1:, 0] == ends[:-1, 1])
    shift = _compute_rate_changes(gyro, t_s[ends], run.R, prepared.elapsed_s, follows)
    columns = np.concatenate([run.Theta, shift[:, :, None]], axis=2)
    # Parts in the turn of the samples that contain the first and the last reference; the other samples are in it as a whole.
    T = gyro.sample_s
    since = t_s[ends] - gyro.t_s[np.searchsorted(gyro.t_s, t_s[ends] + TAG_ROUNDING * T, side="right") - 1]
    before, after = np.clip(T - since[:, 0], 0.0, T), np.clip(since[:, 1], 0.0, T)
    noise_s = prepared.elapsed_s - before - after + (before**2 + after**2) / T
    shared_s = np.append(0.0, after[:-1] * before[1:] / T)
    return Turns(miss, columns, run.R, noise_s, shared_s, follows)


def propagate_pairs(
    gyro: GyroStream, t_s: Array, q: Array, pairs: list[tuple[int, int]]
) -> tuple[Array, Measurements, Propagation]:
    """Propagate from the first attitude of each pair to the second; return the misses (n, 3), rad, arcs and propagation."""
    used = np.unique(np.array(pairs))
    A = attitude.matrix_from_quaternion(q[used])
    prepared = prepare_measurements(
        Recording(
            title="increments",
            epoch="",
            gyro=gyro,
            attitudes=Attitudes(t_s[used], q[used], np.full((used.size, 3), np.deg2rad(1.0))),
            intervals=tuple(Interval(str(k), "", float(t_s[a]), float(t_s[b])) for k, (a, b) in enumerate(pairs)),
        )
    )
    run = propagate(prepared.arcs, gyro.apriori_G, gyro.apriori_bias)
    return attitude.residual(A[prepared.row], run.R @ A[prepared.start]), prepared, run


def _compute_rate_changes(gyro: GyroStream, ends_s: Array, R: Array, elapsed_s: Array, follows: NDArray[np.bool_]) -> Array:
    """Compute the change of the body's rate over each turn (n, 3) about the axes at its end, rad/s.

    It is taken from the samples at both ends if it is far above their noise. Otherwise it would contain the turn's own noise,
    and half the change from the turn before to the one after is taken.
    """
    sample = np.searchsorted(gyro.t_s, ends_s - 0.5 * gyro.sample_s)
    rate = (gyro.rates + gyro.apriori_bias)[np.minimum(sample, len(gyro.rates) - 1)]
    change = rate[:, 1] - np.einsum("mij,mj->mi", R, rate[:, 0])
    if np.mean(np.square(change)) > LEAST_CHANGE_TO_NOISE * gyro.arw**2 / gyro.sample_s:
        return np.asarray(change)
    mean = -Rotation.from_matrix(R).as_rotvec() / elapsed_s[:, None]
    change = np.zeros_like(mean)
    between = np.flatnonzero(follows[1:-1] & follows[2:]) + 1
    change[between] = 0.5 * (mean[between + 1] - np.einsum("mij,mj->mi", R[between], mean[between - 1]))
    return change


def compute_largest_miss(gyro: GyroStream, body: BodyAttitudes, interval_rows: list[Indices]) -> float:
    """Compute the largest angle between an attitude and the one before, propagated with the gyro, rad; infinite of few."""
    pairs = _list_pairs(gyro, body.t_s, interval_rows)
    if len(pairs) < FEWEST_ARRIVALS:
        return np.inf
    theta, *_ = propagate_pairs(gyro, body.t_s, body.q, pairs)
    return float(np.linalg.norm(theta, axis=1).max())


def estimate_walk_at_rest(stretches: list[Array], sample_s: float) -> Array | None:
    """Estimate the angle random walk (k,) rad/sqrt(s) by the overlapping Allan deviation near `ALLAN_S`, times its root.

    stretches: rates (n, k) each, rad/s, constant but for noise and slow drift; None if none is long enough
    """
    m = max(round(ALLAN_S / sample_s), 1)
    long = [rates for rates in stretches if len(rates) >= 3 * m]
    if max(map(len, long), default=0) < FEWEST_STRETCH_SAMPLES:
        return None
    axes = zip(*(rates.T for rates in long), strict=True)
    variance = [overlapping_allan_deviation(parts, sample_s, [m]).variance[0] for parts in axes]
    return np.asarray(np.sqrt(np.array(variance) * m * sample_s))


def count_walk_degrees(stretches: list[Array], sample_s: float) -> float:
    """Count the degrees of freedom of `estimate_walk_at_rest` for all axes of stretches at rest together.

    They are 1.5 T/τ · 4m²/(4m² + 5) for each axis of an overlapping Allan deviation over m samples in stretches of the length T
    (Riley, Handbook of Frequency Stability Analysis, NIST SP 1065, 2008, table 5).
    """
    m = max(round(ALLAN_S / sample_s), 1)
    return float(sum(rates.size for rates in stretches if len(rates) >= 3 * m) * 1.5 / m * 4 * m**2 / (4 * m**2 + 5))


def estimate_walk_in_motion(rates: Array, sample_s: float) -> Array:
    """Estimate an upper bound (k,) rad/sqrt(s) of the angle random walk from third differences, which nearly remove motion.

    The variance of x₀ − 3x₁ + 3x₂ − x₃ of white noise is 20 times its own.
    """
    third = np.diff(rates, n=3, axis=0)
    return np.asarray(MAD_TO_SIGMA * np.median(np.abs(third), axis=0) / np.sqrt(20.0) * np.sqrt(sample_s))
