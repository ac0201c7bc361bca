"""What a recording's own numbers say of its noise: angle random walk, and sigma of the attitudes.

Neither needs more than rates and attitudes that agree roughly. Each is an estimate that its reader may replace.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal import attitude
from gyrocal.calibration.estimated_noise import ALLAN_S
from gyrocal.calibration.propagation import Propagation, propagate
from gyrocal.calibration.sampling import Measurements, prepare_measurements
from gyrocal.recording import Recording

Array = NDArray[np.float64]

MAD_TO_SIGMA = 1.4826
CLIP = 4.0  # increments beyond so many robust sigmas are left out of the preliminary fit


def estimate_walk_at_rest(stretches: list[Array], sample_s: float) -> Array | None:
    """Angle random walk (k,) rad/sqrt(s) of white rate noise: overlapping Allan deviation near `ALLAN_S`, times its root.

    Parameters
    ----------
    stretches : rates (n, k) each, rad/s, constant but for noise and slow drift

    Returns
    -------
    None if no stretch is long enough.
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

    Parameters
    ----------
    recording : intervals that hold two references each

    Returns
    -------
    (m, 3) residuals in the body axes of the second reference, rad, scaled by the degrees of freedom of the fit, and (m, 3, 3)
    rotations from the first to it
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
