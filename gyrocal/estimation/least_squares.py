"""Linear least squares for an attitude that a gyro carries along, its bias and sensor parameters, with or without the walk.

The gyro propagates an attitude from node to node, the nodes being all times at which something is measured or wanted. The
error of the attitude at node n, carried back to the first node by R_nᵀ, is

    γ_n = γ_0 + w_n,    w_n = Σ_{i<n} δw_i,    δw_i ~ N(0, q_i² I),    q_i² = ARW² Δt_i

since the white noise of the rates, taken along the body axes as in `gyrocal.calibration.covariance`, walks with independent
increments whatever rotation carries it. Together with the errors δ = (δb, δs) of bias and sensor parameters, true minus
estimate, the attitude error at node n is, in body axes, exp([θ×]) = A_true A_estᵀ with

    θ_n = R_n (γ_n − S_n δb),    S_n = R_nᵀ Θ_n of the bias columns, N (15)

and a measurement divided by its sigma has the residual z = a γ_n + c δ + η, η ~ N(0, 1).

*Plain* least squares solves for (γ_0, δ) as if the gyro had no white noise; this is what flight batches do. With X = [a, c],
P = (Xᵀ X)⁻¹, the error left after the last iteration is

    (γ_0, δ) = −P Xᵀ (η + a w)

so P is its covariance only without the walk; with it, the walk's part is added by its increments: δw_i enters every row
of a later node, hence −P Σ_{rows of nodes > i} Xᵀ a δw_i (a consider covariance).

*Exact* weighting takes the walk into the covariance of the residuals. The same estimate follows, without that dense matrix,
from one γ_n for each node and the increments as rows, 0 = (γ_{n+1} − γ_n + d_n)/q_n + noise, with d_n the increment already in
the estimate. The information matrix is then banded in γ, bordered by δ: one Cholesky of a band and a Schur complement. The
error is −Λ⁻¹ Jᵀ η over all rows.

Both give errors of anything wanted as a linear map of independent noises, `Influence`: that of the measurements, and that of
each increment of the walk. From it follow the correlations with other uses of the same gyro stream.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.sparse import csr_array

from gyrocal.arrays import Array, Indices


@dataclass(frozen=True)
class Rows:
    """Measurements divided by their sigma, linearised."""

    node: Indices  # (r,) node each was taken at
    attitude: Array  # (r, 3) a, per rad of γ at that node
    parameters: Array  # (r, p) c, per unit of δ; the bias's three columns first
    z: Array  # (r,) residuals

    @property
    def plain(self) -> Array:
        """X = [a, c], (r, 3 + p)."""
        return np.hstack([self.attitude, self.parameters])

    @property
    def chi2(self) -> float:
        """Σ z²."""
        return float(self.z @ self.z)

    def build_sums_at_nodes(self, count: int) -> csr_array:
        """Build Jᵀ (3 count, r) of the attitude columns: times (r, k), it sums the rows of each node."""
        places = (3 * self.node[:, None] + np.arange(3)).ravel(), np.repeat(np.arange(len(self.node)), 3)
        return csr_array((self.attitude.ravel(), places), shape=(3 * count, len(self.node)))


@dataclass(frozen=True)
class Influence:
    """Errors of J wanted numbers as a linear map of the noises."""

    measurements: Array  # (J, r) per sigma of each measurement
    walk: Array  # (N − 1, J, 3) per rad of the walk's increment between a node and the next


def map_corrections(nodes: Indices, bias_maps: Array, p: int) -> Array:
    """Map δ (p,) to δ and to γ_n − S_n δb at the nodes; (p + 3k, p)."""
    maps = np.zeros((3 * len(nodes), p))
    maps[:, :3] = -bias_maps.reshape(-1, 3)
    return np.vstack([np.eye(p), maps])


class PlainLeastSquares:
    """Least squares without the walk.

    rows: (r) measurements, count: number of nodes N
    """

    def __init__(self, rows: Rows, count: int):
        self._rows, self._count = rows, count
        X = rows.plain
        self._scale = 1 / np.sqrt(np.sum(X * X, axis=0))
        # By QR: the condition of X, not of its square, limits the solution.
        self._Q, self._R = np.linalg.qr(X * self._scale)

    @property
    def gain(self) -> Array:
        """P Xᵀ, (3 + p, r)."""
        return np.asarray(self._scale[:, None] * scipy.linalg.solve_triangular(self._R, self._Q.T))

    def step(self) -> tuple[Array, Array, float]:
        """Solve for corrections γ (N, 3) and δ (p,), and their length in sigmas."""
        projected = self._Q.T @ self._rows.z
        solution = self._scale * scipy.linalg.solve_triangular(self._R, projected)
        return np.tile(solution[:3], (self._count, 1)), solution[3:], float(np.linalg.norm(projected))

    def compute_influence(self, nodes: Indices, bias_maps: Array) -> Influence:
        """Compute how the noises map to the errors of δ and, at k nodes, of γ_n − S_n δb; J = p + 3k rows.

        nodes: (k,), bias_maps: (k, 3, 3) S_n there
        """
        rows = self._rows
        p = rows.parameters.shape[1]
        T = np.hstack(
            [np.vstack([np.zeros((p, 3)), np.tile(np.eye(3), (len(nodes), 1))]), map_corrections(nodes, bias_maps, p)]
        )
        errors = -T @ self.gain
        walk = accumulate_by_increment(rows, errors, self._count)
        for k, node in enumerate(nodes):
            walk[:node, p + 3 * k : p + 3 * k + 3] += np.eye(3)
        return Influence(errors, walk)


def accumulate_by_increment(rows: Rows, errors: Array, count: int) -> Array:
    """Convert errors (J, r) per unit residual to errors (N − 1, J, 3) per increment, which enters all later nodes."""
    at_node = (rows.build_sums_at_nodes(count) @ errors.T).reshape(count, 3, -1).transpose(0, 2, 1)
    return np.asarray(np.cumsum(at_node[:0:-1], axis=0)[::-1])


class ExactLeastSquares:
    """Least squares with the walk weighted as it correlates.

    rows: (r) measurements
    q : (N − 1,) sigma of each increment per axis, rad
    d : (N − 1, 3) increments in the present estimate, rad
    """

    def __init__(self, rows: Rows, q: Array, d: Array):
        self._rows, self._q, self._d = rows, q, d
        count = len(q) + 1
        self._scale = 1 / np.sqrt(np.sum(rows.parameters**2, axis=0))
        a, c = rows.attitude, rows.parameters * self._scale
        weight = 1 / q**2
        self._sums = rows.build_sums_at_nodes(count)
        diagonal = (self._sums @ a).reshape(count, 3, 3)
        diagonal += (np.append(weight, 0) + np.insert(weight, 0, 0))[:, None, None] * np.eye(3)
        band = np.zeros((4, count, 3))  # lower form of a symmetric band, as scipy stores it
        for offset in range(3):
            for i in range(3 - offset):
                band[offset, :, i] = diagonal[:, i + offset, i]
        band[3, :-1] = -weight[:, None]
        self._factor = scipy.linalg.cholesky_banded(band.reshape(4, -1), lower=True)
        self._border = self._sums @ c
        self._solved_border = self._solve_banded(self._border)
        self._schur = scipy.linalg.cho_factor(c.T @ c - self._border.T @ self._solved_border)

    def _solve_banded(self, right: Array) -> Array:
        return np.asarray(scipy.linalg.cho_solve_banded((self._factor, True), right))

    def _solve(self, right_nodes: Array, right_parameters: Array) -> tuple[Array, Array]:
        """Solve Λ⁻¹ of (3N, J) and (p, J) right-hand sides; scaled parameters."""
        parameters = scipy.linalg.cho_solve(self._schur, right_parameters - self._solved_border.T @ right_nodes)
        return self._solve_banded(right_nodes) - self._solved_border @ parameters, parameters

    def step(self) -> tuple[Array, Array, float]:
        """Solve as `PlainLeastSquares.step` does."""
        rows, count = self._rows, len(self._q) + 1
        right = (self._sums @ rows.z).reshape(count, 3)
        pull = -self._d / self._q[:, None] ** 2
        right[1:] += pull
        right[:-1] -= pull
        right_nodes, right_parameters = right.reshape(-1, 1), (rows.parameters * self._scale).T @ rows.z[:, None]
        nodes, parameters = self._solve(right_nodes, right_parameters)
        square = np.vdot(nodes, right_nodes) + np.vdot(parameters, right_parameters)
        return nodes.reshape(count, 3), self._scale * parameters[:, 0], float(np.sqrt(max(square, 0.0)))

    def compute_influence(self, nodes: Indices, bias_maps: Array) -> Influence:
        """Compute as `PlainLeastSquares.compute_influence` does."""
        rows, count, p = self._rows, len(self._q) + 1, len(self._scale)
        J = p + 3 * len(nodes)
        right_nodes = np.zeros((3 * count, J))
        for k, node in enumerate(nodes):
            right_nodes[3 * node : 3 * node + 3, p + 3 * k : p + 3 * k + 3] = np.eye(3)
        right_parameters = map_corrections(nodes, bias_maps, p).T * self._scale[:, None]
        solved, parameters = self._solve(right_nodes, right_parameters)
        by_node = solved.reshape(count, 3, J)
        errors = -np.einsum("ri,rij->jr", rows.attitude, by_node[rows.node])
        errors -= ((rows.parameters * self._scale) @ parameters).T
        walk = np.diff(by_node, axis=0) / self._q[:, None, None] ** 2
        return Influence(errors, np.asarray(walk.transpose(0, 2, 1)))

    def project(self, columns: Array) -> Array:
        """Compute products (k, k) of columns (r, k) of the rows, the attitude at all nodes and the parameters projected out."""
        by_node, by_parameter = self._sums @ columns, (self._rows.parameters * self._scale).T @ columns
        nodes, parameters = self._solve(by_node, by_parameter)
        out = columns.T @ columns - by_node.T @ nodes - by_parameter.T @ parameters
        return np.asarray((out + out.T) / 2)

    @property
    def walk_chi2(self) -> float:
        """Σ |d_n|²/q_n² of the increments in the estimate."""
        return float(np.sum((self._d / self._q[:, None]) ** 2))
