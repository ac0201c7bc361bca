"""The two parametrisations a calibration can iterate in: (G, b), and each gyro's own scale factor, axis and bias.

Gyro space. A gyro reads the rate about its own axis,

    ω_raw,i = s_i (u_i · ω) + c_i,    |u_i| = 1,

three gyros ω_raw = K ω + c with K_ij = s_i u_ij; so K = G⁻¹ and c = −G⁻¹ b of R (7). Scale factor, two misalignments and bias
of each gyro are N's state vector (N section II): the partials f_i of N (13) are of ω_adj, not of the raw rates,

    ∂ω/∂K_ij = −G e_i ω_adj,j,    ∂ω/∂c_i = −G e_i,

and a gyro can be calibrated alone, the other two being right or known from elsewhere. Row i of G does not allow that: gyro i
enters all rows of G, and row i needs the raw rates of all three.

The parameters of gyro i are s_i, the components u_ij of its axis along the two other body axes, and c_i; the axis' component
along its own body axis is √(1 − Σ u_ij²). Hence, with J = ∂(G, b)/∂y,

    ∂K_i/∂s_i = u_i,    ∂K_i/∂u_ij = s_i (e_j − (u_ij/u_ii) e_i),
    ∂G/∂K_ij = −G e_i e_jᵀ G,    ∂b/∂K_ij = −G e_i b_j,    ∂(G, b)/∂c_i = (0, −G e_i),

and the sensitivity to y is that to (G, b) times J. Both parametrisations have the same minimum. A Gauss–Newton step differs in
its second order: (G, b) is linear in the rates and leaves no term δG δb, gyro space does.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gyrocal.arrays import Array
from gyrocal.calibration.parameters import AXIS_NAMES, NAMES, GyroParameters
from gyrocal.errors import InputError

Parametrisation = Literal["gain", "gyro"]

GYRO_NAMES = (*(f"s_{i}" if i == j else f"u_{i}{j}" for i in AXIS_NAMES for j in AXIS_NAMES), *(f"c_{i}" for i in AXIS_NAMES))
SMALLEST_OWN_COMPONENT = 0.1  # component of a gyro's axis along its own body axis, below which the other two do not describe it


def convert_to_gyro_space(parameters: GyroParameters) -> Array:
    """Convert G and b to (12,) in the order of `GYRO_NAMES`; s and u dimensionless, c in rad/s.

    An `InputError` if a gyro's axis is nowhere near the body axis it is named for.
    """
    K = np.linalg.inv(parameters.G)
    scale = np.linalg.norm(K, axis=1)
    y = K / scale[:, None]
    _check_own_axes(np.diag(y))
    np.fill_diagonal(y, scale)
    return np.concatenate([y.ravel(), -K @ parameters.bias])


def convert_from_gyro_space(y: Array) -> GyroParameters:
    """Convert (12,) in the order of `GYRO_NAMES` to G and b.

    An `InputError` if a gyro's axis is nowhere near the body axis it is named for.
    """
    U = y[:9].reshape(3, 3).copy()
    scale = np.diag(U).copy()
    np.fill_diagonal(U, 0.0)
    diagonal = np.sqrt(np.maximum(1.0 - np.sum(U**2, axis=1), 0.0))
    _check_own_axes(diagonal)
    np.fill_diagonal(U, diagonal)
    G = np.asarray(np.linalg.inv(scale[:, None] * U), dtype=np.float64)
    return GyroParameters(G, np.asarray(-G @ y[9:]))


def _check_own_axes(diagonal: Array) -> None:
    tilted = [AXIS_NAMES[i] for i in range(3) if not diagonal[i] >= SMALLEST_OWN_COMPONENT]
    if tilted:
        raise InputError(
            f"the axis of gyro {', '.join(tilted)} is more than 84 deg from its body axis, which gyro space cannot describe; "
            "put the gyros in the order of the body axes, or calibrate with the parametrisation 'gain'"
        )


def compute_gyro_jacobian(parameters: GyroParameters) -> Array:
    """Compute J = ∂(G, b)/∂y, (12, 12), rows in the order of `NAMES`, columns of `GYRO_NAMES`."""
    G, bias = parameters.G, parameters.bias
    K = np.linalg.inv(G)
    scale = np.linalg.norm(K, axis=1)
    U = K / scale[:, None]
    J = np.zeros((12, 12))
    for i in range(3):
        for j in range(3):
            if i == j:
                dK = U[i]
            else:
                dK = np.zeros(3)
                dK[j], dK[i] = scale[i], -scale[i] * U[i, j] / U[i, i]
            J[:9, 3 * i + j] = -np.outer(G[:, i], dK @ G).ravel()
            J[9:, 3 * i + j] = -G[:, i] * (dK @ bias)
        J[9:, 9 + i] = -G[:, i]
    return J


@dataclass(frozen=True)
class ParameterSpace:
    """A parametrisation of a gyro's calibration."""

    names: tuple[str, ...]  # of its twelve parameters; nine dimensionless, then three biases in rad/s
    vector: Callable[[GyroParameters], Array]  # (12,) parameters of G and b
    parameters: Callable[[Array], GyroParameters]  # G and b of (12,) parameters
    # (12, 12) ∂(G, b)/∂ its parameters, rows in the order of `gyrocal.calibration.parameters.NAMES`
    jacobian: Callable[[GyroParameters], Array]


SPACES: dict[str, ParameterSpace] = {
    "gain": ParameterSpace(NAMES, lambda x: x.vector, GyroParameters.from_vector, lambda _: np.eye(12)),
    "gyro": ParameterSpace(GYRO_NAMES, convert_to_gyro_space, convert_from_gyro_space, compute_gyro_jacobian),
}


def select_parameter_space(parametrisation: str) -> ParameterSpace:
    """Select the parametrisation of a name; an `InputError` if there is none of that name."""
    if parametrisation not in SPACES:
        raise InputError(f"unknown parametrisation {parametrisation!r}; known: {', '.join(SPACES)}")
    return SPACES[parametrisation]
