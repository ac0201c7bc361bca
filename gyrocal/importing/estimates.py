"""What an import estimates where nothing is stated: the bias to start from, angle random walk, sigma of the references."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.importing import noise
from gyrocal.importing.mapping import Mapping
from gyrocal.importing.motion import Motion
from gyrocal.importing.sensors import Together
from gyrocal.importing.streams import Streams
from gyrocal.recording import Attitudes, GyroStream, Interval, Recording

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

FEWEST_PAIRS = 12
MOST_PAIRS = 600
LEAST_SIGMA = np.deg2rad(2e-9)


def degrees(values: Array) -> str:
    """Angles in degrees, four digits each."""
    return ", ".join(f"{value:.4g}" for value in np.rad2deg(values))


def start_bias(mapping: Mapping, rates: Array, still: list[tuple[int, int]], windows: Motion, said: list[str]) -> Array:
    """b of ω = ω_raw + b to start from."""
    if mapping.bias_deg_s is not None:
        return np.deg2rad(mapping.bias_deg_s)
    if still:
        first, stop = still[0]
        bias = -rates[first:stop].mean(axis=0)
        said.append(f"bias to start from, b = {degrees(bias)} deg/s, is minus the mean of the first rest")
        return np.asarray(bias)
    gyro, inside = windows.gyro()
    difference = windows.attitudes()[inside] - gyro[inside]
    bias = difference.mean(axis=0)
    # Without a rest the mean difference holds errors of G too: it is used only where it is larger than they may be.
    if np.linalg.norm(bias) < 0.02 * np.linalg.norm(gyro[inside], axis=1).mean():
        said.append("bias to start from is zero")
        return np.zeros(3)
    said.append(f"bias to start from, b = {degrees(bias)} deg/s, is the mean difference of attitudes' and gyro's rates")
    return np.asarray(bias)


def walk(
    mapping: Mapping, streams: Streams, rates: Array, still: list[tuple[int, int]], parity: Array, said: list[str]
) -> float:
    """Angle random walk of the body rates, rad/sqrt(s)."""
    if mapping.arw_deg_per_sqrt_s is not None:
        return float(np.deg2rad(mapping.arw_deg_per_sqrt_s))
    if parity.shape[1]:
        # Parity rows are orthonormal: each has the noise of one gyro; the least-squares rate has that of G.
        walk = noise.allan_walk([parity], streams.sample_s)
        assert walk is not None
        gain = np.sqrt(np.mean(np.sum(np.square(mapping.directions(streams.raw.shape[1])), axis=1)))
        arw, how = float(np.sqrt(np.mean(np.square(walk))) * gain), "the parity of the gyros"
    else:
        walk = noise.allan_walk([rates[a:b] for a, b in still], streams.sample_s)
        how = f"the Allan deviation of the rests at {noise.ALLAN_S:g} s"
        if walk is None:
            walk, how = noise.third_differences(rates, streams.sample_s), "third differences in motion, an upper bound"
        arw = float(np.sqrt(np.mean(np.square(walk))))
    if not arw > 0:
        raise InputError("gyro: its noise cannot be told from these rates; give arw_deg_per_sqrt_s")
    said.append(f"angle random walk {np.rad2deg(arw):.4g} deg/sqrt(s), from {how}")
    return arw


def reference_sigma(gyro: GyroStream, joined: Together, chosen: list[Indices], said: list[str]) -> Array:
    """(3,) 1-sigma of the references about the body's axes, rad."""
    if joined.covariance is not None:
        return np.asarray(np.sqrt(np.diag(joined.covariance)))
    pairs = [pair for rows in chosen for pair in pairwise(rows.tolist())]
    pairs = pairs[:: -(-len(pairs) // MOST_PAIRS)]
    if len(pairs) < FEWEST_PAIRS:
        raise InputError(f"{len(pairs)} turns between references are too few to take their sigma from; give sigma_deg")
    left, R = _increments(gyro, joined, pairs)
    elapsed = float(np.median([joined.t_s[b] - joined.t_s[a] for a, b in pairs]))
    sigma = noise.axis_sigma(left, R, gyro.arw**2 * elapsed)
    if not (sigma > LEAST_SIGMA).all():
        raise InputError("the references scatter less than the gyro between two of them: give sigma_deg, or a shorter spacing")
    said.append(
        f"sigma of the references {degrees(sigma)} deg, from the turns between them; errors that they share are not in it"
    )
    return sigma


def _increments(gyro: GyroStream, joined: Together, pairs: list[tuple[int, int]]) -> tuple[Array, Array]:
    used = np.unique(np.array(pairs))
    t_s = joined.t_s
    return noise.increment_residuals(
        Recording(
            title="increments",
            epoch="",
            gyro=gyro,
            attitudes=Attitudes(t_s[used], joined.q[used], np.full((used.size, 3), np.deg2rad(1.0))),
            intervals=tuple(Interval(str(k), "", float(t_s[a]), float(t_s[b])) for k, (a, b) in enumerate(pairs)),
        )
    )
