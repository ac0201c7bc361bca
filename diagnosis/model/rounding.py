"""What readings leave that are rounded or cut to steps coarser than their noise, as noise of a recording's model.

The error follows where the rate lies inside a step, which no reading shows: it may have any course. It is a sum of
Ornstein-Uhlenbeck rate errors about each coarse axis. In the whitened observations y, whose stated noise has the covariance I,

    y ~ N(0, C + B Bᵀ),    C = I + Σ_k θ_k K_k

B holds the columns of start attitudes, G and b in units of their priors. C consists of one block for each interval. With
M = I + BᵀC⁻¹B,

    −2 log L = log |C| + log |M| + yᵀ Q y,    Q = C⁻¹ − C⁻¹B M⁻¹ BᵀC⁻¹
    ∂ log L/∂θ_k = ½ (yᵀ Q K_k Q y − tr Q K_k)

and the θ of the largest likelihood are the variances, each of which is bounded by a third of the step's square: a reading cut
toward zero errs by up to a step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg
import scipy.optimize

from diagnosis.model.folds import build_shared_columns
from diagnosis.model.recording_model import RecordingModel
from gyrocal.arrays import Array

Kernel = tuple[Array, ...]  # of each interval the whitened covariance (n, n) of its observations, at a variance of 1 (rad/s)²

TIMES = (0.05, 1.0)  # correlation times, in lengths of the median interval
START = 0.05  # share of the bound of each variance where the optimisation starts
LEAST = 1e-6  # share of the bound below which a variance is zero
PRECISION = 1e-5  # relative change of −log L at which the optimisation ends
ITERATIONS = 60  # of the optimisation, at most


def add_rounding(model: RecordingModel, steps: Array) -> RecordingModel:
    """Add to the noise of a model what rounding to steps (3,) leaves, rad/s; zero where they are finer than the noise."""
    axes = np.repeat(np.flatnonzero(steps > 0), len(TIMES))
    kernels = [kernel for axis in np.flatnonzero(steps > 0) for kernel in build_kernels(model, int(axis))]
    variances = estimate_variances(model, kernels, steps[axes] ** 2 / 3)
    blocks = []
    for number, block in enumerate(model.blocks):
        C = _build_covariance(variances, kernels, number)
        blocks.append(replace(block, whitener=block.whitener @ np.linalg.cholesky(C)))
    return replace(model, blocks=tuple(blocks))


def build_kernels(model: RecordingModel, axis: int) -> list[Kernel]:
    """Build the kernels of rate errors about one axis, one for each correlation time."""
    length = float(np.median([block.elapsed_s[-1] for block in model.blocks]))
    t_s, interval, columns = model.cells.t_s, model.cells.interval, model.cell_columns[axis]
    kernels = []
    for tau in np.array(TIMES) * length:
        parts = []
        for number, block in enumerate(model.blocks):
            inside = interval == number
            part = columns[block.rows][:, inside]
            parts.append(part @ np.exp(-np.abs(np.subtract.outer(t_s[inside], t_s[inside])) / tau) @ part.T)
        kernels.append(tuple(parts))
    return kernels


def estimate_variances(model: RecordingModel, kernels: Sequence[Kernel], largest: Array) -> Array:
    """Estimate the variances (K,) of kernels by maximum likelihood, none of which is beyond its bound (K,)."""
    y, B, rows = model.whiten(model.zeta), build_shared_columns(model), [block.rows for block in model.blocks]
    fit = scipy.optimize.minimize(
        lambda x: compute_negative_log_likelihood(np.exp(x), y, B, rows, kernels),
        np.log(START * largest),
        jac=True,
        method="L-BFGS-B",
        bounds=[(np.log(LEAST * most), np.log(most)) for most in largest],
        options={"maxiter": ITERATIONS, "ftol": PRECISION},
    )
    theta = np.exp(fit.x)
    return np.where(theta > 2 * LEAST * largest, theta, 0.0)


def _build_covariance(theta: Array, kernels: Sequence[Kernel], number: int) -> Array:
    """Build C (n, n) of one interval."""
    blocks = [variance * kernel[number] for variance, kernel in zip(theta, kernels, strict=True)]
    return np.sum([np.eye(len(blocks[0])), *blocks], axis=0)


def compute_negative_log_likelihood(
    theta: Array, y: Array, B: Array, rows: Sequence[slice], kernels: Sequence[Kernel]
) -> tuple[float, Array]:
    """Compute −log L and its gradient with respect to log θ, see the module."""
    Cy, CB = np.empty_like(y), np.empty_like(B)
    log_det, inverses = 0.0, []
    for number, block_rows in enumerate(rows):
        C = _build_covariance(theta, kernels, number)
        factor = scipy.linalg.cholesky(C, lower=True, check_finite=False, overwrite_a=True)
        log_det += 2 * float(np.log(np.diag(factor)).sum())
        inverse, _ = scipy.linalg.lapack.dpotri(factor, lower=1)
        inverse = np.tril(inverse) + np.tril(inverse, -1).T
        inverses.append(inverse)
        Cy[block_rows], CB[block_rows] = inverse @ y[block_rows], inverse @ B[block_rows]
    M = np.eye(B.shape[1]) + B.T @ CB
    small = scipy.linalg.cholesky(M, lower=True, check_finite=False)
    coefficients = scipy.linalg.cho_solve((small, True), B.T @ Cy, check_finite=False)
    Qy = Cy - CB @ coefficients
    half = scipy.linalg.solve_triangular(small, CB.T, lower=True, check_finite=False).T  # (N, q): CB M⁻¹ CBᵀ = half halfᵀ
    value = 0.5 * (log_det + 2 * float(np.log(np.diag(small)).sum()) + float(y @ Qy))
    slope = np.zeros(theta.size)
    for number, block_rows in enumerate(rows):
        Q, q = inverses[number] - half[block_rows] @ half[block_rows].T, Qy[block_rows]
        for k, kernel in enumerate(kernels):
            K = kernel[number]
            slope[k] -= 0.5 * theta[k] * (float(q @ K @ q) - float(np.sum(Q * K)))
    return value, slope
