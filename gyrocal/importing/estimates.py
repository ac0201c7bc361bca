"""What an import estimates where nothing is stated: the bias to start from, angle random walk, sigma of the references."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gyrocal import attitude
from gyrocal.calibration.estimated_noise import ALLAN_S, MOST_REFERENCE_PAIRS
from gyrocal.calibration.propagation import Propagation, propagate
from gyrocal.calibration.sampling import TAG_ROUNDING, Measurements, prepare_measurements
from gyrocal.errors import InputError
from gyrocal.importing.column_mapping import Mapping
from gyrocal.importing.gyro_samples import GAP_SAMPLES
from gyrocal.importing.motion import Motion
from gyrocal.importing.streams import BodyAttitudes, Streams
from gyrocal.importing.units import format_degrees
from gyrocal.recording import Attitudes, GyroStream, Interval, Recording
from gyrocal.recording.reference_join import SensorReferences

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

FEWEST_PAIRS = 12
FEWEST_ARRIVALS = 3
BIAS_STEPS = 5
LARGEST_MISS_DEG = 10.0  # median, of attitudes far apart that tell a bias
LEAST_SIGMA = np.deg2rad(2e-9)
MAD_TO_SIGMA = 1.4826
CLIP = 4.0  # increments beyond so many robust sigmas are left out of the preliminary fit


def estimate_bias(
    mapping: Mapping,
    rates: Array,
    still: list[tuple[int, int]],
    windows: Motion,
    joined: BodyAttitudes,
    streams: Streams,
    said: list[str],
) -> Array:
    """b of ω = ω_raw + b to start from."""
    if mapping.bias_deg_s is not None:
        return np.deg2rad(mapping.bias_deg_s)
    if still:
        first, stop = still[0]
        bias = -rates[first:stop].mean(axis=0)
        said.append(f"bias to start from, b = {format_degrees(bias)} deg/s, is minus the mean of the first rest")
        return np.asarray(bias)
    if windows.is_coarse:
        bias, left = _estimate_bias_of_turns(rates, joined, streams)
        if left > np.deg2rad(LARGEST_MISS_DEG):
            said.append(
                "bias to start from is zero: the attitudes are too far apart to tell it; give bias_deg_s if it is known"
            )
            return np.zeros(3)
        said.append(f"bias to start from, b = {format_degrees(bias)} deg/s, is from the turns between attitudes far apart")
        return bias
    gyro, inside = windows.gyro()
    difference = windows.attitudes()[inside] - gyro[inside]
    bias = difference.mean(axis=0)
    # Without a rest the mean difference holds errors of G too: it is used only where it is larger than they may be.
    if np.linalg.norm(bias) < 0.02 * np.linalg.norm(gyro[inside], axis=1).mean():
        said.append("bias to start from is zero")
        return np.zeros(3)
    said.append(f"bias to start from, b = {format_degrees(bias)} deg/s, is the mean difference of attitudes' and gyro's rates")
    return np.asarray(bias)


def _estimate_bias_of_turns(rates: Array, joined: BodyAttitudes, streams: Streams) -> tuple[Array, float]:
    """b from the turns between successive attitudes, by Gauss-Newton from zero, and the median miss that it leaves, rad."""
    inside = np.flatnonzero((joined.t_s >= streams.t_s[0]) & (joined.t_s <= streams.t_s[-1] + streams.sample_s))
    pairs = _list_pairs(GyroStream(streams.t_s, rates, streams.sample_s, 0.0, np.eye(3), np.zeros(3)), joined.t_s, [inside])
    bias, left = np.zeros(3), np.inf
    try:
        for _ in range(BIAS_STEPS):
            gyro = GyroStream(streams.t_s, rates, streams.sample_s, 0.0, np.eye(3), bias)
            theta, _, run = compute_misses(_build_pieces(gyro, joined.t_s, joined.q, pairs))
            left = float(np.median(np.linalg.norm(theta, axis=1)))
            bias = bias - np.linalg.lstsq(run.Theta[:, :, 9:].reshape(-1, 3), theta.ravel(), rcond=None)[0]
    except InputError:
        return np.zeros(3), np.inf
    return bias, left


def estimate_walk(mapping: Mapping, streams: Streams, rates: Array, still: list[tuple[int, int]], said: list[str]) -> float:
    """Angle random walk of the rates, rad/sqrt(s)."""
    stated, joined = mapping.arw_deg_per_sqrt_s, streams.gyros
    if stated is not None:
        each = float(np.sqrt(np.mean(np.square(stated)))) if joined is None or not isinstance(stated, list) else 1.0
        return float(np.deg2rad(each)) * (1.0 if joined is None else joined.gain)
    if joined is not None:
        parity = (joined.residuals / joined.spread)[:, np.isfinite(joined.residuals).any(axis=0)]
        walk = estimate_walk_at_rest([parity[np.isfinite(parity).all(axis=1)]], streams.sample_s)
        if walk is None:
            raise InputError("gyro: too few samples to tell its noise; give arw_deg_per_sqrt_s")
        arw, how = joined.gain * float(np.sqrt(np.mean(np.square(walk)))), "the parity of the gyros"
    else:
        walk = estimate_walk_at_rest([rates[a:b] for a, b in still], streams.sample_s)
        how = f"the Allan deviation of the rests at {ALLAN_S:g} s"
        if walk is None:
            walk, how = estimate_walk_in_motion(rates, streams.sample_s), "third differences in motion, an upper bound"
        arw = float(np.sqrt(np.mean(np.square(walk))))
    if not arw > 0:
        raise InputError("gyro: its noise cannot be told from these rates; give arw_deg_per_sqrt_s")
    said.append(f"angle random walk {np.rad2deg(arw):.4g} deg/sqrt(s), from {how}")
    return arw


def estimate_reference_sigma(gyro: GyroStream, joined: BodyAttitudes, chosen: list[Indices], said: list[str]) -> Array:
    """(3,) 1-sigma of the references about the body's axes, rad."""
    pairs = _list_pairs(gyro, joined.t_s, chosen)
    if len(pairs) < FEWEST_PAIRS:
        raise InputError(
            f"{len(pairs)} turns between references are too few to take their sigma from; "
            "give --sigma DEG, or sigma_deg in a mapping"
        )
    sigma = _estimate_sigma_of_turns(gyro, joined.t_s, joined.q, pairs, np.eye(3))
    if not (sigma > LEAST_SIGMA).all():
        raise InputError(
            "the references scatter less than the gyro between two of them, as smoothed ones do: give the 1-sigma that they "
            "are stated to have, --sigma DEG, or sigma_deg in a mapping"
        )
    degrees = format_degrees(sigma)
    said.append(f"sigma of the references {degrees} deg, from the turns between them; errors that they share are not in it")
    return sigma


def estimate_sensor_sigma(
    gyro: GyroStream, sensor: SensorReferences, M: Array, chosen: list[Indices], said: list[str]
) -> Array:
    """(3,) 1-sigma of one of several sensors about its own axes, rad.

    What the gyro misses from one attitude to the next, or second differences, whichever is less: motion that a gyro follows
    adds to the latter, and what a gyro does not follow to both.

    Parameters
    ----------
    sensor : its attitudes, with the sigma of its second differences
    M : (3, 3) body to sensor
    chosen : its rows in each interval
    """
    pairs = _list_pairs(gyro, sensor.t_s, chosen)
    sigma, how = sensor.sigma[0], "second differences"
    if len(pairs) >= FEWEST_PAIRS:
        q = attitude.quaternion_from_matrix(M.T @ attitude.matrix_from_quaternion(sensor.quaternions))
        own = _estimate_sigma_of_turns(gyro, sensor.t_s, q, pairs, M)
        if (own > LEAST_SIGMA).all() and own @ own < sigma @ sigma:
            sigma, how = own, "the turns between its attitudes"
    said.append(
        f"1-sigma about the axes of {sensor.name}: {format_degrees(sigma)} deg, from {how}; errors that last are not in it"
    )
    return sigma


def _list_pairs(gyro: GyroStream, t_ref: Array, chosen: list[Indices]) -> list[tuple[int, int]]:
    """Neighbouring references of the intervals without a gap of the gyro between them."""
    longest = GAP_SAMPLES * gyro.sample_s
    at = np.clip(np.searchsorted(gyro.t_s, t_ref + TAG_ROUNDING * gyro.sample_s, side="right") - 1, 0, None)
    stretch = np.concatenate([[0.0], np.cumsum(np.diff(gyro.t_s) > longest)])[at] + 0.5 * (t_ref - gyro.t_s[at] > longest)
    pairs = [(a, b) for rows in chosen for a, b in pairwise(rows.tolist()) if stretch[a] == stretch[b]]
    return pairs[:: max(-(-len(pairs) // MOST_REFERENCE_PAIRS), 1)]


def _estimate_sigma_of_turns(gyro: GyroStream, t_s: Array, q: Array, pairs: list[tuple[int, int]], M: Array) -> Array:
    """(3,) sigma about axes that M takes those of the body to, from the turns between two attitudes (m, 4) of the body."""
    left, R = compute_increment_residuals(_build_pieces(gyro, t_s, q, pairs))
    elapsed = float(np.median([t_s[b] - t_s[a] for a, b in pairs]))
    return estimate_axis_sigma(left @ M.T, M @ R @ M.T, gyro.arw**2 * elapsed)


def compute_largest_miss(gyro: GyroStream, joined: BodyAttitudes, chosen: list[Indices]) -> float:
    """Largest angle by which the gyro, from one attitude used, misses the next, rad; infinite of fewer than three."""
    pairs = _list_pairs(gyro, joined.t_s, chosen)
    if len(pairs) < FEWEST_ARRIVALS:
        return np.inf
    theta, *_ = compute_misses(_build_pieces(gyro, joined.t_s, joined.q, pairs))
    return float(np.linalg.norm(theta, axis=1).max())


def _build_pieces(gyro: GyroStream, t_s: Array, q: Array, pairs: list[tuple[int, int]]) -> Recording:
    """A recording whose intervals are from one attitude to another."""
    used = np.unique(np.array(pairs))
    return Recording(
        title="increments",
        epoch="",
        gyro=gyro,
        attitudes=Attitudes(t_s[used], q[used], np.full((used.size, 3), np.deg2rad(1.0))),
        intervals=tuple(Interval(str(k), "", float(t_s[a]), float(t_s[b])) for k, (a, b) in enumerate(pairs)),
    )


def estimate_walk_at_rest(stretches: list[Array], sample_s: float) -> Array | None:
    """Angle random walk (k,) rad/sqrt(s) of white rate noise: overlapping Allan deviation near `ALLAN_S`, times its root.

    Returns None if no stretch is long enough.

    stretches: rates (n, k) each, rad/s, constant but for noise and slow drift.
    """
    m = max(round(ALLAN_S / sample_s), 1)
    squares = []
    for rates in stretches:
        if len(rates) >= 3 * m:
            sums = np.cumsum(np.concatenate([np.zeros((1, rates.shape[1])), rates]), axis=0)
            means = (sums[m:] - sums[:-m]) / m
            squares.append(np.square(means[m:] - means[:-m]))
    if not squares:
        return None
    return np.asarray(np.sqrt(0.5 * np.concatenate(squares).mean(axis=0) * m * sample_s))


def estimate_walk_in_motion(rates: Array, sample_s: float) -> Array:
    """Upper bound (k,) rad/sqrt(s) of the angle random walk in motion, which third differences of the rates all but remove.

    The variance of x₀ − 3x₁ + 3x₂ − x₃ of white noise is 20 times its own.
    """
    third = np.diff(rates, n=3, axis=0)
    return np.asarray(MAD_TO_SIGMA * np.median(np.abs(third), axis=0) / np.sqrt(20.0) * np.sqrt(sample_s))


def compute_misses(recording: Recording) -> tuple[Array, Measurements, Propagation]:
    """(m, 3) by how much the gyro, from each interval's first reference, misses those after it, rad; arcs and their pass."""
    prepared = prepare_measurements(recording)
    run = propagate(prepared.arcs, recording.gyro.apriori_G, recording.gyro.apriori_bias)
    A = attitude.matrix_from_quaternion(recording.attitudes.quaternions)
    return attitude.residual(A[prepared.row], run.R @ A[prepared.start]), prepared, run


def compute_increment_residuals(recording: Recording) -> tuple[Array, Array]:
    """Compute the residuals of a preliminary fit to the turns between successive references.

    G, bias and a time offset between gyro and references are fitted by least squares and forgotten: without them their effect
    would be taken for reference noise.

    Returns (m, 3) residuals in the body axes of the second reference, rad, scaled by the degrees of freedom of the fit, and (m,
    3, 3) rotations from the first to it.

    recording: intervals that hold two references each.
    """
    gyro = recording.gyro
    theta, prepared, run = compute_misses(recording)
    at = np.searchsorted(gyro.t_s, recording.attitudes.t_s - 0.5 * gyro.sample_s)
    rate = gyro.rates[np.minimum(at, len(gyro.rates) - 1)]
    shift = rate[prepared.row] - np.einsum("mij,mj->mi", run.R, rate[prepared.start])
    columns = np.concatenate([run.Theta, shift[:, :, None]], axis=2).reshape(3 * len(theta), -1)
    columns = columns / np.maximum(np.sqrt(np.mean(np.square(columns), axis=0)), np.finfo(float).tiny)
    keep = np.ones(len(theta), dtype=bool)
    left = theta
    for _ in range(3):
        rows = np.repeat(keep, 3)
        solution, _, rank, _ = np.linalg.lstsq(columns[rows], theta.ravel()[rows], rcond=1e-10)
        left = theta - (columns @ solution).reshape(-1, 3)
        size = np.linalg.norm(left, axis=1)
        keep = size <= CLIP * max(float(np.median(size)), np.finfo(float).tiny)
    return left * np.sqrt(rows.sum() / (rows.sum() - rank)), run.R


def estimate_axis_sigma(left: Array, R: Array, gyro_variance: float) -> Array:
    """Reference 1-sigma per body axis (3,) rad from residuals e₁ − R e₀ + gyro noise of increments.

    Their variance is σ_a² + Σ_b R_ab² σ_b² + that of the gyro, gyro_variance in rad². It is taken about the median: a bias at
    rest other than that in motion is no scatter.
    """
    left = left - np.median(left, axis=0)
    variance = np.square(MAD_TO_SIGMA * np.median(np.abs(left), axis=0)) - gyro_variance
    mixing = np.eye(3) + np.mean(np.square(R), axis=0)
    # Negative where noise alone made the difference: then axes are not told apart.
    squares = np.linalg.solve(mixing, variance)
    if (squares <= 0).any():
        squares = np.full(3, max(float(variance.mean()) / 2, 0.0))
    return np.asarray(np.sqrt(squares))
