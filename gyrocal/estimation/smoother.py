"""The way back over a filter run: estimates from the measurements before and after, with the covariance between two times.

The fixed-interval smoother of Rauch, Tung and Striebel over the stops j of a run. With P_j after the measurement of stop j,
P⁻_{j+1} predicted for the next, and Φ the transition between them,

    C_j = P_j Φᵀ (P⁻_{j+1})⁻¹,    s_j = C_j s⁻_{j+1},    P_j|all = P_j + C_j (P_{j+1}|all − P⁻_{j+1}) C_jᵀ

where s_j takes the filter's estimate at stop j to the smoothed one, and s⁻_{j+1} the predicted estimate of the next stop to
its smoothed one. The errors of two stops a ≤ b have the covariance C_a … C_{b−1} P_b|all: reference attitudes from one
run share the bias and the measurements between them, and their errors correlate.

All of it is linear about the filter's way. An attitude that the filter starts with has an error of second order, θ²/2, which
the covariance does not know; where it is no longer small beside the noise of the measurements, start nearer.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal import attitude
from gyrocal.calibration.parameters import NAMES
from gyrocal.errors import InputError
from gyrocal.estimation.filter_run import FilterRun

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Smoothed:
    """Smoothed estimates at the requested times of a run.

    Attributes
    ----------
    t : (k,) s
    A : (k, 3, 3)
    x : (k, 12) G and b
    covariance : (k, n, k, n) joint covariance of the states (θ, Δx) at all of the times
    """

    t: Array
    A: Array
    x: Array
    covariance: Array

    @property
    def attitude_covariance(self) -> Array:
        """(3k, 3k) joint covariance of the attitude errors, rad²."""
        k = len(self.t)
        return np.asarray(self.covariance[:, :3, :, :3].reshape(3 * k, 3 * k))


def smooth(run: FilterRun) -> Smoothed:
    """Smooth a run that kept its history.

    Raises
    ------
    InputError
        It did not.
    """
    past = run.history
    if past is None:
        raise InputError("only a run with keep_history=True can be smoothed")
    n, k = run.covariance.shape[-1], len(run.t)
    columns = [NAMES.index(name) for name in run.names]
    requests = {int(stop): request for request, stop in enumerate(run.stops)}
    A, x, P = past.A_after[-1], past.x_after[-1].copy(), past.P_after[-1]
    out = Smoothed(run.t, np.empty((k, 3, 3)), np.empty((k, 12)), np.zeros((k, n, k, n)))
    carried: dict[int, Array] = {}  # covariance between the present stop and each later request
    for stop in range(len(past.A_after) - 1, -1, -1):
        if stop < len(past.A_after) - 1:
            Phi = np.vstack([past.Phi[stop + 1], np.eye(n)[3:]])
            scale = np.sqrt(np.diag(past.P_before[stop + 1]))
            scaled = past.P_before[stop + 1] / np.outer(scale, scale)
            C = np.linalg.solve(scaled, (Phi @ past.P_after[stop]) / scale[:, None]).T / scale
            state = np.concatenate([attitude.residual(A, past.A_before[stop + 1]), (past.x_before[stop + 1] - x)[columns]])
            state = C @ state
            A, x = attitude.rotation_matrix(state[:3]) @ past.A_after[stop], past.x_after[stop].copy()
            x[columns] -= state[3:]
            P = past.P_after[stop] + C @ (P - past.P_before[stop + 1]) @ C.T
            P = 0.5 * (P + P.T)
            carried = {request: C @ between for request, between in carried.items()}
        if stop in requests:
            request = requests[stop]
            out.A[request], out.x[request] = A, x
            carried[request] = P
            for later, between in carried.items():
                out.covariance[request, :, later] = between
                out.covariance[later, :, request] = between.T
    return out
