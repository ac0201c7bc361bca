"""Innovations: how far each reference attitude is off the one that the gyro propagates from the reference before.

From reference k − 1 to k of an interval the gyro turns the body by Φ_k, and the innovation is the rotation vector

    ν_k = log[A_k (Φ_k A_{k−1})ᵀ],        small:  ν_k = e_k − Φ_k e_{k−1} + gyro errors,

of reference errors e, in body axes at k. Constant errors of the gyro's matrix and bias are fitted to all innovations by robust
least squares and taken out (Huber's weights), so that a recording needs no calibration before. A reference error that lasts
makes one large innovation where it begins and another one where it ends; a single false reference makes two in a row.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array, Indices
from gyrocal.jit_cache import compile_cached

PASSES = 2  # of the integration: the second one with the rates of the first one's fit
ROBUST_FIT_ROUNDS = 8  # of the robust fit
HUBER = 1.5  # sigmas beyond which an innovation counts less
NORMAL = 0.6745  # median of the absolute value of a standard normal variable
EARLIEST_S = 1e-6  # two references closer than that are one


@dataclass(frozen=True)
class Innovations:
    """Innovations of the references of a recording."""

    first: Indices  # (k,) rows of the two references of each step
    second: Indices
    duration_s: Array  # (k,) time between them
    turned: Array  # (k, 3) rotation vector of the body by the gyro, after the fit, rad
    values: Array  # (k, 3) innovations after the fit, rad
    sigma: Array  # (k, 3) their scatter: that of the stated noise, times one factor for all where they scatter more, rad


def compute_innovations(
    begin_s: Array, rates: Array, t_s: Array, quaternions: Array, interval: Indices, sigma: Array, arw: float
) -> Innovations:
    """Compute the innovations of all references that follow one another in an interval.

    Parameters
    ----------
    begin_s, rates : (n,) starts of the samples, s, and (n, 3) body rates at an a-priori calibration, rad/s
    t_s, quaternions : (m,) s, and (m, 4) inertial to body, scalar last
    interval : (m,) number of the interval of each reference; one below zero is in none
    sigma, arw : (m, 3) 1-sigma of the references, rad, and angle random walk, rad/√s
    """
    order = np.lexsort((t_s, interval))
    first, second = order[:-1], order[1:]
    duration = t_s[second] - t_s[first]
    used = (interval[first] == interval[second]) & (interval[first] >= 0) & (duration > EARLIEST_S)
    first, second, duration = first[used], second[used], duration[used]
    variance = 2 * np.mean(sigma**2, axis=0) + arw**2 * duration[:, None]
    stated, scale = np.sqrt(np.maximum(variance, 1e-30)), 1.0
    turns, values = np.zeros((first.size, 3)), np.zeros((first.size, 3))
    for _ in range(PASSES):
        turns, columns = integrate_turns(begin_s, rates, t_s[first], t_s[second])
        values = compute_misses(quaternions[first], turns, quaternions[second])
        fit, scale = _fit_calibration_errors(values, columns, stated)
        rates = rates + rates @ fit[:9].reshape(3, 3) + fit[9:]
        values = values - columns @ fit
    return Innovations(first, second, duration, turns, values, stated * scale)


def compute_misses(before: Array, turns: Array, after: Array) -> Array:
    """Compute log[A_after (Φ A_before)ᵀ] (k, 3), rad, of attitudes (k, 4) and the turns (k, 3) between them."""
    if not len(before):
        return np.zeros((0, 3))
    predicted = Rotation.from_quat(before) * Rotation.from_rotvec(turns)
    return np.asarray(-(predicted.inv() * Rotation.from_quat(after)).as_rotvec())


def _fit_calibration_errors(values: Array, columns: Array, stated: Array) -> tuple[Array, float]:
    """Fit innovations (k, 3) by columns (k, 3, 12): the coefficients, and the ratio of the remaining scatter to the stated."""
    fit, scale = np.zeros(columns.shape[2]), 1.0
    if len(values) <= columns.shape[2]:
        return fit, scale
    X, y = columns / stated[:, :, None], values / stated
    norms = np.maximum(np.linalg.norm(X, axis=(0, 1)), 1e-300)
    X, weights = X / norms, np.ones(len(values))
    for _ in range(ROBUST_FIT_ROUNDS):
        root = np.sqrt(weights)[:, None]
        X_w = (X * root[:, :, None]).reshape(-1, norms.size)
        fit = np.linalg.lstsq(X_w.T @ X_w, X_w.T @ (y * root).ravel(), rcond=1e-10)[0]
        size = np.abs(y - X @ fit)
        scale = max(float(np.median(size)) / NORMAL, 1.0)
        weights = 1.0 / np.maximum(size.max(axis=1) / (HUBER * scale), 1.0)
    return fit / norms, scale


def integrate_turns(begin_s: Array, rates: Array, start_s: Array, stop_s: Array) -> tuple[Array, Array]:
    """Integrate the turn of the body between pairs of times at piecewise constant rates.

    Parameters
    ----------
    begin_s : (n,) starts of samples in order of time
    rates : (n, 3) body rates, rad/s
    start_s, stop_s : (k,) times; where no sample is, the last rate goes on

    Returns
    -------
    turns : (k, 3) θ with A(stop) = exp(−[θ×]) A(start), rad
    columns : (k, 3, 12) innovation, rad, per element M[a, b] of rates that are too low by M ω, a running fastest in the order
        b, a, and per bias c that they are too low by
    """
    if not start_s.size or not begin_s.size:
        return np.zeros((start_s.size, 3)), np.zeros((start_s.size, 3, 12))
    low = np.clip(np.searchsorted(begin_s, start_s, side="right") - 1, 0, begin_s.size - 1)
    quaternions, K = _integrate_quaternions(begin_s, np.ascontiguousarray(rates), start_s, stop_s, low)
    columns = -np.moveaxis(K, 1, 2).reshape(start_s.size, 3, 12)
    return np.asarray(Rotation.from_quat(quaternions).as_rotvec()), columns


@compile_cached
def _integrate_quaternions(begin_s, rates, start_s, stop_s, low):  # type: ignore[no-untyped-def]
    """Integrate the turns to quaternions (k, 4), and ∫ R ω_b dt of each b and ∫ R dt, (k, 4, 3, 3), R to the stop."""
    quaternions, K = np.zeros((start_s.size, 4)), np.zeros((start_s.size, 4, 3, 3))
    R, column = np.empty((3, 3)), np.empty(3)
    for k in range(start_s.size):
        x, y, z, w = 0.0, 0.0, 0.0, 1.0
        t, i = start_s[k], low[k]
        while t < stop_s[k]:
            edge = stop_s[k] if i + 1 >= begin_s.size else min(max(begin_s[i + 1], t), stop_s[k])
            dt = edge - t
            a, b, c = rates[i, 0] * dt, rates[i, 1] * dt, rates[i, 2] * dt
            angle = np.sqrt(a * a + b * b + c * c)
            scale = 0.5 - angle * angle / 48 if angle < 1e-4 else np.sin(0.5 * angle) / angle
            a, b, c, d = scale * a, scale * b, scale * c, np.cos(0.5 * angle)
            x, y, z, w = (
                w * a + x * d + y * c - z * b,
                w * b - x * c + y * d + z * a,
                w * c + x * b - y * a + z * d,
                w * d - x * a - y * b - z * c,
            )
            R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (b * b + c * c), 2 * (a * b + c * d), 2 * (a * c - b * d)
            R[1, 0], R[1, 1], R[1, 2] = 2 * (a * b - c * d), 1 - 2 * (a * a + c * c), 2 * (b * c + a * d)
            R[2, 0], R[2, 1], R[2, 2] = 2 * (a * c + b * d), 2 * (b * c - a * d), 1 - 2 * (a * a + b * b)
            for m in range(4):
                for col in range(3):
                    for row in range(3):
                        column[row] = K[k, m, row, col]
                    for row in range(3):
                        K[k, m, row, col] = R[row, 0] * column[0] + R[row, 1] * column[1] + R[row, 2] * column[2]
                    K[k, m, col, col] += dt if m == 3 else rates[i, m] * dt
            t, i = edge, i + 1
        quaternions[k, 0], quaternions[k, 1], quaternions[k, 2], quaternions[k, 3] = x, y, z, w
    return quaternions, K
