"""Other ways to propagate and to solve: the textbook's loop, the same compiled row by row, gtsam and scipy."""

from collections.abc import Callable
from math import cos, sin, sqrt
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.streams import Flight, run_packed
from gyrocal import Arcs, GyroParameters, calibrate
from gyrocal.calibration import normal_equations as accumulation
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.propagation import Propagation

Array = NDArray[np.float64]

SCALE = np.array([1e-4] * 9 + [1e-7] * 3)  # of a parameter's correction, so that finite differences are of like size
SIGMA = np.deg2rad(0.01)  # equal weights: the minimum then does not depend on how a covariance moves with the parameters
AGREEMENT = 1e-9  # in G
DIFF_STEP = 1e-5  # scipy's own step, 1.5e-8, is lost in rounding here and leaves 1e-8 in G; three points cost twice as much
SMALL = 1e-4  # rad; below it the closed forms lose digits and two terms of the series are exact


def textbook(arcs: Arcs, parameters: GyroParameters) -> tuple[Array, Array]:
    """Θ_k = ψ_k F_k + R_k Θ_{k−1} with 3×3 matrices, sample by sample, as N (15), (21)–(28) has it.

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
            s, c, d = _coefficients(float(np.linalg.norm(omega)) * dt)
            K2 = K @ K
            step, psi = identity - s * K + c * K2, (identity - c * K + d * K2) * dt
            F = np.hstack([np.kron(identity, raw), identity])
            Theta = psi @ F + step @ Theta
            R = step @ R
        R_out[output], Theta_out[output] = R, Theta
    return R_out, Theta_out


def _coefficients(phi: float) -> tuple[float, float, float]:
    """sin φ/φ, (1 − cos φ)/φ² and (φ − sin φ)/φ³."""
    if phi < SMALL:
        return 1 - phi**2 / 6, 0.5 - phi**2 / 24, 1 / 6 - phi**2 / 120
    return sin(phi) / phi, 2 * (sin(phi / 2) / phi) ** 2, (phi - sin(phi)) / phi**3


def rows(arcs: Arcs, parameters: GyroParameters) -> Propagation:
    """The kernel's sums, compiled, one step at a time: what running pieces as lanes is to beat."""
    R, S = _rows(arcs.raw, arcs.dt, arcs.first, arcs.last, parameters.G, parameters.bias)
    return Propagation(R, S)


@numba.njit(cache=True)
def _rows(
    raw: Array, dt: Array, first: NDArray[np.intp], last: NDArray[np.intp], G: Array, bias: Array
) -> tuple[Array, Array]:  # pragma: no cover - compiled
    R_out, S_out = np.empty((len(first), 3, 3)), np.empty((len(first), 4, 3, 3))
    P, S, E = np.empty((3, 3)), np.empty((4, 3, 3)), np.empty((3, 3))
    for output in range(len(first)):
        P[:] = np.eye(3)
        S[:] = 0.0
        for k in range(first[output], last[output]):
            h = dt[k]
            hx, hy, hz = raw[k, 0] * h, raw[k, 1] * h, raw[k, 2] * h
            x = G[0, 0] * hx + G[0, 1] * hy + G[0, 2] * hz + bias[0] * h
            y = G[1, 0] * hx + G[1, 1] * hy + G[1, 2] * hz + bias[1] * h
            z = G[2, 0] * hx + G[2, 1] * hy + G[2, 2] * hz + bias[2] * h
            f = x * x + y * y + z * z
            if f < 0.01:
                c = 1 / 2 + f * (-1 / 24 + f * (1 / 720 + f * (-1 / 40320 + f / 3628800)))
                d = 1 / 6 + f * (-1 / 120 + f * (1 / 5040 + f * (-1 / 362880 + f / 39916800)))
            else:
                phi = sqrt(f)
                c, d = (1 - cos(phi)) / f, (phi - sin(phi)) / (phi * f)
            E[0, 0], E[0, 1], E[0, 2] = 1 - d * (y * y + z * z), d * x * y - c * z, d * x * z + c * y
            E[1, 0], E[1, 1], E[1, 2] = d * x * y + c * z, 1 - d * (x * x + z * z), d * y * z - c * x
            E[2, 0], E[2, 1], E[2, 2] = d * x * z - c * y, d * y * z + c * x, 1 - d * (x * x + y * y)
            for i in range(3):
                px, py, pz = P[i, 0], P[i, 1], P[i, 2]
                mx = px * E[0, 0] + py * E[1, 0] + pz * E[2, 0]
                my = px * E[0, 1] + py * E[1, 1] + pz * E[2, 1]
                mz = px * E[0, 2] + py * E[1, 2] + pz * E[2, 2]
                P[i, 0], P[i, 1], P[i, 2] = px + my * z - mz * y, py + mz * x - mx * z, pz + mx * y - my * x
                S[0, i, 0] += hx * mx
                S[0, i, 1] += hx * my
                S[0, i, 2] += hx * mz
                S[1, i, 0] += hy * mx
                S[1, i, 1] += hy * my
                S[1, i, 2] += hy * mz
                S[2, i, 0] += hz * mx
                S[2, i, 1] += hz * my
                S[2, i, 2] += hz * mz
                S[3, i, 0] += h * mx
                S[3, i, 1] += h * my
                S[3, i, 2] += h * mz
        R_out[output] = P.T
        for q in range(4):
            S_out[output, q] = P.T @ S[q]
    return R_out, S_out


def gtsam_rotation(arcs: Arcs, parameters: GyroParameters) -> Callable[[], Array]:
    """gtsam's PreintegratedRotation over the arcs, with its bias Jacobian (3 of our 12 columns); ImportError without gtsam.

    Its rates are adjusted beforehand and not timed, since G is none of its business.

    Returns
    -------
    A call that returns R (m, 3, 3).
    """
    import gtsam

    adjusted = arcs.raw @ parameters.G.T + parameters.bias
    zero, settings = np.zeros(3), gtsam.PreintegratedRotationParams()

    def integrate(first: int, last: int) -> Any:
        integration = gtsam.PreintegratedRotation(settings)
        for k in range(first, last):
            integration.integrateGyroMeasurement(adjusted[k], zero, arcs.dt[k])
        return integration.deltaRij().matrix().T

    return lambda: np.array([integrate(first, last) for first, last in zip(arcs.first, arcs.last, strict=True)])


def scipy_rotation(arcs: Arcs, parameters: GyroParameters) -> Array:
    """R (m, 3, 3) alone, no Θ, by scipy's Rotation: all steps at once, then neighbours multiplied until one is left."""
    steps = (arcs.raw @ parameters.G.T + parameters.bias) * -arcs.dt[:, None]
    out = np.empty((len(arcs.first), 3, 3))
    for output, (first, last) in enumerate(zip(arcs.first, arcs.last, strict=True)):
        rotations = Rotation.from_rotvec(steps[first:last])
        while len(rotations) > 1:
            even = len(rotations) // 2 * 2
            joined = rotations[1:even:2] * rotations[0:even:2]
            rotations = joined if even == len(rotations) else Rotation.concatenate([joined, rotations[even:]])
        out[output] = rotations.as_matrix()[0]
    return out


def solvers(flight: Flight) -> dict[str, Callable[[], Array]]:
    """Both solvers of case 0, prepared; each returns the parameters (12,)."""
    initial = flight.initial.vector
    problem = flight.problem
    C = np.tile(np.eye(3) * SIGMA**2, (len(problem.measurements.row), 1, 1))
    weighted = Problem.build(flight.recording, problem.measurements, given=C)
    iterations = len(calibrate(flight.recording, initial=flight.initial, interval_covariance=C).corrections)
    arcs = problem.measurements.arcs
    A_start, A_obs = problem.A[problem.measurements.start], problem.A[problem.measurements.row]

    def residuals(x: Array) -> Array:
        R = run_packed(arcs, GyroParameters.from_vector(initial + x * SCALE)).R
        return np.asarray(accumulation.compute_attitude_residuals(R, A_start, A_obs)).ravel() / SIGMA

    def by_least_squares() -> Array:
        found: Any = least_squares(residuals, np.zeros(12), diff_step=DIFF_STEP)
        return np.asarray(initial + SCALE * found.x)

    return {"least_squares": by_least_squares, "davenport": lambda: np.asarray(weighted.iterate(initial, iterations).x[-1])}


def agreement(solutions: dict[str, Array]) -> float:
    """Largest difference in G between the two; an `AssertionError` if they are not the same solution."""
    difference = float(np.abs(solutions["least_squares"] - solutions["davenport"])[:9].max())
    if not difference < AGREEMENT:
        raise AssertionError(f"least squares and the calibrator differ by {difference:.1e} in G, more than {AGREEMENT:g}")
    return difference
