"""What an import estimates where nothing is stated: the bias to start from, angle random walk, sigma of the references."""

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
LARGEST_MISS_DEG = 10.0  # median, of attitudes far apart that tell a bias
ALLAN_S = 0.1  # averaging time at which the angle random walk is read, s
MOST_TURNS = 2000  # that the sigma of references is taken from, in blocks of turns in a row
BLOCK = 50
LEAST_CHANGE_TO_NOISE = 100.0  # mean squares of a change of the rate and of the noise of one sample


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
        bias, how = -rates[first:stop].mean(axis=0), "minus the mean of the first rest"
    elif windows.is_coarse:
        bias, left = _estimate_bias_of_turns(rates, joined, streams)
        how = "from the turns between attitudes far apart"
        if left > np.deg2rad(LARGEST_MISS_DEG):
            said.append(
                "bias to start from is zero: the attitudes are too far apart to tell it; give bias_deg_s if it is known"
            )
            return np.zeros(3)
    else:
        gyro, inside = windows.gyro()
        bias = (windows.attitudes()[inside] - gyro[inside]).mean(axis=0)
        how = "the mean difference of attitudes' and gyro's rates"
        # Without a rest the mean difference holds errors of G too: it is used only where it is larger than they may be.
        if np.linalg.norm(bias) < 0.02 * np.linalg.norm(gyro[inside], axis=1).mean():
            said.append("bias to start from is zero")
            return np.zeros(3)
    said.append(f"bias to start from, b = {format_degrees(bias)} deg/s, is {how}")
    return np.asarray(bias)


def _estimate_bias_of_turns(rates: Array, joined: BodyAttitudes, streams: Streams) -> tuple[Array, float]:
    """b from the turns between successive attitudes, by Gauss-Newton from zero, and the median miss that it leaves, rad."""
    inside = np.flatnonzero((joined.t_s >= streams.t_s[0]) & (joined.t_s <= streams.t_s[-1] + streams.sample_s))
    gyro = GyroStream(streams.t_s, rates, streams.sample_s, 0.0, np.eye(3), np.zeros(3))
    pairs = _list_pairs(gyro, joined.t_s, [inside])
    bias, left = np.zeros(3), np.inf
    try:
        for _ in range(BIAS_STEPS):
            gyro = replace(gyro, apriori_bias=bias)
            theta, _, run = propagate_pairs(gyro, joined.t_s, joined.q, pairs)
            left = float(np.median(np.linalg.norm(theta, axis=1)))
            bias = bias - np.linalg.lstsq(run.Theta[:, :, 9:].reshape(-1, 3), theta.ravel(), rcond=None)[0]
    except InputError:
        return np.zeros(3), np.inf
    return bias, left


def estimate_walk(
    mapping: Mapping, streams: Streams, rates: Array, still: list[tuple[int, int]], said: list[str]
) -> tuple[float, float]:
    """Angle random walk of the rates, rad/sqrt(s), and its degrees of freedom: infinite if stated, 0 of an upper bound."""
    stated, joined = mapping.arw_deg_per_sqrt_s, streams.gyros
    gain = 1.0 if joined is None else joined.gain
    if stated is not None:
        each = float(np.sqrt(np.mean(np.square(stated)))) if joined is None or not isinstance(stated, list) else 1.0
        return float(np.deg2rad(each)) * gain, np.inf
    if joined is not None:
        parity = (joined.residuals / joined.spread)[:, np.isfinite(joined.residuals).any(axis=0)]
        stretches, how = [parity[np.isfinite(parity).all(axis=1)]], "the parity of the gyros"
    else:
        stretches, how = [rates[a:b] for a, b in still], f"the Allan deviation of the rests at {ALLAN_S:g} s"
    walk = estimate_walk_at_rest(stretches, streams.sample_s)
    degrees = 0.0 if walk is None else count_walk_degrees(stretches, streams.sample_s)
    if walk is None and joined is not None:
        raise InputError("gyro: too few samples to tell its noise; give arw_deg_per_sqrt_s")
    if walk is None:
        walk, how = estimate_walk_in_motion(rates, streams.sample_s), "third differences in motion, an upper bound"
    arw = float(np.sqrt(np.mean(np.square(walk)))) * gain
    if not arw > 0:
        raise InputError("gyro: its noise cannot be told from these rates; give arw_deg_per_sqrt_s")
    said.append(f"angle random walk {np.rad2deg(arw):.4g} deg/sqrt(s), from {how}")
    return arw, degrees


def estimate_reference_sigma(
    gyro: GyroStream, joined: BodyAttitudes, chosen: list[Indices], said: list[str]
) -> tuple[Array, float]:
    """(3,) 1-sigma of the references about the body's axes, rad, and its degrees of freedom (`fit_reference_sigma`)."""
    found = _find_reference_sigma(gyro, joined.t_s, joined.q, chosen, np.eye(3))
    if found is None:
        raise InputError(
            f"{len(_list_pairs(gyro, joined.t_s, chosen))} turns between references are too few to take their sigma from; "
            "give --sigma DEG, or sigma_deg in a mapping"
        )
    if not found.sigma.any():
        raise InputError(
            "the references scatter less than the gyro between two of them, as smoothed ones do: give the 1-sigma that they "
            "are stated to have, --sigma DEG, or sigma_deg in a mapping"
        )
    text = f"sigma of the references {format_degrees(found.sigma)} deg, from the turns between them"
    said.append(f"{text}{_describe_bounds(found)}; errors that they share are not in it")
    return found.sigma, found.degrees


def estimate_sensor_sigma(
    gyro: GyroStream, sensor: SensorReferences, M: Array, chosen: list[Indices], said: list[str]
) -> tuple[Array, float]:
    """(3,) 1-sigma of one of several sensors about its own axes, rad, and its degrees of freedom.

    What the gyro misses from one attitude to the next, or second differences, whichever is less: motion that a gyro follows
    adds to the latter, and what a gyro does not follow to both.

    sensor has the sigma of its second differences, an upper bound; M (3, 3) is body to sensor, chosen its rows by interval.
    """
    q = attitude.quaternion_from_matrix(M.T @ attitude.matrix_from_quaternion(sensor.quaternions))
    own = _find_reference_sigma(gyro, sensor.t_s, q, chosen, M)
    sigma, degrees, how = sensor.sigma[0], 0.0, "second differences"
    if own is not None and 0 < own.sigma @ own.sigma < sigma @ sigma:
        sigma, degrees, how = own.sigma, own.degrees, f"the turns between its attitudes{_describe_bounds(own)}"
    said.append(
        f"1-sigma about the axes of {sensor.name}: {format_degrees(sigma)} deg, from {how}; errors that last are not in it"
    )
    return sigma, degrees


def _describe_bounds(found: ReferenceSigma) -> str:
    """Which axes the gyro's noise hides, in words."""
    axes = ", ".join(axis for axis, hidden in zip("xyz", found.hidden, strict=True) if hidden)
    return f" (about {axes} an upper bound of 95 %, since the gyro's noise hides it)" if axes else ""


def _find_reference_sigma(gyro: GyroStream, t_s: Array, q: Array, chosen: list[Indices], M: Array) -> ReferenceSigma | None:
    """Sigma of attitudes (m, 4) of the body about axes that M takes those of the body to; None of too few.

    It is zero where the attitudes scatter less than the gyro. All attitudes within the intervals count, as they were given.
    Where the chosen ones scatter significantly more, neighbouring ones share their errors, and the chosen ones count.
    """
    used = _list_pairs(gyro, t_s, chosen)
    if len(used) < FEWEST_PAIRS:
        return None
    found = fit_reference_sigma(compute_turns(gyro, t_s, q, used).rotate(M), gyro.arw, gyro.arw_degrees)
    given = _list_pairs(gyro, t_s, [_select_given(t_s, rows, gyro.sample_s) for rows in chosen])
    if given == used or not found.sigma.any():
        return found
    dense = fit_reference_sigma(compute_turns(gyro, t_s, q, given).rotate(M), gyro.arw, gyro.arw_degrees)
    return found if not dense.sigma.any() or found.exceeds(dense) else dense


def _select_given(t_s: Array, rows: Indices, sample_s: float) -> Indices:
    """All rows from the first to the last, about a gyro's sample apart at least: nearer ones share its noise."""
    if rows.size < 2:
        return rows
    every = np.arange(rows[0], rows[-1] + 1, dtype=np.intp)
    return every[:: max(int(np.ceil((1 - TAG_ROUNDING) * sample_s / np.median(np.diff(t_s[every])))), 1)]


def _list_pairs(gyro: GyroStream, t_ref: Array, chosen: list[Indices]) -> list[tuple[int, int]]:
    """Neighbouring references of the intervals without a gap of the gyro between them."""
    longest = GAP_SAMPLES * gyro.sample_s
    at = np.clip(np.searchsorted(gyro.t_s, t_ref + TAG_ROUNDING * gyro.sample_s, side="right") - 1, 0, None)
    stretch = np.concatenate([[0.0], np.cumsum(np.diff(gyro.t_s) > longest)])[at] + 0.5 * (t_ref - gyro.t_s[at] > longest)
    pairs = [(a, b) for rows in chosen for a, b in pairwise(rows.tolist()) if stretch[a] == stretch[b]]
    blocks = [pairs[k : k + BLOCK] for k in range(0, len(pairs), BLOCK)]
    step = -(-len(pairs) // MOST_TURNS)
    return [pair for block in blocks[:: max(step, 1)] for pair in block]


def compute_turns(gyro: GyroStream, t_s: Array, q: Array, pairs: list[tuple[int, int]]) -> Turns:
    """Turns between two attitudes (m, 4) of the body each, with their derivatives by G, the bias and the time of the gyro."""
    miss, prepared, run = propagate_pairs(gyro, t_s, q, pairs)
    ends = np.array(pairs)
    follows = np.append(False, ends[1:, 0] == ends[:-1, 1])
    shift = _compute_rate_changes(gyro, t_s[ends], run.R, prepared.elapsed_s, follows)
    columns = np.concatenate([run.Theta, shift[:, :, None]], axis=2)
    # Of the samples that hold the first and the last reference, the parts that are in the turn; the others are in it whole.
    T = gyro.sample_s
    since = t_s[ends] - gyro.t_s[np.searchsorted(gyro.t_s, t_s[ends] + TAG_ROUNDING * T, side="right") - 1]
    before, after = np.clip(T - since[:, 0], 0.0, T), np.clip(since[:, 1], 0.0, T)
    noise_s = prepared.elapsed_s - before - after + (before**2 + after**2) / T
    shared_s = np.append(0.0, after[:-1] * before[1:] / T)
    return Turns(miss, columns, run.R, noise_s, shared_s, follows)


def propagate_pairs(
    gyro: GyroStream, t_s: Array, q: Array, pairs: list[tuple[int, int]]
) -> tuple[Array, Measurements, Propagation]:
    """Compute by how much the gyro, from one attitude of each pair, misses the other (n, 3), rad; arcs; propagation."""
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
    """(n, 3) change of the body's rate over each turn, about the axes at its end, rad/s.

    By the samples at both ends, if the change is far above their noise. Otherwise the column would take up the turn's own
    noise, and half the change from the turn before to the one after counts.
    """
    at = np.searchsorted(gyro.t_s, ends_s - 0.5 * gyro.sample_s)
    rate = (gyro.rates + gyro.apriori_bias)[np.minimum(at, len(gyro.rates) - 1)]
    change = rate[:, 1] - np.einsum("mij,mj->mi", R, rate[:, 0])
    if np.mean(np.square(change)) > LEAST_CHANGE_TO_NOISE * gyro.arw**2 / gyro.sample_s:
        return np.asarray(change)
    mean = -Rotation.from_matrix(R).as_rotvec() / elapsed_s[:, None]
    change = np.zeros_like(mean)
    between = np.flatnonzero(follows[1:-1] & follows[2:]) + 1
    change[between] = 0.5 * (mean[between + 1] - np.einsum("mij,mj->mi", R[between], mean[between - 1]))
    return change


def compute_largest_miss(gyro: GyroStream, joined: BodyAttitudes, chosen: list[Indices]) -> float:
    """Largest angle by which the gyro, from one attitude used, misses the next, rad; infinite of fewer than three."""
    pairs = _list_pairs(gyro, joined.t_s, chosen)
    if len(pairs) < FEWEST_ARRIVALS:
        return np.inf
    theta, *_ = propagate_pairs(gyro, joined.t_s, joined.q, pairs)
    return float(np.linalg.norm(theta, axis=1).max())


def estimate_walk_at_rest(stretches: list[Array], sample_s: float) -> Array | None:
    """Angle random walk (k,) rad/sqrt(s) of white rate noise: overlapping Allan deviation near `ALLAN_S`, times its root.

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
    """Degrees of freedom of the walk of all axes together that `estimate_walk_at_rest` gives of stretches at rest.

    1.5 T/τ · 4m²/(4m² + 5) for each axis of an overlapping Allan deviation over m samples in stretches of the length T (Riley,
    Handbook of Frequency Stability Analysis, NIST SP 1065, 2008, table 5).
    """
    m = max(round(ALLAN_S / sample_s), 1)
    return float(sum(rates.size for rates in stretches if len(rates) >= 3 * m) * 1.5 / m * 4 * m**2 / (4 * m**2 + 5))


def estimate_walk_in_motion(rates: Array, sample_s: float) -> Array:
    """Upper bound (k,) rad/sqrt(s) of the angle random walk in motion, which third differences of the rates all but remove.

    The variance of x₀ − 3x₁ + 3x₂ − x₃ of white noise is 20 times its own.
    """
    third = np.diff(rates, n=3, axis=0)
    return np.asarray(MAD_TO_SIGMA * np.median(np.abs(third), axis=0) / np.sqrt(20.0) * np.sqrt(sample_s))
