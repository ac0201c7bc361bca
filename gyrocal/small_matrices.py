"""Roots and products of matrices (3, 3) for compiled functions.

The linear algebra of numpy, as numba compiles it, takes seconds to compile and holds for matrices of any size.
"""

import numpy as np

from gyrocal.arrays import Array
from gyrocal.jit_cache import compile_cached


@compile_cached
def compute_lower_root(S: Array) -> Array:
    """Compute the lower root L of a covariance, S = L Lᵀ; (3, 3)."""
    L = np.zeros((3, 3))
    for i in range(3):
        for j in range(i + 1):
            remaining = S[i, j]
            for a in range(j):
                remaining -= L[i, a] * L[j, a]
            if i > j:
                L[i, j] = remaining / L[j, j]
            elif remaining > 0.0:
                L[i, i] = np.sqrt(remaining)
            else:
                raise np.linalg.LinAlgError("a covariance is not positive definite")
    return L


@compile_cached
def solve_lower(L: Array, b: Array) -> Array:
    """Compute L⁻¹ b of a lower root (3, 3) and columns (3, k)."""
    x = b.copy()
    for i in range(3):
        for j in range(b.shape[1]):
            for a in range(i):
                x[i, j] -= L[i, a] * x[a, j]
            x[i, j] /= L[i, i]
    return x


@compile_cached
def multiply(A: Array, B: Array) -> Array:
    """Multiply A B; (3, 3) and (3, k)."""
    out = np.zeros(B.shape)
    for i in range(3):
        for k in range(3):
            for j in range(B.shape[1]):
                out[i, j] += A[i, k] * B[k, j]
    return out


@compile_cached
def transform_covariance(A: Array, P: Array) -> Array:
    """Compute A P Aᵀ; (3, 3) twice."""
    AP, out = multiply(A, P), np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                out[i, j] += AP[i, k] * A[j, k]
    return out
