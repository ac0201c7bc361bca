"""Other ways to propagate: the textbook's loop and gtsam."""

from collections.abc import Callable
from math import sin

import numpy as np

from gyrocal import Arcs, GyroParameters
from gyrocal.arrays import Array

SMALL = 1e-4  # rad; below it the closed forms lose digits and two terms of the series are exact


def propagate_textbook(arcs: Arcs, parameters: GyroParameters) -> tuple[Array, Array]:
    """Propagate Θ_k = ψ_k F_k + R_k Θ_{k−1} with 3×3 matrices, sample by sample, by N (15), (21)–(28).

    Returns
    -------
    R (m, 3, 3) and Θ (m, 3, 12) at the outputs; one output an arc.
    """
    identity = np.eye(3)
    R_out, Theta_out = np.empty((len(arcs.first), 3, 3)), np.empty((len(arcs.first), 3, 12))
    for output, (first, last) in enumerate(zip(arcs.first, arcs.last, strict=True)):
        R, Theta = np.eye(3), np.zeros((3, 12))
        for k in range(first, last):
            raw, dt = arcs.raw[k], arcs.dt[k]
            omega = parameters.G @ raw + parameters.bias
            K = np.array([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]]) * dt
            s, c, d = _compute_series_coefficients(float(np.linalg.norm(omega)) * dt)
            K2 = K @ K
            step, psi = identity - s * K + c * K2, (identity - c * K + d * K2) * dt
            F = np.hstack([np.kron(identity, raw), identity])
            Theta = psi @ F + step @ Theta
            R = step @ R
        R_out[output], Theta_out[output] = R, Theta
    return R_out, Theta_out


def _compute_series_coefficients(phi: float) -> tuple[float, float, float]:
    """Compute sin φ/φ, (1 − cos φ)/φ² and (φ − sin φ)/φ³."""
    if phi < SMALL:
        return 1 - phi**2 / 6, 0.5 - phi**2 / 24, 1 / 6 - phi**2 / 120
    return sin(phi) / phi, 2 * (sin(phi / 2) / phi) ** 2, (phi - sin(phi)) / phi**3


def prepare_gtsam(arcs: Arcs, parameters: GyroParameters) -> Callable[[], Array]:
    """Prepare gtsam's PreintegratedRotation over the arcs, with its bias Jacobian (3 of our 12 columns).

    Its rates are adjusted beforehand and not timed, since it has no G.

    Returns
    -------
    A call that returns R (m, 3, 3).
    """
    import gtsam

    adjusted = arcs.raw @ parameters.G.T + parameters.bias
    zero, settings = np.zeros(3), gtsam.PreintegratedRotationParams()

    def integrate() -> Array:
        out = np.empty((len(arcs.first), 3, 3))
        for output, (first, last) in enumerate(zip(arcs.first, arcs.last, strict=True)):
            integration = gtsam.PreintegratedRotation(settings)
            for k in range(first, last):
                integration.integrateGyroMeasurement(adjusted[k], zero, arcs.dt[k])
            out[output] = integration.deltaRij().matrix().T
        return out

    return integrate
