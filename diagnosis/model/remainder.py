"""The remainder: random errors of gyro and references beside the stated noise, and their sizes.

A real recording holds several effects and a part that no listed effect explains. Effects are judged in the presence of that
part. It is modelled as a sum of random processes (Kennedy and O'Hagan, Journal of the Royal Statistical Society B 63, 2001). In
the whitened observations y of `diagnosis.model.recording`, whose stated noise has the covariance I,

    y ~ N(0, C + B Bᵀ),    C = φ I + Σ_k θ_k K_k

B holds the columns of start attitudes, mountings, G, b and the listed effects, each in units of its prior. C consists of one
block for each interval. φ ≥ 1 inflates the stated noise. The K_k are Ornstein-Uhlenbeck processes: rate errors about each body
axis, rate errors in proportion to the rate, errors of the references about each body axis, and errors of the time tags. With
M = I + BᵀC⁻¹B,

    −2 log L = log |C| + log |M| + yᵀ Q y,    Q = C⁻¹ − C⁻¹B M⁻¹ BᵀC⁻¹
    ∂ log L/∂θ_k = ½ (yᵀ Q K_k Q y − tr Q K_k)

and the φ and θ of the largest likelihood are the sizes of the remainder.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.linalg
import scipy.optimize
from numpy.typing import NDArray

from diagnosis.answer import Regressor, RemainderSummary
from diagnosis.model.folds import shared_columns
from diagnosis.model.recording import Block, RecordingModel

Array = NDArray[np.float64]

AXES = "xyz"
GYRO_TIMES = (0.05, 1.0)  # correlation times of rate errors, in lengths of the median interval
REFERENCE_TIMES = (0.02, 0.2)  # the same of errors of the references
START = 0.05  # share of the excess power that each process has where the optimisation starts
LEAST = 1e-6  # share of the power below which a process has the size zero
PRECISION = 1e-5  # relative change of −log L at which the optimisation ends
ITERATIONS = 60

Side = Literal["gyro", "reference", "time tags"]


@dataclass(frozen=True)
class Process:
    """One process of the remainder.

    Attributes
    ----------
    side : where it acts
    axis : body axis; None for all of them together
    time_scale_s : correlation time
    blocks : of each interval (n, n) whitened covariance of its observations at unit variance
    unit : of the square root of its variance: rad/s, rad, s, or none for errors in proportion to the rate
    """

    side: Side
    axis: str | None
    time_scale_s: float
    blocks: tuple[Array, ...]
    unit: str


@dataclass(frozen=True)
class Remainder:
    """Sizes of the remainder.

    Attributes
    ----------
    noise : φ, variance of the white noise relative to the stated one
    variances : (K,) θ of each process
    processes : the processes
    log_likelihood : log L, but for a constant of the recording
    """

    noise: float
    variances: Array
    processes: tuple[Process, ...]
    log_likelihood: float


def build_processes(model: RecordingModel) -> tuple[Process, ...]:
    """Build the processes that a remainder may consist of."""
    return tuple(_build_processes(model))


def _build_processes(model: RecordingModel) -> Iterator[Process]:
    length = float(np.median([block.elapsed_s[-1] for block in model.blocks]))
    turned = [_cell_columns(model, number) for number in range(len(model.blocks))]
    for share in GYRO_TIMES:
        tau = share * length
        for axis in range(3):
            yield Process("gyro", AXES[axis], tau, _blocks(model, [_of_rates(own, axis, tau) for own in turned]), "rad/s")
    tau = GYRO_TIMES[-1] * length
    follow = [np.sum([_of_rates(own, axis, tau, w) for axis in range(3) for w in own.rates.T], axis=0) for own in turned]
    yield Process("gyro", None, tau, _blocks(model, follow), "")
    at = [_references(model, number) for number in range(len(model.blocks))]
    for share in REFERENCE_TIMES:
        tau = share * length
        for axis in range(3):
            errors = [_of_errors(t, A[:, :, axis], tau) for t, A, _ in at]
            yield Process("reference", AXES[axis], tau, _blocks(model, errors), "rad")
        yield Process("time tags", None, tau, _blocks(model, [_of_errors(t, w, tau) for t, _, w in at]), "s")


@dataclass(frozen=True)
class _Cells:
    """Cells of one interval: (3r, 3, c) observations of unit rate errors by body axis, (c,) times, (c, 3) rates."""

    columns: Array
    t_s: Array
    rates: Array


def _cell_columns(model: RecordingModel, number: int) -> _Cells:
    cells, block = model.cells, model.blocks[number]
    own = np.flatnonzero(cells.interval == number)
    turned = np.add.reduceat(model.to_inertial * model.dt[:, None, None], cells.first, axis=0)[own]  # (c, inertial, body)
    passed = model.passed[block.rows.start // 3 : block.rows.stop // 3][:, own]
    columns = np.einsum("rc,cib->ribc", passed, turned).reshape(3 * len(passed), 3, own.size)
    w = np.add.reduceat(model.rates * model.dt[:, None], cells.first, axis=0)[own] / cells.duration_s[own, None]
    return _Cells(columns, cells.t_s[own], w)


def _of_rates(cells: _Cells, axis: int, tau: float, weight: Array | None = None) -> Array:
    columns = cells.columns[:, axis] if weight is None else cells.columns[:, axis] * weight
    return np.asarray(columns @ _correlation(cells.t_s, tau) @ columns.T)


def _references(model: RecordingModel, number: int) -> tuple[Array, Array, Array]:
    """(r,) times of the observations of an interval, (r, 3, 3) Aᵀ, (r, 3) rates in inertial axes."""
    mine = model.observation_block == number
    t_s, A_T = model.observation_t_s[mine], model.observation_attitude[mine]
    block = model.blocks[number]
    steps = np.clip(block.ends[block.groups + block.counts // 2], 0, block.steps.stop - block.steps.start - 1)
    w = model.rates[block.steps][steps]
    return t_s, A_T, np.einsum("rij,rj->ri", A_T, w)


def _of_errors(t_s: Array, direction: Array, tau: float) -> Array:
    """(3r, 3r) covariance of errors along given directions (r, 3) with the correlation time tau."""
    K = _correlation(t_s, tau)
    return np.asarray(np.einsum("ri,rs,sj->risj", direction, K, direction).reshape(3 * t_s.size, 3 * t_s.size))


def _correlation(t_s: Array, tau: float) -> Array:
    return np.asarray(np.exp(-np.abs(np.subtract.outer(t_s, t_s)) / tau))


def _blocks(model: RecordingModel, covariances: Sequence[Array]) -> tuple[Array, ...]:
    """Whiten the covariances of all intervals by the stated noise."""
    return tuple(_whitened(block, K) for block, K in zip(model.blocks, covariances, strict=True))


def _whitened(block: Block, K: Array) -> Array:
    half = scipy.linalg.solve_triangular(block.whitener, K, lower=True, check_finite=False)
    return np.asarray(scipy.linalg.solve_triangular(block.whitener, half.T, lower=True, check_finite=False))


def estimate_remainder(
    model: RecordingModel,
    processes: Sequence[Process],
    effects: Array,
    start: Remainder | None = None,
    *,
    largest: Array | None = None,
) -> Remainder:
    """Estimate the sizes of the remainder by maximum likelihood.

    Parameters
    ----------
    model : the recording under the stated noise
    processes : of `build_processes` of the same model
    effects : (N, q) whitened columns of the listed effects in the model, in units of their priors
    start : sizes from which the optimisation starts
    largest : (K,) bounds of the variances where they are known; the white noise then is as stated
    """
    y = model.unmixed(model.whitened(model.zeta))
    B = np.hstack([shared_columns(model), model.unmixed(effects)])
    rows = [block.rows for block in model.blocks]
    traces = np.array([sum(float(np.trace(K)) for K in one.blocks) for one in processes])
    left = y - B @ np.linalg.lstsq(B, y, rcond=None)[0]
    power, dof = float(left @ left), max(y.size - B.shape[1], 1)
    unit = max(power, dof) / np.maximum(traces, 1e-300)
    high = max(float(np.log(power / dof)), 0.0)

    def objective(x: Array) -> tuple[float, Array]:
        return _negative_log_likelihood(float(np.exp(x[0])), np.exp(x[1:]), y, B, rows, processes)

    if start is None:
        excess = max(1.0 - dof / max(power, dof), 0.05)
        x = np.concatenate([[0.3 * high], np.log(START * excess * unit)])
    else:
        x = np.concatenate([[np.log(start.noise)], np.log(np.maximum(start.variances, 100 * LEAST * unit))])
    most = 10 * unit
    if largest is not None:
        x[0], high, most = 0.0, 0.0, np.maximum(np.minimum(most, largest), 2 * LEAST * unit)
        x[1:] = np.minimum(x[1:], np.log(most))
    bounds = [(0.0, high + 1e-9), *((np.log(LEAST * one), np.log(top)) for one, top in zip(unit, most, strict=True))]
    found = scipy.optimize.minimize(
        objective, x, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": ITERATIONS, "ftol": PRECISION}
    )
    theta = np.exp(found.x[1:])
    theta = np.where(theta > 2 * LEAST * unit, theta, 0.0)
    return Remainder(float(np.exp(found.x[0])), theta, tuple(processes), -float(found.fun))


def compute_log_likelihood(model: RecordingModel, remainder: Remainder, effects: Array) -> float:
    """Compute log L for given sizes of the remainder and other effects; parameters as of `estimate_remainder`."""
    y = model.unmixed(model.whitened(model.zeta))
    B, rows = np.hstack([shared_columns(model), model.unmixed(effects)]), [block.rows for block in model.blocks]
    value, _ = _negative_log_likelihood(remainder.noise, remainder.variances, y, B, rows, remainder.processes)
    return -value


def add_rounding(model: RecordingModel, steps: Array) -> RecordingModel:
    """Add to the noise of a model what readings leave that are rounded or cut to steps coarser than their noise.

    The error follows where the rate lies inside a step, which no reading shows: it may have any course. It is modelled by the
    processes of the gyro. A reading cut toward zero errs by up to a step, so that the mean square is a third of its square.

    Parameters
    ----------
    model : the recording under the stated noise
    steps : (3,) rad/s, steps of the readings about each axis that are coarser than the noise, else 0
    """
    processes = [one for one in build_processes(model) if one.side == "gyro" and one.axis and steps[AXES.index(one.axis)] > 0]
    largest = np.array([steps[AXES.index(str(one.axis))] ** 2 / 3 for one in processes])
    return add_remainder(model, estimate_remainder(model, processes, np.zeros((model.size, 0)), largest=largest))


def _negative_log_likelihood(
    noise: float, theta: Array, y: Array, B: Array, rows: Sequence[slice], processes: Sequence[Process]
) -> tuple[float, Array]:
    """−log L and its gradient with respect to log φ and log θ, see the module."""
    Cy, CB = np.empty_like(y), np.empty_like(B)
    log_det, inverses = 0.0, []
    for number, own in enumerate(rows):
        C = noise * np.eye(own.stop - own.start)
        for variance, process in zip(theta, processes, strict=True):
            C += variance * process.blocks[number]
        factor = scipy.linalg.cholesky(C, lower=True, check_finite=False, overwrite_a=True)
        log_det += 2 * float(np.log(np.diag(factor)).sum())
        inverse, _ = scipy.linalg.lapack.dpotri(factor, lower=1)
        inverse = np.tril(inverse) + np.tril(inverse, -1).T
        inverses.append(inverse)
        Cy[own], CB[own] = inverse @ y[own], inverse @ B[own]
    M = np.eye(B.shape[1]) + B.T @ CB
    small = scipy.linalg.cholesky(M, lower=True, check_finite=False)
    along = scipy.linalg.cho_solve((small, True), B.T @ Cy, check_finite=False)
    Qy = Cy - CB @ along
    half = scipy.linalg.solve_triangular(small, CB.T, lower=True, check_finite=False).T  # (N, q): CB M⁻¹ CBᵀ = half halfᵀ
    value = 0.5 * (log_det + 2 * float(np.log(np.diag(small)).sum()) + float(y @ Qy))
    slope = np.zeros(theta.size + 1)
    for number, own in enumerate(rows):
        Q, q = inverses[number] - half[own] @ half[own].T, Qy[own]
        slope[0] -= 0.5 * noise * (float(q @ q) - float(np.trace(Q)))
        for k, process in enumerate(processes):
            K = process.blocks[number]
            slope[1 + k] -= 0.5 * theta[k] * (float(q @ K @ q) - float(np.sum(Q * K)))
    return value, slope


def add_remainder(model: RecordingModel, remainder: Remainder) -> RecordingModel:
    """Build the model whose noise is the stated noise and the remainder together."""
    blocks = []
    for number, block in enumerate(model.blocks):
        C = remainder.noise * np.eye(len(block.whitener))
        for variance, process in zip(remainder.variances, remainder.processes, strict=True):
            C += variance * process.blocks[number]
        blocks.append(replace(block, whitener=block.whitener @ np.linalg.cholesky(C)))
    return replace(model, blocks=tuple(blocks))


def summarise_remainder(
    remainder: Remainder, share: float, interval_90: tuple[float, float], regressors: tuple[Regressor, ...]
) -> RemainderSummary:
    """Summarise the sizes of the remainder in the units of a user.

    Parameters
    ----------
    remainder : its sizes
    share, interval_90 : of the held-out misfit, and its 90 % interval
    regressors : what it follows
    """
    parts = list(zip(remainder.processes, remainder.variances, strict=True))

    def size(side: str, axis: str | None) -> float:
        return float(np.sqrt(sum(v for one, v in parts if (one.side, one.axis) == (side, axis))))

    power = {(one.side, one.time_scale_s): 0.0 for one in remainder.processes}
    for one, v in parts:
        power[one.side, one.time_scale_s] += float(v) * sum(float(np.trace(K)) for K in one.blocks)
    white = (remainder.noise - 1) * sum(len(K) for K in remainder.processes[0].blocks)
    (strongest, scale), most = max(power.items(), key=lambda item: item[1])
    side = str(strongest) if white < most else "white noise"
    scale = scale if white < most else 0.0
    return RemainderSummary(
        share, interval_90, tuple(float(np.rad2deg(size("gyro", axis))) * 3600 for axis in AXES),
        tuple(float(np.rad2deg(size("reference", axis))) for axis in AXES), size("time tags", None), size("gyro", None),
        float(np.sqrt(remainder.noise)), side, scale, regressors,
    )  # fmt: skip
