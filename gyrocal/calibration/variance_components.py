"""Estimate variance components of whitened residuals: how much noise of which kind is there beside the stated noise.

Residuals y (N,) with the estimated parameters projected out are modelled as

    y ~ N(0, C),    C = φ I + Σ_k θ_k Z_k Z_kᵀ    on the d-dimensional space of the residuals.

φ is the variance of the white noise relative to the stated one. The columns Z_k (N, r_k) are the factor of the covariance of a
process of unit variance, such as a rate error of a given correlation time, with the parameters projected out too. The sizes
maximise the restricted likelihood (REML; Patterson and Thompson, Biometrika 58, 1971). With the matrices M_k = Z_k Z_kᵀ, the
ratios ρ_k = θ_k/φ, D = I + Σ_k ρ_k M_k and a = D⁻¹ y,

    −2 log L = d log φ + log |D| + yᵀa/φ
    ∂ log L/∂ log θ_k = ½ ρ_k (aᵀ M_k a/φ − tr(D⁻¹ M_k))
    ∂ log L/∂ log φ   = ½ (aᵀa/φ − d + Σ_k ρ_k tr(D⁻¹ M_k))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize

from gyrocal.arrays import Array, Indices

START_SHARE = 0.3  # share of the excess power that all components have together where the optimisation starts
PRECISION = 1e-6  # relative change of −log L at which the optimisation ends
LEAST_POWER_SHARE = 1e-8  # share of the power below which a component is zero


@dataclass(frozen=True)
class VarianceComponents:
    """Sizes of the components."""

    noise: float  # φ, variance of the white noise relative to the stated one
    variances: Array  # (K,) θ
    log_likelihood_gain: float  # log L above that of the stated noise alone, φ = 1 and θ = 0


def estimate_variance_components(residuals: Array, components: Sequence[Array], dof: float) -> VarianceComponents:
    """Estimate the sizes of noise components by restricted maximum likelihood.

    Components that the residuals do not need have variance 0.

    residuals: (N,) whitened by the stated noise, the estimated parameters projected out
    components: K arrays (N, r_k), columns of each process of unit variance, treated in the same way; none is zero
    dof: d, degrees of freedom of the residuals
    """
    power = float(residuals @ residuals)
    component_power = np.array([float(np.square(part).sum()) for part in components])
    unit = max(power, dof) / component_power  # variance with which a component would make all the power alone
    lower = list_lower_places(residuals.size)
    kernels = np.array([(part @ part.T).ravel()[lower] for part in components]).reshape(len(components), lower.size)

    def evaluate_objective(x: Array) -> tuple[float, Array]:
        return evaluate_likelihood(float(np.exp(x[0])), np.exp(x[1:]), kernels, residuals, dof, lower)

    # The noise is never less than stated, φ ≥ 1, and at most all of the power.
    most_log_noise = max(np.log(max(power, dof) / dof), 1e-9)
    excess_share = max(1.0 - dof / max(power, dof), 0.05)  # of the power, beyond the stated noise
    start_share = max(START_SHARE / max(len(components), 1) * excess_share, 10 * LEAST_POWER_SHARE)
    start = np.concatenate([[0.5 * most_log_noise], np.log(start_share * unit)])
    bounds = [(0.0, most_log_noise), *((np.log(LEAST_POWER_SHARE * scale), np.log(10 * scale)) for scale in unit)]
    options = {"maxiter": 100, "ftol": PRECISION}
    minimum = scipy.optimize.minimize(evaluate_objective, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    noise, theta = float(np.exp(minimum.x[0])), np.exp(minimum.x[1:])
    theta = np.where(theta > 1.5 * LEAST_POWER_SHARE * unit, theta, 0.0)  # at its lower bound a variance is zero
    log_likelihood_as_stated = -0.5 * power  # at φ = 1, θ = 0
    return VarianceComponents(noise, theta, -float(minimum.fun) - log_likelihood_as_stated)


def list_lower_places(n: int) -> Indices:
    """List the places of the lower triangle of an (n, n) matrix in its n² elements, row by row."""
    return np.flatnonzero(np.tri(n, dtype=bool))


def evaluate_likelihood(
    noise: float, theta: Array, kernels: Array, y: Array, dof: float, lower: Indices
) -> tuple[float, Array]:
    """Evaluate −log L but for a constant, and its gradient by log φ and log θ.

    The matrices M_k are given by their lower triangles (K, N (N + 1)/2) alone, at the places `lower` of the raveled matrix:
    reading them from memory takes most of the time.
    """
    ratios, n = theta / noise, y.size
    D = np.zeros(n * n)
    D[lower] = ratios @ kernels
    D[:: n + 1] += 1.0
    # The lower triangle by rows is the upper one by columns, which LAPACK takes without a copy.
    factor = scipy.linalg.cholesky(D.reshape(n, n).T, overwrite_a=True, check_finite=False)
    a = scipy.linalg.cho_solve((factor, False), y, check_finite=False)
    value = 0.5 * (dof * np.log(noise) + 2 * np.log(np.diag(factor)).sum() + y @ a / noise)
    inverse, _ = scipy.linalg.lapack.dpotri(factor, overwrite_c=1)
    products = np.array([inverse.T, np.outer(a, a)]).reshape(2, -1)[:, lower] * 2.0
    products[:, np.cumsum(np.arange(1, n + 1)) - 1] *= 0.5  # elements beside the diagonal count twice
    traces, quadratics = (ratios * (kernels @ product) for product in products)
    slope = -0.5 * np.concatenate([[a @ a / noise - dof + traces.sum()], quadratics / noise - traces])
    return float(value), slope
