"""The remainder: random errors of gyro and references beside the stated noise, and their sizes.

A real recording holds several effects and a part that no listed effect explains. Effects are judged in the presence of that
part. It is modelled as a sum of random processes (Kennedy and O'Hagan, Journal of the Royal Statistical Society B 63, 2001). In
the whitened observations y of `diagnosis.model.recording_model`, whose stated noise has the covariance I,

    y ~ N(0, C + B Bᵀ),    C = φ I + Σ_k θ_k K_k

B holds the columns of start attitudes, G, b and the listed effects, each in units of its prior. C consists of one
block for each interval. φ ≥ 1 inflates the stated noise. The K_k are Ornstein-Uhlenbeck processes: rate errors about each body
axis, rate errors in proportion to the rate, errors of the references about each body axis, and errors of the time tags. With
M = I + BᵀC⁻¹B,

    −2 log L = log |C| + log |M| + yᵀ Q y,    Q = C⁻¹ − C⁻¹B M⁻¹ BᵀC⁻¹
    ∂ log L/∂θ_k = ½ (yᵀ Q K_k Q y − tr Q K_k)

and the φ and θ of the largest likelihood are the sizes of the remainder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.linalg
import scipy.optimize
from numpy.typing import NDArray

from diagnosis.answer import Regressor, RemainderSummary
from diagnosis.model.folds import build_shared_columns
from diagnosis.model.recording_model import RecordingModel

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

AXES = "xyz"

# correlation times of the processes, in lengths of the median interval
GYRO_TIMES = (0.05, 1.0)
REFERENCE_TIMES = (0.02, 0.2)
START = 0.05  # share of the excess power that each process has where the optimisation starts
LEAST = 1e-6  # share of the power below which a process has the size zero
PRECISION = 1e-5  # relative change of −log L at which the optimisation ends
ITERATIONS = 60  # of the optimisation, at most

Side = Literal["gyro", "reference", "time tags"]


@dataclass(frozen=True)
class RemainderProcess:
    """One process of the remainder."""

    side: Side  # where it acts
    axis: str | None  # body axis; None for all of them together
    time_scale_s: float  # correlation time
    # of each interval (n, n) whitened covariance of its observations at unit variance, in (rad/s)², rad², s², or 1 for errors
    # in proportion to the rate
    blocks: tuple[Array, ...]


@dataclass(frozen=True)
class Remainder:
    """Sizes of the remainder."""

    noise: float  # φ, variance of the white noise relative to the stated one
    variances: Array  # (K,) θ of each process
    processes: tuple[RemainderProcess, ...]  # the processes
    log_likelihood: float  # log L, but for a constant of the recording


def build_processes(model: RecordingModel) -> tuple[RemainderProcess, ...]:
    """Build the processes that a remainder may consist of."""
    length = float(np.median([block.elapsed_s[-1] for block in model.blocks]))
    cells = model.cells
    steps = [block.steps.start + np.minimum(block.ends, block.steps.stop - block.steps.start - 1) for block in model.blocks]
    body_rates = model.rates[np.concatenate(steps)][model.reference_rows_of_observations]
    cell_rates = np.add.reduceat(model.rates * model.dt[:, None], cells.first, axis=0) / cells.duration_s[:, None]
    gyro = model.cell_columns
    reference = model.reference_columns
    late = np.einsum("anr,ra->nr", reference, body_rates)
    out = []
    for tau in np.array(GYRO_TIMES) * length:
        for axis, columns in zip(AXES, gyro, strict=True):
            out.append(RemainderProcess("gyro", axis, tau, _correlate(model, [columns], cells.t_s, cells.interval, tau)))
    follow = [columns * w for columns in gyro for w in cell_rates.T]
    out.append(RemainderProcess("gyro", None, tau, _correlate(model, follow, cells.t_s, cells.interval, tau)))
    at = (model.observation_t_s, model.observation_block)
    for tau in np.array(REFERENCE_TIMES) * length:
        for axis, columns in zip(AXES, reference, strict=True):
            out.append(RemainderProcess("reference", axis, tau, _correlate(model, [columns], *at, tau)))
        out.append(RemainderProcess("time tags", None, tau, _correlate(model, [late], *at, tau)))
    return tuple(out)


def _correlate(model: RecordingModel, columns: Sequence[Array], t_s: Array, owner: Indices, tau: float) -> tuple[Array, ...]:
    """Compute the whitened covariance (n, n) of each interval of errors at times (c,) that add columns (N, c) each."""
    blocks = []
    for number, block in enumerate(model.blocks):
        own = owner == number
        K = np.exp(-np.abs(np.subtract.outer(t_s[own], t_s[own])) / tau)
        parts = [one[block.rows][:, own] for one in columns]
        blocks.append(np.sum([part @ K @ part.T for part in parts], axis=0))
    return tuple(blocks)


def estimate_remainder(
    model: RecordingModel,
    processes: Sequence[RemainderProcess],
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
    y = model.whiten(model.zeta)
    B = np.hstack([build_shared_columns(model), effects])
    rows = [block.rows for block in model.blocks]
    traces = np.array([sum(float(np.trace(K)) for K in one.blocks) for one in processes])
    left = y - B @ np.linalg.lstsq(B, y, rcond=None)[0]
    power, dof = float(left @ left), max(y.size - B.shape[1], 1)
    unit = max(power, dof) / np.maximum(traces, 1e-300)
    high = max(float(np.log(power / dof)), 0.0)

    def objective(x: Array) -> tuple[float, Array]:
        return _compute_negative_log_likelihood(float(np.exp(x[0])), np.exp(x[1:]), y, B, rows, processes)

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
        objective,
        x,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": ITERATIONS, "ftol": PRECISION},
    )
    theta = np.exp(found.x[1:])
    theta = np.where(theta > 2 * LEAST * unit, theta, 0.0)
    return Remainder(float(np.exp(found.x[0])), theta, tuple(processes), -float(found.fun))


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


def _build_covariance(noise: float, theta: Array, processes: Sequence[RemainderProcess], number: int) -> Array:
    """Build C (n, n) of one interval."""
    blocks = [variance * process.blocks[number] for variance, process in zip(theta, processes, strict=True)]
    return np.sum([noise * np.eye(len(blocks[0])), *blocks], axis=0)


def _compute_negative_log_likelihood(
    noise: float, theta: Array, y: Array, B: Array, rows: Sequence[slice], processes: Sequence[RemainderProcess]
) -> tuple[float, Array]:
    """−log L and its gradient with respect to log φ and log θ, see the module."""
    Cy, CB = np.empty_like(y), np.empty_like(B)
    log_det, inverses = 0.0, []
    for number, own in enumerate(rows):
        C = _build_covariance(noise, theta, processes, number)
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
        C = _build_covariance(remainder.noise, remainder.variances, remainder.processes, number)
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
