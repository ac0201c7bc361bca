"""The simulator's own rotation helpers; conventions as in `gyrocal`: passive matrices, inertial to body, scalar last.

A frame turned by α about the axis e gives a fixed vector v the components

    R(e, α) v = exp(−[e×]α) v = cos α v − sin α (e × v) + (1 − cos α) e (e·v)

The recorded quaternion q has A(q) = ``Rotation.from_quat(q).as_matrix().T``: as an active rotation it is Aᵀ.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array


def turn_frame(axis: Array, angle: Array, vectors: Array) -> Array:
    """Compute the components R(e, α) v (n, 3) of v, (n, 3) or (3,), in a frame turned about one unit axis e by α (n,), rad."""
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    along = (vectors @ axis)[..., None] * axis
    return np.asarray(along + cosine * (vectors - along) - sine * compute_cross(axis, vectors))


def compute_cross(a: Array, b: Array) -> Array:
    """Compute a × b along the last axis; several times faster than `numpy.cross` on long arrays."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    out[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    out[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out


def build_turn_matrix(axis: Array, angle: Array) -> Array:
    """Build R(e, α) as matrices, (n, 3, 3)."""
    return np.asarray(Rotation.from_rotvec(-np.asarray(angle)[:, None] * axis).as_matrix())


def convert_to_matrix(quaternions: Array) -> Array:
    """Convert quaternions to A(q), inertial to body; (..., 4) → (..., 3, 3)."""
    return np.asarray(np.swapaxes(Rotation.from_quat(quaternions).as_matrix(), -1, -2))


def convert_to_quaternion(A: Array) -> Array:
    """Convert attitude matrices to quaternions, scalar part ≥ 0; (..., 3, 3) → (..., 4)."""
    return np.asarray(Rotation.from_matrix(np.swapaxes(A, -1, -2)).as_quat(canonical=True))


def apply_rotation_errors(quaternions: Array, errors: Array) -> Array:
    """Apply errors e (n, 3), rad in body axes, to quaternions (n, 4): exp([e×]) A(q), scalar part ≥ 0."""
    # As an active rotation q is Aᵀ, and (exp([e×]) A)ᵀ = Aᵀ exp(−[e×]).
    return np.asarray((Rotation.from_quat(quaternions) * Rotation.from_rotvec(-errors)).as_quat(canonical=True))


def separation(q1: Array, q2: Array) -> Array:
    """Compute the rotation vector θ with exp([θ×]) A(q1) = A(q2), rad; (..., 4) twice → (..., 3)."""
    return np.asarray((Rotation.from_quat(q2).inv() * Rotation.from_quat(q1)).as_rotvec())
