"""Smoothing of the errors between references that correlate in time, with time and memory linear in their number.

The errors between the start and the outputs that are no parameters form a Markov process. Its state s holds the gyro's
integrated noise w (three components, in the axes of the start) and each process of a calibration's remainder: e of the rates
and o of the references, which decay with time constants τ. Over a step Δt a unit of e turns the body by u. With x = Δt/τ,

    w_k = w_{k−1} + u ē + η,    e_k = e^{−x} e_{k−1} + ζ,    ē the mean of e over the step
    E(ē | e_{k−1}) = m e_{k−1},  m = (1 − e^{−x})/x,    var(ē | e_{k−1}) = σ² (V − m²),  V = 2 (1 − m)/x
    cov(ē, e_k | e_{k−1}) = σ² m (1 − e^{−x}),          var(e_k | e_{k−1}) = σ² (1 − e^{−2x})

Readings H s + ν of several right-hand sides are filtered forward: their innovations over the square root of the covariance are
L⁻¹ of the readings, with L the Cholesky factor of the readings' covariance. They are smoothed backward by the modified
Bryson–Frazier recursion (Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, chapter X), which inverts no
covariance of the state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal.arrays import Array, Indices
from gyrocal.calibration.remainder_processes import Process
from gyrocal.jit_cache import compile_cached
from gyrocal.small_matrices import compute_lower_root, solve_lower

DECAY_SERIES_LIMIT = 1e-4  # of x, below which series are exact to rounding


@dataclass(frozen=True)
class ErrorStates:
    """Steps of the state between the start and n outputs; q states follow the three of w."""

    turns: Array  # (n, 3, q) u, rad by a unit of each state; zero of those of references
    white: Array  # (n, 3, 3) covariance of η, rad²
    variance: Array  # (q,) σ² of each state
    # mean, decay: (n, q) m and e^{−x}
    mean: Array
    decay: Array
    mean_variance: Array  # (n, q) V − m²

    @classmethod
    def build(cls, turns: Array, steps_s: Array, arw: float, processes: Sequence[Process]) -> ErrorStates:
        """Build from the turns (n, 3, 12) by an error of each parameter over each step (n,), and the root PSD `arw`, rad/√s."""
        white = arw**2 * steps_s[:, None, None] * np.eye(3)
        columns, variance, tau = [np.zeros((*turns.shape[:2], 0))], [], []
        for process in processes:
            members = list(process.members)
            u = turns[:, :, members] if process.kind == "rate" else np.zeros((*turns.shape[:2], len(members)))
            if process.kind == "rate" and process.time_scale_s == 0:
                white = white + process.variance * (u @ u.transpose(0, 2, 1)) / steps_s[:, None, None]
                continue
            columns.append(u)
            variance += [process.variance] * len(members)
            tau += [process.time_scale_s] * len(members)
        with np.errstate(divide="ignore"):
            x = steps_s[:, None] / np.array(tau)
        safe = np.where((x > DECAY_SERIES_LIMIT) & np.isfinite(x), x, 1.0)
        mean = np.where(np.isinf(x), 0.0, np.where(x > DECAY_SERIES_LIMIT, -np.expm1(-safe) / safe, 1 - x / 2))
        spread = np.where(x > DECAY_SERIES_LIMIT, 2 * (1 - mean) / safe - mean**2, 2 * x / 3)
        return cls(np.concatenate(columns, axis=2), white, np.array(variance), mean, np.exp(-x), spread)

    @property
    def size(self) -> int:
        """Components of the state."""
        return 3 + self.variance.size

    def smooth(self, node: Indices, H: Array, noise: Array, readings: Array) -> tuple[Array, Array, Array]:
        """Smooth p right-hand sides of readings at nodes 0 (the start) to n.

        Parameters
        ----------
        node : (m,) of each reading, ascending
        H : (m, 3, states)
        noise : (m, 3, 3) covariance of ν
        readings : (m, 3, p)

        Returns
        -------
        (m, 3, p) L⁻¹ of the readings, (n + 1, states, p) the smoothed states, and their (n + 1, states, states) covariance
        """
        parts = (self.turns, self.white, self.variance, self.mean, self.decay, self.mean_variance)
        arrays = (np.ascontiguousarray(values, dtype=np.float64) for values in (*parts, H, noise, readings))
        white, states, covariance = _smooth(node.astype(np.intp), *arrays)
        return white, states, covariance


@compile_cached
def _build_step(turns, white, variance, mean, decay, mean_variance):  # type: ignore[no-untyped-def]
    """Build transition and covariance Q of one step."""
    size = 3 + variance.size
    step, Q = np.eye(size), np.zeros((size, size))
    Q[:3, :3] = white
    for j in range(variance.size):
        state, u = 3 + j, turns[:, j]
        step[state, state] = decay[j]
        Q[state, state] = variance[j] * (1 - decay[j] * decay[j])
        for a in range(3):
            step[a, state] = u[a] * mean[j]
            Q[a, state] = Q[state, a] = variance[j] * mean[j] * (1 - decay[j]) * u[a]
            for b in range(3):
                Q[a, b] += variance[j] * mean_variance[j] * u[a] * u[b]
    return step, Q


@compile_cached
def _smooth(  # type: ignore[no-untyped-def]
    node, turns, white, variance, mean, decay, mean_variance, H, noise, readings
):
    count, size, columns = len(turns) + 1, 3 + variance.size, readings.shape[2]
    P, x = np.zeros((size, size)), np.zeros((size, columns))
    for j in range(variance.size):
        P[3 + j, 3 + j] = variance[j]
    covariance, states = np.zeros((count, size, size)), np.zeros((count, size, columns))
    complement = np.zeros((len(node), size, size))  # I − K H
    white_H, innovations = np.zeros((len(node), 3, size)), np.zeros((len(node), 3, columns))
    row = 0
    for k in range(count):
        if k > 0:
            step, Q = _build_step(turns[k - 1], white[k - 1], variance, mean[k - 1], decay[k - 1], mean_variance[k - 1])
            x = step @ x
            P = step @ P @ step.T + Q
        while row < len(node) and node[row] == k:
            row_H = H[row]
            root = solve_lower(compute_lower_root(row_H @ P @ row_H.T + noise[row]), np.eye(3))
            white_H[row] = root @ row_H
            innovations[row] = root @ (readings[row] - row_H @ x)
            gain = P @ white_H[row].T
            K = gain @ root
            complement[row] = np.eye(size) - gain @ white_H[row]
            x = x + gain @ innovations[row]
            P = complement[row] @ P @ complement[row].T + K @ noise[row] @ K.T
            row += 1
        covariance[k], states[k] = P, x
    adjoint, adjoint_covariance = np.zeros((size, columns)), np.zeros((size, size))  # λ and Λ of Bryson and Frazier
    for k in range(count - 1, -1, -1):
        P = covariance[k].copy()
        states[k] -= P @ adjoint
        covariance[k] -= P @ adjoint_covariance @ P
        while row > 0 and node[row - 1] == k:
            row -= 1
            adjoint = complement[row].T @ adjoint - white_H[row].T @ innovations[row]
            adjoint_covariance = complement[row].T @ adjoint_covariance @ complement[row] + white_H[row].T @ white_H[row]
        if k > 0:
            step, _ = _build_step(turns[k - 1], white[k - 1], variance, mean[k - 1], decay[k - 1], mean_variance[k - 1])
            adjoint = step.T @ adjoint
            adjoint_covariance = step.T @ adjoint_covariance @ step
    return innovations, states, covariance
