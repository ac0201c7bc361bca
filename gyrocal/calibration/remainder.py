"""Estimate the remainder of a calibration: the misfit beyond the stated noise, and the sigmas of G and b that hold with it.

Residuals of real recordings are larger than the stated noise. The remainder models the excess as random processes of the gyro,
of the references and of their time tags (`gyrocal.calibration.remainder_processes`), and as a factor φ of the variance of all
stated noise. Their sizes θ_k maximise the restricted likelihood of the residuals that the calibration leaves
(`gyrocal.calibration.variance_components`). The estimator of the calibration stays as it is. With V the stated covariance of
the residuals, Θ their sensitivity and P = (Θᵀ V⁻¹ Θ + P₀⁻¹)⁻¹,

    Δx̂ = P Θᵀ V⁻¹ θ = Kᵀ θ,    cov = P + (φ − 1) Kᵀ V K + Σ_k θ_k (M_kᵀ K)ᵀ ρ_k (M_kᵀ K)

with M_k the columns and ρ_k the correlation of each process. This sandwich covariance is that of the reported parameters.

Sizes are estimated from at most `MOST_RESIDUALS` of the residuals, evenly chosen, whose likelihood is exact by itself. The
influence M_kᵀ K needs no matrix of all residuals and is computed from all of them.

The time scales follow from the recording: from twice the spacing of the references to half the span, in steps of a factor of
`LEAST_RATIO` or more. With few degrees of freedom the axes share one size, and with very few only φ is estimated.

A remainder is significant where twice the gain of the log likelihood is improbable without one. Each size is zero with a
probability of one half then, so the gain follows a mixture of χ² distributions with 0 to K degrees of freedom (Self and Liang,
JASA 82, 1987). Processes of similar time scales are hardly told apart, so K is their effective number K²/Σ_kl r_kl², r_kl the
correlation of their scores, tr(C_k C_l)/√(tr C_k² tr C_l²) of the covariances C_k in the residuals. Where the remainder is not
significant the covariance stays the nominal one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg
import scipy.special

from gyrocal.arrays import Array, Indices
from gyrocal.calibration.gyro_space import select_parameter_space
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.propagation import propagate
from gyrocal.calibration.remainder_processes import (
    BIAS_INDICES,
    CORRELATION_BLOCK_ROWS,
    MISALIGNMENT_INDICES,
    SCALE_FACTOR_INDICES,
    SIGNIFICANT,
    Process,
    Remainder,
    Stretches,
    compute_turns,
    correlate_references,
)
from gyrocal.calibration.sampling import prepare_measurements
from gyrocal.calibration.variance_components import VarianceComponents, estimate_variance_components
from gyrocal.recording import GyroStream, Recording

if TYPE_CHECKING:
    from gyrocal.calibration.result import CalibrationResult


MOST_RESIDUALS = 150  # references that sizes are estimated from; time grows with the cube
LEAST_RATIO = 3.0  # of successive time scales; residuals do not separate closer ones
MOST_TIME_SCALES = 3
FEWEST_FOR_AXES = 120  # degrees of freedom, from which each axis has a size of its own
FEWEST_FOR_PROCESSES = 30  # degrees of freedom, below which only the factor of the noise is estimated
LEAST_VISIBLE = 0.05  # share of a process's power in the residuals; below it the calibration takes it up, unseen
NEGLIGIBLE = 0.003  # power of a process in the residuals relative to that of the stated noise; a smaller one is left out
SINGULAR_VALUE_TOLERANCE = 1e-9  # of singular values and eigenvalues, relative to the largest: below it they are rounding


def add_remainder(recording: Recording, result: CalibrationResult) -> CalibrationResult:
    """Return the calibration with its remainder estimated.

    Returns the result as it was, without a remainder, where a covariance was given: its residuals have other covariances.
    """
    if result.covariance_model == "given":
        return result
    options = result.options
    prepared = prepare_measurements(recording, options["step_s"], options["resampling"], options["max_gap_s"])
    names, psi, space = result.solved_for, result.psi, result.parametrisation
    model = "full" if result.covariance_model == "full" else "references only"
    problem = Problem.build(recording, prepared, names, psi, model, parametrisation=space)  # type: ignore[arg-type]
    return replace(result, remainder=estimate_remainder(recording, problem, result))


def estimate_remainder(recording: Recording, problem: Problem, result: CalibrationResult) -> Remainder:
    """Estimate the processes of a remainder, and the covariance of the parameters with them."""
    state = problem.state(result.parameters)
    paths = build_paths(recording, problem, result)
    columns = problem.columns
    scaled = result.own_covariance[np.ix_(columns, columns)] / problem.scale[:, None]  # D⁻¹ P
    nominal = result.covariance
    subset = paths.select(choose_evenly(paths.row.size, MOST_RESIDUALS))
    J = select_parameter_space(problem.parametrisation).jacobian(result.parameters)
    sizes, processes, dof, effective = _estimate_sizes(
        subset, state.theta[subset.places], subset.Theta.reshape(-1, 12) @ J[:, columns], problem
    )
    p_value = compute_p_value(sizes.log_likelihood_gain, effective + 1) if dof > 0 else 1.0
    if p_value >= SIGNIFICANT:
        return Remainder((), 1.0, sizes.log_likelihood_gain, p_value, nominal)
    estimated = tuple(
        replace(process, variance=float(v)) for process, v in zip(processes, sizes.variances, strict=True) if v > 0
    )
    white = state.H @ scaled  # L⁻¹ Θ P = Lᵀ K
    K = _undo_whitening(problem, paths.R, white)
    excess = (sizes.noise - 1.0) * white.T @ white + _propagate_processes(paths, estimated, K)
    excess_of_twelve = np.zeros((12, 12))
    excess_of_twelve[np.ix_(columns, columns)] = excess
    covariance = nominal + J @ excess_of_twelve @ J.T
    return Remainder(estimated, sizes.noise, sizes.log_likelihood_gain, p_value, np.asarray(0.5 * (covariance + covariance.T)))


@dataclass(frozen=True)
class Paths:
    """Propagation of errors to the residuals of a calibration."""

    places: Indices  # (m,) of these residuals among all
    # R, Theta: (m, 3, 3) and (m, 3, 12), from the start of the interval to each
    R: Array
    Theta: Array
    # interval, start, row: (m,) interval, and rows of the references that each starts from and is compared with
    interval: Indices
    start: Indices
    row: Indices
    reference_s: Array  # (references,) time of each reference, s
    body_rates: Array  # (references, 3) body rate at each, rad/s

    def select(self, places: Indices) -> Paths:
        """Select some of the residuals."""
        names = ("places", "R", "Theta", "interval", "start", "row")
        return replace(self, **{name: getattr(self, name)[places] for name in names})

    @cached_property
    def turns(self) -> Array:
        """(m, 3, 12) turns by errors that last from one residual to the next."""
        return compute_turns(self.R, self.Theta, self.interval)

    @cached_property
    def stretches(self) -> Stretches:
        """Time from the residual before, or from the start of the interval, to each residual."""
        to_s = self.reference_s[self.row]
        previous = np.roll(to_s, 1)
        first = np.append(True, self.interval[1:] != self.interval[:-1])
        return Stretches(np.where(first, self.reference_s[self.start], previous), to_s, self.interval)

    @cached_property
    def reference_numbers(self) -> Indices:
        """(n,) rows of the references that the residuals start from or are compared with."""
        return np.unique(np.concatenate([self.start, self.row]))

    def compute_process_influence(self, process: Process, member: int, K: Array) -> Array:
        """Compute Mᵀ K (n, p), with M (3m, n) the residuals by each value of one member of a process, K (3m, p).

        Values are errors of a parameter in each stretch, or errors of each used reference.
        """
        K = K.reshape(len(self.R), 3, -1)
        at_start = np.einsum("aji,ajp->aip", self.R, K)
        if process.kind == "rate":
            summed = np.empty_like(at_start)
            for interval in np.unique(self.interval):
                rows = self.interval == interval
                summed[rows] = at_start[rows][::-1].cumsum(axis=0)[::-1]
            return np.asarray(np.einsum("li,lip->lp", self.turns[:, :, member], summed))
        direction = self.body_rates if process.kind == "delay" else np.tile(np.eye(3)[member], (self.reference_s.size, 1))
        influence = np.zeros((self.reference_numbers.size, K.shape[2]))
        np.add.at(influence, np.searchsorted(self.reference_numbers, self.row), np.einsum("ai,aip->ap", direction[self.row], K))
        np.add.at(
            influence,
            np.searchsorted(self.reference_numbers, self.start),
            -np.einsum("ai,aip->ap", direction[self.start], at_start),
        )
        return influence

    def compute_process_covariance(self, process: Process, rows: slice = slice(None)) -> Array:
        """Compute the covariance (rows, n) of the values of a process of unit variance."""
        if process.kind == "rate":
            return self.stretches.covariance(process, rows)
        times = self.reference_s[self.reference_numbers]
        return correlate_references(process, times[rows], times)


def build_paths(recording: Recording, problem: Problem, result: CalibrationResult) -> Paths:
    """Describe how errors reach the residuals at the calibrated parameters."""
    measurements, parameters = problem.measurements, result.parameters
    run = propagate(measurements.arcs, parameters.G, parameters.bias)
    rates = interpolate_rates(recording.gyro, parameters.G, parameters.bias, recording.attitudes.t_s)
    places = np.arange(measurements.row.size)
    return Paths(
        places, run.R, run.Theta, measurements.arcs.arc, measurements.start, measurements.row, recording.attitudes.t_s, rates
    )


def interpolate_rates(gyro: GyroStream, G: Array, bias: Array, t_s: Array) -> Array:
    """Interpolate the body rate (n, 3) at some times, rad/s; a sample holds from its tag on and counts for its middle."""
    rates = gyro.rates @ G.T + bias
    middle = gyro.t_s + 0.5 * gyro.sample_s
    return np.column_stack([np.interp(t_s, middle, rates[:, k]) for k in range(3)])


def choose_evenly(count: int, most: int) -> Indices:
    """Choose at most so many of `count` places, evenly, the last one included."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.intp))


def choose_time_scales(stretches: Stretches) -> tuple[float, ...]:
    """Choose the finite time scales that some stretches can resolve, s, ascending."""
    low = 2.0 * float(np.median(stretches.to_s - stretches.from_s))
    high = max(0.5 * float(stretches.to_s.max() - stretches.from_s.min()), low)
    count = int(np.clip(1 + np.floor(np.log(high / low) / np.log(LEAST_RATIO)), 1, MOST_TIME_SCALES))
    return tuple(float(value) for value in (np.geomspace(low, high, count) if count > 1 else [low]))


def list_processes(scales: Sequence[float], dof: int) -> tuple[Process, ...]:
    """List the processes, of unit variance, whose sizes so many degrees of freedom may determine; finite scales ascend, s."""
    if dof < FEWEST_FOR_PROCESSES:
        return ()
    middle = scales[len(scales) // 2]
    by_axis = dof >= FEWEST_FOR_AXES
    biases = [(k,) for k in BIAS_INDICES] if by_axis else [BIAS_INDICES]
    axes = [(k,) for k in range(3)] if by_axis else [(0, 1, 2)]
    rates = [Process("rate", members, scale) for members in biases for scale in (0.0, *scales, np.inf)]
    diagonal = [(k,) for k in SCALE_FACTOR_INDICES] if by_axis else [SCALE_FACTOR_INDICES]
    gains = [
        Process("rate", members, scale) for members in (*diagonal, MISALIGNMENT_INDICES) for scale in (0.0, *scales, np.inf)
    ]
    references = [Process("reference", members, scale) for members in axes for scale in (0.0, *scales[-2:])]
    delays = [Process("delay", (0,), scale) for scale in (0.0, middle, np.inf)]
    return (*rates, *gains, *references, *delays)


def compute_p_value(gain: float, components: int) -> float:
    """Compute the probability of a larger gain of the log likelihood if all true sizes are zero."""
    counts = np.arange(1, components + 1)
    weights = scipy.special.binom(components, counts) * 0.5**components
    return float(weights @ scipy.special.chdtrc(counts, 2 * max(gain, 0.0)))


def count_effective(components: Sequence[Array]) -> int:
    """Count the components (N, r_k) that residuals can separate, by the correlation of their covariances."""
    if not components:
        return 0
    kernels = np.array([(part @ part.T).ravel() for part in components])
    products = kernels @ kernels.T
    size = np.sqrt(np.diag(products))
    return int(np.ceil(len(components) ** 2 / np.square(products / np.outer(size, size)).sum()))


def _estimate_sizes(
    paths: Paths, theta: Array, Theta: Array, problem: Problem
) -> tuple[VarianceComponents, tuple[Process, ...], int, int]:
    """Estimate sizes from residuals theta (m, 3), rad; with their processes, the degrees of freedom and `count_effective`."""
    L = np.linalg.cholesky(problem.covariance(paths.R, paths.places))

    def whiten(values: Array) -> Array:
        return np.asarray(scipy.linalg.solve_triangular(L, values, lower=True, check_finite=False))

    Q = _compute_basis(whiten(Theta))
    dof = theta.size - Q.shape[1]
    y = whiten(theta.ravel())
    y = y - Q @ (Q.T @ y)
    processes, components = _select_visible_processes(paths, dof, Q, whiten)
    sizes = estimate_variance_components(y, components, max(dof, 1))
    power = sizes.variances * np.array([np.square(part).sum() for part in components])
    sizes = replace(sizes, variances=np.where(power > NEGLIGIBLE * dof, sizes.variances, 0.0))
    return sizes, processes, dof, count_effective(components)


def _select_visible_processes(
    paths: Paths, dof: int, Q: Array, whiten: Callable[[Array], Array]
) -> tuple[tuple[Process, ...], list[Array]]:
    """Select the processes that the calibration does not take up, and their columns (N, r) in the whitened residuals.

    Q: (N, r) orthonormal basis of the whitened sensitivities, which is projected out of the columns
    whiten: L⁻¹ of columns (N, k)
    """
    columns: dict[tuple[str, int], Array] = {}
    roots: dict[tuple[bool, float], Array] = {}
    processes, components = [], []
    for process in list_processes(choose_time_scales(paths.stretches), dof):
        key = (process.kind == "rate", process.time_scale_s)
        if key not in roots:
            roots[key] = _compute_correlation_root(paths.compute_process_covariance(process))
        parts = []
        for member in process.members:
            if (process.kind, member) not in columns:
                influence = paths.compute_process_influence(process, member, np.eye(len(Q)))
                columns[process.kind, member] = whiten(influence.T)
            parts.append(columns[process.kind, member] @ roots[key])
        full = np.hstack(parts)
        visible = full - Q @ (Q.T @ full)
        if np.square(visible).sum() > LEAST_VISIBLE * np.square(full).sum():
            processes.append(process)
            components.append(visible)
    return tuple(processes), components


def _propagate_processes(paths: Paths, processes: Sequence[Process], K: Array) -> Array:
    """Compute Σ θ (Mᵀ K)ᵀ ρ (Mᵀ K), (p, p), with K (3m, p) residual by residual."""
    total = np.zeros((K.shape[1], K.shape[1]))
    for process in processes:
        for member in process.members:
            influence = paths.compute_process_influence(process, member, K)
            for low in range(0, len(influence), CORRELATION_BLOCK_ROWS):
                rows = slice(low, low + CORRELATION_BLOCK_ROWS)
                total += process.variance * influence[rows].T @ (paths.compute_process_covariance(process, rows) @ influence)
    return total


def _undo_whitening(problem: Problem, R: Array, white: Array) -> Array:
    """Multiply (3m, p) group by group by L⁻ᵀ, with V = L Lᵀ; the result is residual by residual."""
    out = np.empty_like(white)
    rows, ends = problem.groups
    low = 0
    for high in ends:
        members = rows[low:high]
        L = np.linalg.cholesky(problem.covariance(R[members], members))
        places = (3 * members[:, None] + np.arange(3)).ravel()
        out[places] = scipy.linalg.solve_triangular(L, white[3 * low : 3 * high], lower=True, trans="T")
        low = high
    return out


def _compute_basis(H: Array) -> Array:
    """Compute an orthonormal basis (N, r) of the columns of H."""
    size = np.linalg.norm(H, axis=0)
    U, s, _ = np.linalg.svd(H[:, size > 0] / size[size > 0], full_matrices=False)
    return np.asarray(U[:, s > SINGULAR_VALUE_TOLERANCE * s[0]])


def _compute_correlation_root(C: Array) -> Array:
    """Compute Z (n, r) of a correlation matrix C = Z Zᵀ."""
    values, vectors = np.linalg.eigh(C)
    positive = values > SINGULAR_VALUE_TOLERANCE * values[-1]
    return np.asarray(vectors[:, positive] * np.sqrt(values[positive]))
