"""The compiled core of a calibration: residuals, their whitening, and the iteration.

Maneuver by maneuver, or group by group where residuals correlate, with V = L Lᵀ the covariance of the group's residuals,

    H = L⁻¹ Θ D,  z = L⁻¹ θ,    W ← W + Hᵀ H,  u ← u + Hᵀ z                                    N (31), (32)
    Δx = D W⁻¹ u,    P = D W⁻¹ D                                                                      N (33)

D scales the parameters by their plausible range, since W spans twelve decades in units of G and rad/s. Everything here works
on arrays of one prepared `Problem` (see `gyrocal.calibration.problem`) and holds no state.
"""

from math import atan2, sqrt

import numpy as np
from numpy.typing import NDArray

from gyrocal.arrays import Array, Indices
from gyrocal.calibration.covariance import model_covariance, whiten_chain
from gyrocal.calibration.propagation import propagate_packed
from gyrocal.jit_cache import compile_cached

BoolArray = NDArray[np.bool_]

SMALL_SINE = 1e-9  # below it a rotation vector is its sine to rounding


@compile_cached
def compute_attitude_residuals(R: Array, A_start: Array, A_obs: Array) -> Array:
    """Compute θ (m, 3) rad of N (16), exp([θ×]) = A_obs (R A_start)ᵀ; the full rotation vector, below half a turn."""
    m = len(R)
    theta = np.empty((m, 3))
    A_prop, delta = np.empty((3, 3)), np.empty((3, 3))
    for a in range(m):
        for i in range(3):
            for j in range(3):
                A_prop[i, j] = 0.0
                for k in range(3):
                    A_prop[i, j] += R[a, i, k] * A_start[a, k, j]
        for i in range(3):
            for j in range(3):
                delta[i, j] = 0.0
                for k in range(3):
                    delta[i, j] += A_obs[a, i, k] * A_prop[j, k]
        x, y, z = delta[2, 1] - delta[1, 2], delta[0, 2] - delta[2, 0], delta[1, 0] - delta[0, 1]
        sine = 0.5 * sqrt(x * x + y * y + z * z)
        cosine = 0.5 * (delta[0, 0] + delta[1, 1] + delta[2, 2] - 1)
        stretch = 0.5 * (atan2(sine, cosine) / sine if sine > SMALL_SINE else 1.0)
        theta[a, 0], theta[a, 1], theta[a, 2] = stretch * x, stretch * y, stretch * z
    return theta


@compile_cached
def whiten(V: Array, values: Array) -> Array:
    """Compute L⁻¹ values with V = L Lᵀ; values (r, c)."""
    L = np.linalg.cholesky(V)
    out = values.copy()
    rows, columns = out.shape
    for i in range(rows):
        for j in range(i):
            factor = L[i, j]
            if factor != 0.0:
                for c in range(columns):
                    out[i, c] -= factor * out[j, c]
        for c in range(columns):
            out[i, c] /= L[i, i]
    return out


@compile_cached
def build_sensitivity(S: Array, columns: Indices, scale: Array) -> Array:
    """Build Θ D (3m, p) from the regressor sums S (m, 4, 3, 3); column k of the twelve is G[k // 3, k % 3] or b[k − 9]."""
    m, p = len(S), len(columns)
    out = np.empty((3 * m, p))
    for a in range(m):
        for c in range(p):
            k = columns[c]
            q, axis = (k % 3, k // 3) if k < 9 else (3, k - 9)
            for i in range(3):
                out[3 * a + i, c] = S[a, q, i, axis] * scale[c]
    return out


@compile_cached
def whiten_groups(
    values: Array,
    R: Array,
    groups: tuple[Indices, Indices, BoolArray],
    references: tuple[Indices, Indices, Indices, Array],
    walk: Array,
    model: int,
    given: Array,
) -> tuple[Array, Array]:
    """Compute L⁻¹ values (3m, c), one group after another, and the variance (m, 3) of each residual, rad².

    values: (3m, c) columns of the residuals
    groups: (m,) residuals, group by group, one past the end of each group, and whether each is a chain to be whitened as one;
        with one V of all residuals there is one group
    references: interval, start, row and noise as in `gyrocal.calibration.covariance.compute_residual_covariance`
    walk, model, given: as in `gyrocal.calibration.covariance.model_covariance`
    """
    interval, start, row, noise = references
    order, ends, chained = groups
    out, variance = np.empty(values.shape), np.empty((len(order), 3))
    low = 0
    for group in range(len(ends)):
        rows, high = order[low : ends[group]], ends[group]
        if chained[group]:
            whiten_chain(rows, values, R, references, walk, out[3 * low : 3 * high], variance)
        else:
            group_values = np.empty((3 * len(rows), values.shape[1]))
            for k in range(len(group_values)):
                for c in range(values.shape[1]):
                    group_values[k, c] = values[3 * rows[k // 3] + k % 3, c]
            V = model_covariance(R[rows], interval[rows], start[rows], row[rows], noise, walk[rows], model, given)
            out[3 * low : 3 * high] = whiten(V, group_values)
            for k in range(len(group_values)):
                variance[rows[k // 3], k % 3] = V[k, k]
        low = high
    return out, variance


@compile_cached
def iterate(
    iterations: int,
    x: Array,
    columns: Indices,
    scale: Array,
    packed: tuple[Array, Indices, Indices],
    linear: bool,
    beyond_series: bool,
    A_start: Array,
    A_obs: Array,
    groups: tuple[Indices, Indices, BoolArray],
    references: tuple[Indices, Indices, Indices, Array],
    walk: Array,
    model: int,
    given: Array,
    look_back: bool,
) -> tuple[Array, Array, Array, float]:
    """Iterate a fixed number of times without a prior, in one call, as a Monte Carlo case does.

    Returns x (iterations + 1, 12) at the start and after each iteration; θ (iterations + 1, m, 3) there, NaN at the last
    without looking back; P (p, p) of the last iteration; Σ θᵀ V⁻¹ θ after it, NaN likewise.

    x: (12,) parameters to start from
    columns, scale: (p,) solved-for parameters and their scale
    packed: increments, ends, last as in `gyrocal.calibration.propagation.propagate_packed`
    groups, references, walk, model, given: as in `whiten_groups`
    look_back: whether to propagate once more for the residuals after the last iteration
    """
    increments, ends, last = packed
    arc = references[0]
    p = len(columns)
    xs = np.empty((iterations + 1, 12))
    thetas = np.empty((iterations + 1, len(arc), 3))
    P = np.empty((p, p))
    xs[0] = x
    chi2 = 0.0
    for n in range(iterations + 1):
        if n == iterations and not look_back:
            thetas[n] = np.nan
            chi2 = np.nan
            break
        G, bias = xs[n, :9].copy().reshape(3, 3), xs[n, 9:].copy()
        R, S = propagate_packed(increments, ends, last, arc, G, bias, linear, beyond_series)
        thetas[n] = compute_attitude_residuals(R, A_start, A_obs)
        values = np.concatenate((build_sensitivity(S, columns, scale), thetas[n].reshape(-1, 1)), axis=1)
        white, _ = whiten_groups(values, R, groups, references, walk, model, given)
        H, z = white[:, :p].copy(), white[:, p].copy()
        if n == iterations:
            chi2 = np.sum(z * z)
            break
        u = H.T @ z
        inverse = np.linalg.inv(H.T @ H)
        xs[n + 1] = xs[n]
        for i in range(p):
            step = 0.0
            for j in range(p):
                step += inverse[i, j] * u[j]
                P[i, j] = inverse[i, j] * scale[i] * scale[j]
            xs[n + 1, columns[i]] -= scale[i] * step
    return xs, thetas, P, chi2
