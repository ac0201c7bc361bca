"""Attitude algebra over scipy's `Rotation`, in the papers' convention.

Frames and signs are those of `gyrocal`. N (29) as printed has the opposite sign of N (16): with [a×]b = a × b,
½ [δA₂₃ − δA₃₂, …] = −θ to first order. Both residuals here carry the sign of N (16).
"""

import numpy as np
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array


def cross_matrix(v: Array) -> Array:
    """Build [v×], with [v×] u = v × u; v (..., 3) → (..., 3, 3)."""
    v = np.asarray(v, dtype=float)
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def matrix_from_quaternion(q: Array) -> Array:
    """Convert quaternions to A(q) of the papers, inertial to body; q (..., 4), scalar last → (..., 3, 3)."""
    return np.asarray(np.swapaxes(Rotation.from_quat(q).as_matrix(), -1, -2))


def quaternion_from_matrix(A: Array) -> Array:
    """Invert `matrix_from_quaternion`; (..., 3, 3) → (..., 4) with a non-negative scalar part."""
    return np.asarray(Rotation.from_matrix(np.swapaxes(A, -1, -2)).as_quat(canonical=True))


def rotation_matrix(theta: Array) -> Array:
    """Compute exp([θ×]), θ (..., 3) rad → (..., 3, 3)."""
    return np.asarray(Rotation.from_rotvec(theta).as_matrix())


def residual(A_obs: Array, A_prop: Array) -> Array:
    """Compute the attitude residual θ of N (16), the full rotation vector, rad; (..., 3, 3) twice → (..., 3)."""
    return np.asarray(Rotation.from_matrix(A_obs @ np.swapaxes(A_prop, -1, -2)).as_rotvec())


def residual_linear(A_obs: Array, A_prop: Array) -> Array:
    """Compute the residual in the linear form N (29) with the sign of N (16), rad; exact to third order in θ."""
    d = A_obs @ np.swapaxes(A_prop, -1, -2)
    return 0.5 * np.stack([d[..., 2, 1] - d[..., 1, 2], d[..., 0, 2] - d[..., 2, 0], d[..., 1, 0] - d[..., 0, 1]], axis=-1)
