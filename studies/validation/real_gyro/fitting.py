"""Fit of G, b and further terms to some trials, and prediction of the attitude on another.

Least squares with M0's noise; predictions go from the first reference of every interval with motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal import Recording, attitude, propagate
from gyrocal.calibration.sampling import Measurements, measurements
from gyrocal.recording import reference_rows
from simulator.effects import EFFECTS
from simulator.effects.gyro import bias_drift, scale_asymmetry, scale_quadratic
from simulator.effects.recorded import stream_of
from studies.validation.real_gyro.ladder import LATE, Found, delayed, repaired
from studies.validation.real_gyro.trials import Loaded

Array = NDArray[np.float64]

ITERATIONS = 5
SETTLED = 0.1  # sigmas
NEAR_REFERENCE = 2  # samples on either side of one, for the rate there
FIRST_ORDER = 1e-6  # size of a column's step, in its unit
GRAVITY = 9.80665  # m/s²


@dataclass(frozen=True)
class Fitted:
    """G, b (rad/s), time offset (s) and amplitudes of further columns, with the sigma of the offset."""

    G: Array
    bias: Array
    offset: float
    offset_sigma: float
    amplitudes: Array


@dataclass(frozen=True)
class Further:
    """Columns tried beside the ladder's.

    Attributes
    ----------
    name : for people
    effect : of the list, about all three axes; "" for the specific force on all axes
    """

    name: str
    effect: str


TRIED = (
    *(Further(module.EFFECT.name, module.EFFECT.name) for module in (scale_asymmetry, scale_quadratic, bias_drift)),
    Further("bias that follows specific force", ""),
)


@dataclass(frozen=True)
class Linear:
    """Residuals of a recording and their derivatives.

    Attributes
    ----------
    parts : the arcs
    theta : (m, 3) rotation vectors of A_obs A_propᵀ, rad
    to_inertial : (m, 3, 3) A_propᵀ
    H : (m, 3, 13 + k) derivatives by G, b, offset and further columns
    """

    parts: Measurements
    theta: Array
    to_inertial: Array
    H: Array


def propagated(recording: Recording, G: Array, bias: Array) -> tuple[Measurements, Array, Array, Array, Array]:
    """The arcs, residuals (m, 3), propagated attitudes, rotations and Θ of a recording at G and b."""
    parts = measurements(recording)
    run = propagate(parts.arcs, G, bias)
    A = attitude.matrix_from_quaternion(recording.attitudes.quaternions)
    A_prop = run.R @ A[parts.start]
    return parts, attitude.residual(A[parts.row], A_prop), A_prop, run.R, run.Theta


def linearised(recording: Recording, G: Array, bias: Array, columns: Array | None = None) -> Linear:
    """Residuals at G and b, and what moves them; columns (n, 3, k) on the raw rates, rad/s."""
    parts, theta, A_prop, R, Theta = propagated(recording, G, bias)
    gyro = recording.gyro
    at = np.searchsorted(gyro.t_s, recording.attitudes.t_s + 1e-9) - 1
    low, high = np.maximum(at - NEAR_REFERENCE, 0), np.minimum(at + NEAR_REFERENCE + 1, len(gyro.t_s))
    total = np.vstack([np.zeros(3), np.cumsum(gyro.rates, axis=0)])
    rate = (total[high] - total[low]) / (high - low)[:, None] @ G.T + bias
    shift = rate[parts.row] - np.einsum("mij,mj->mi", R, rate[parts.start])
    H = [Theta, shift[:, :, None]]
    for k in range(0 if columns is None else columns.shape[2]):
        assert columns is not None
        moved = replace(recording, gyro=replace(gyro, rates=gyro.rates + FIRST_ORDER * columns[:, :, k]))
        H.append(((propagated(moved, G, bias)[1] - theta) / FIRST_ORDER)[:, :, None])
    return Linear(parts, theta, np.swapaxes(A_prop, 1, 2), np.concatenate(H, axis=2))


def whitened(linear: Linear, sigma: float, arw: float) -> tuple[Array, Array]:
    """Residuals (3m,) and derivatives (3m, p) with M0's noise: σ² at both ends, and the walk up to the earlier of two."""
    theta = np.einsum("mij,mj->mi", linear.to_inertial, linear.theta)
    H = linear.to_inertial @ linear.H
    z, X = [], []
    for start in np.unique(linear.parts.start):
        own = np.flatnonzero(linear.parts.start == start)
        t = linear.parts.elapsed_s[own]
        L = np.linalg.cholesky(sigma**2 * (np.eye(len(t)) + 1) + arw**2 * np.minimum.outer(t, t))
        z.append(np.linalg.solve(L, theta[own]).ravel())
        X.append(np.linalg.solve(L, H[own].reshape(len(t), -1)).reshape(3 * len(t), -1))
    return np.concatenate(z), np.concatenate(X)


def further_columns(loaded: Loaded, recording: Recording, further: Further | None) -> Array | None:
    """(n, 3, k) columns on the raw rates, in rad/s per unit that makes them about a ten-thousandth of the rates."""
    if further is None:
        return None
    if further.effect:
        stream = stream_of(recording, np.eye(3), np.zeros(3), smooth_s=0.0)
        effect = EFFECTS[further.effect]
        parts = [effect.columns(stream, axis, {}) for axis in "xyz"]
        return np.concatenate(parts, axis=2)
    force = (loaded.trial.force - loaded.trial.force[loaded.first_rest].mean(axis=0)) / GRAVITY * np.deg2rad(0.01)
    columns = np.zeros((len(force), 3, 9))
    for k in range(9):
        columns[:, k // 3, k] = force[:, k % 3]
    return columns


def fit(
    trials: Sequence[Loaded], rung: Sequence[str], found: Found, lag: bool = False, further: Further | None = None
) -> Fitted:
    """G, common b, time offset if it is of the rung, and further columns, by least squares over some trials."""
    recordings = [repaired(one, rung, found) for one in trials]
    columns = [further_columns(one, recording, further) for one, recording in zip(trials, recordings, strict=True)]
    extra = 0 if columns[0] is None else columns[0].shape[2]
    timed = LATE in rung
    free = np.array([*range(12), *([12] if timed else []), *range(13, 13 + extra)])
    x = np.concatenate([np.eye(3).ravel(), np.zeros(4 + extra)])
    sigma = np.zeros(13 + extra)
    for _ in range(ITERATIONS):
        information, right = np.zeros((free.size, free.size)), np.zeros(free.size)
        for recording, own in zip(recordings, columns, strict=True):
            linear = linearised(_moved(recording, x, own, lag), x[:9].reshape(3, 3), x[9:12], own)
            z, X = whitened(linear, rms(recording.attitudes.sigma), recording.gyro.arw)
            information += X[:, free].T @ X[:, free]
            right += X[:, free].T @ z
        scale = 1 / np.sqrt(np.diag(information))
        covariance = np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-9, hermitian=True) * np.outer(scale, scale)
        step = -covariance @ right
        x[free] += step
        sigma[free] = np.sqrt(np.diag(covariance))
        if np.abs(step / sigma[free]).max() < SETTLED:
            break
    return Fitted(x[:9].reshape(3, 3), x[9:12], float(x[12]), float(sigma[12]), x[13:])


def _moved(recording: Recording, x: Array, columns: Array | None, lag: bool) -> Recording:
    if columns is not None:
        rates = recording.gyro.rates + columns @ x[13:]
        recording = replace(recording, gyro=replace(recording.gyro, rates=rates))
    return delayed(recording, float(x[12]), lag) if x[12] else recording


def rms(values: Array) -> float:
    """Root mean square of all values."""
    return float(np.sqrt(np.mean(np.square(values))))


@dataclass(frozen=True)
class Prediction:
    """Errors of the predicted attitude of one interval: times (m,) s and rotation vectors (m, 3) deg in body axes."""

    interval: str
    t_s: Array
    error: Array

    @property
    def squares(self) -> tuple[float, float]:
        """Squared error at the interval's end and mean square over its references, deg²."""
        squares = np.square(self.error).sum(axis=1)
        return float(squares[-1]), float(squares.mean())


def predicted(
    loaded: Loaded, fitted: Fitted, rung: Sequence[str], found: Found, lag: bool = False, further: Further | None = None
) -> list[Prediction]:
    """The attitude over every interval with motion, from its first reference with parameters from elsewhere."""
    recording = repaired(loaded, rung, found)
    columns = further_columns(loaded, recording, further)
    x = np.concatenate([fitted.G.ravel(), fitted.bias, [fitted.offset], fitted.amplitudes])
    parts, theta, *_ = propagated(_moved(recording, x, columns, lag), fitted.G, fitted.bias)
    out = []
    for interval in loaded.recording.intervals:
        if interval.activity == "rest":
            continue
        rows = reference_rows(loaded.recording.attitudes.t_s, interval)
        own = np.flatnonzero(parts.start == rows[0])
        times = loaded.recording.attitudes.t_s[parts.row[own]]
        inside = own[(times > interval.start_s) & (times <= interval.stop_s + 1e-9)]
        times = loaded.recording.attitudes.t_s[parts.row[inside]]
        out.append(Prediction(interval.name, times, np.rad2deg(theta[inside])))
    return out
