"""Alignment calibration by Wahba's loss, R (2), with both of R's algorithms.

The loss is the square sum of all sensors' residuals, each divided by its sigma, along the attitude that the gyro carries from
the epoch. R writes it for observed vectors and weights W_i; here a Sun sensor's residuals are its two angles, an Earth
sensor's four penetration angles, since these are what the noise is in. Misalignments are rotations M, R (1), the Earth
sensor's is four penetration biases.

Algorithm 1, `align_together`
    Epoch attitude, gyro bias and misalignments m at once: a batch of `gyrocal.estimation.batch` with sensor parameters freed.
Algorithm 2, `align_in_two_steps`
    Attitude and bias with the sensors as they are; then the misalignments with that attitude fixed.

One sensor is the reference, its M held. R solves step two for all sensors and makes the reference's M the identity by turning
all sensors together. The same step two here has the reference's M held and a rotation κ of the attitude, constant in the body,
in its place: exp([κ×]) A and M_ref = I give the reference's residuals that A and its own M give.

Bias of two steps
    With the residuals z = X a + D m + noise, X of attitude and bias, and K = [H, D] of (κ, m), H = ∂z/∂κ, step one leaves
    (I − X X⁺) z, and step two finds the last q rows L of

        K⁺ (I − X X⁺)

    times z. As L X = 0, the estimate has the mean T m, T = L D, and not m: step one has already moved the attitude to please
    misaligned sensors, and only what it could not absorb is left. Repeating both steps from the sensors found leaves
    (I − T)^k of the error after k rounds, so that

        T_k = I − (I − T)^k,    L_k = Σ_{j<k} (I − T)^j L

    and at convergence T_∞ = I and L_∞ = T⁻¹ L, which is algorithm 1. The covariance of the estimate about its mean is
    L_k V L_kᵀ with V the covariance of z, gyro noise included: it holds the error of the attitude step, which used the same
    measurements. To take step two for itself, (DᵀD)⁻¹, would leave that out.

A rotation of all sensors together is an attitude error, R: with every sensor free nothing determines it. Free combinations are
the null space of the information, to within a threshold: the oblate Earth looks different in its four quadrants, which gives a
common rotation about yaw to some tenths of a degree. A rotation that is not determined to a tenth of a degree, the size of the
misalignments to be found, counts as free.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.special

from gyrocal.arrays import Array
from gyrocal.attitude import rotation_matrix
from gyrocal.errors import InputError
from gyrocal.estimation.arc import (
    Columns,
    Estimate,
    GyroArc,
    LinearisedMeasurements,
    build_gyro_arc,
    choose_columns,
    linearise,
    list_measured_times,
)
from gyrocal.estimation.batch import Weighting, batch, check_observable, find_free_directions, format_free_direction
from gyrocal.estimation.least_squares import accumulate_by_increment
from gyrocal.recording import GyroStream
from gyrocal.sensors.earth import EarthModel
from gyrocal.sensors.series import SensorModel, SensorSeries
from gyrocal.sensors.sun import SunModel

COMMON_PART = 0.1  # of the plausible ranges: 0.1° of attitude, 0.05° of a sensor, 1 deg/h of bias
SINGLE_ROTATION_SCATTER = 0.05  # scatter of an attitude change along the arc, relative to its size, that still is one rotation
MAX_STEPS = 20


@dataclass(frozen=True)
class AlignmentResult:
    """Result of an alignment calibration.

    Attributes
    ----------
    reference : name of the sensor whose M is held
    models : the sensor models with the parameters found
    names : (q,) solved-for parameters, "sensor parameter"
    covariance : (q, q) about the mean, rad²; of a rotation M the error is m in exp([m×]) M
    retained : (q, q) T_k, how much of the true parameters the mean of the estimate holds; the identity if unbiased
    epoch_s, attitude, bias : (3, 3) attitude at the epoch and (3,) rad/s, under the sensors found
    loss_after : square sum of the residuals in sigmas; with exact weights that of the gyro's noise too
    dof : degrees of freedom of loss_after
    rounds : how often both steps were made; 1 for all together
    unobservable : what the measurements leave free if no sensor is held, in words
    """

    reference: str
    models: tuple[SensorModel, ...]
    names: tuple[str, ...]
    covariance: Array
    retained: Array
    epoch_s: float
    attitude: Array
    bias: Array
    loss_after: float
    dof: int
    rounds: int
    unobservable: tuple[str, ...]

    @property
    def sigma(self) -> Array:
        """(q,) 1-sigma of each parameter, rad."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def misalignment(self) -> dict[str, Array]:
        """M (3, 3) of each Sun sensor."""
        return {model.name: model.sensor.misalignment for model in self.models if isinstance(model, SunModel)}

    @property
    def bias_deg_s(self) -> Array:
        """(3,) b, deg/s."""
        return np.asarray(np.rad2deg(self.bias))

    @property
    def penetration_biases(self) -> dict[str, Array]:
        """(4,) of each Earth sensor, rad."""
        return {model.name: model.sensor.biases for model in self.models if isinstance(model, EarthModel)}

    @property
    def p_value(self) -> float:
        """Probability of a larger loss after, if the noise is as stated; with plain weights, if the gyro has none."""
        return float(scipy.special.chdtrc(self.dof, self.loss_after))


def align_together(
    series: Sequence[SensorSeries],
    gyro: GyroStream,
    start: Array,
    reference: str,
    *,
    free: Mapping[str, Sequence[str]] | None = None,
    epoch_s: float | None = None,
    weighting: Weighting = "plain",
) -> AlignmentResult:
    """Solve for attitude, bias and misalignments at once, algorithm 1.

    Parameters
    ----------
    series, gyro, start, epoch_s, weighting : as of `gyrocal.estimation.batch.batch`; R's weights are the plain ones
    reference : name of the sensor whose alignment is held
    free : parameters to solve for by sensor; all of every other sensor by default

    Raises
    ------
    UnobservableError, InputError
        As `gyrocal.estimation.batch.batch`, or the reference is unknown or freed.
    """
    free = _select_free(series, reference, free)
    estimate = batch(series, gyro, start, free=free, epoch_s=epoch_s, weighting=weighting)
    q = len(estimate.names)
    return AlignmentResult(
        reference=reference,
        models=estimate.models,
        names=estimate.names,
        covariance=estimate.covariance[6:, 6:],
        retained=np.eye(q),
        epoch_s=estimate.epoch_s,
        attitude=estimate.attitude,
        bias=estimate.bias,
        loss_after=estimate.chi2,
        dof=estimate.dof,
        rounds=1,
        unobservable=_find_undetermined(series, gyro, estimate.models, estimate.epoch_s, estimate.attitude, estimate.bias),
    )


def align_in_two_steps(
    series: Sequence[SensorSeries],
    gyro: GyroStream,
    start: Array,
    reference: str,
    *,
    free: Mapping[str, Sequence[str]] | None = None,
    epoch_s: float | None = None,
    rounds: int | None = 1,
    tolerance: float = 1e-6,
    max_rounds: int = 500,
) -> AlignmentResult:
    """Solve for attitude and bias, then for misalignments with the attitude fixed, algorithm 2.

    Parameters
    ----------
    series, gyro, start, reference, free, epoch_s : as of `align_together`
    rounds : how often to make both steps, R: once; None to repeat until the misalignments stay within the tolerance
    tolerance, max_rounds : largest last change of a parameter in sigmas, and bound on the rounds to it

    Raises
    ------
    UnobservableError, InputError
        As `align_together`, or the repeated steps do not converge.
    """
    limit = max_rounds if rounds is None else rounds
    if limit < 1:
        raise InputError(f"at least one round is needed, not {limit}")
    solved = choose_columns(series, _select_free(series, reference, free))
    epoch = float(list_measured_times(series).min()) if epoch_s is None else float(epoch_s)
    path = build_gyro_arc(gyro, np.append(list_measured_times(series), epoch), gyro.apriori_G)
    epoch_node = path.find_nodes(np.array([epoch]))[0]
    attitude, corrected = start, tuple(series)
    for round_number in range(1, limit + 1):
        attitude_step = batch(corrected, gyro, attitude, epoch_s=epoch, weighting="plain")
        fixed = path.carry_back(epoch, attitude_step.attitude, attitude_step.bias, attitude_step.models)
        if round_number == 1:
            check_observable(linearise(path, series, fixed, solved).rows, fixed.C[0], solved.names)
        estimate, state, change = _solve_second_step(path, series, fixed, solved)
        attitude = state.R[epoch_node] @ estimate.C[epoch_node]
        corrected = tuple(
            replace(measurements, model=model) for measurements, model in zip(series, estimate.models, strict=True)
        )
        L = _step_gain(state)
        if np.abs(change / np.linalg.norm(L, axis=1)).max() <= tolerance:
            break
    else:
        if rounds is None:
            raise InputError(f"the two steps did not converge in {limit} rounds; solve for all together")
    gain, retained = _repeat_rounds(L, L @ state.rows.parameters[:, 3:], None if rounds is None else round_number)
    walk = accumulate_by_increment(state.rows, gain, len(path.t)) * path.q[:, None, None]
    walk_flat = walk.transpose(1, 0, 2).reshape(len(gain), -1)
    return AlignmentResult(
        reference=reference,
        models=estimate.models,
        names=solved.names,
        covariance=gain @ gain.T + walk_flat @ walk_flat.T,
        retained=retained,
        epoch_s=epoch,
        attitude=attitude,
        bias=estimate.bias,
        loss_after=state.rows.chi2,
        dof=len(state.rows.z) - 6 - len(solved.names),
        rounds=round_number,
        unobservable=_find_undetermined(series, gyro, estimate.models, epoch, attitude, estimate.bias),
    )


def _select_free(
    series: Sequence[SensorSeries], reference: str, free: Mapping[str, Sequence[str]] | None
) -> Mapping[str, Sequence[str]]:
    names = [measurements.model.name for measurements in series]
    if reference not in names:
        raise InputError(f"no measurements of the reference sensor {reference!r}; sensors: {', '.join(names)}")
    if free is None:
        free = {
            measurements.model.name: measurements.model.parameters
            for measurements in series
            if measurements.model.name != reference
        }
    if reference in free:
        raise InputError(f"{reference} is the reference, its alignment is held; free others only")
    if not any(len(parameters) for parameters in free.values()):
        raise InputError("no alignment is left to solve for; a sensor beside the reference is needed")
    return free


def _solve_second_step(
    path: GyroArc, series: Sequence[SensorSeries], estimate: Estimate, solved: Columns
) -> tuple[Estimate, LinearisedMeasurements, Array]:
    """Solve for misalignments with the attitude fixed but for κ: estimate, linearisation, and change of the parameters."""
    total = np.zeros(len(solved.names))
    for _ in range(MAX_STEPS):
        state = linearise(path, series, estimate, solved)
        step = np.asarray(np.linalg.lstsq(_step_columns(state), state.rows.z, rcond=None)[0], dtype=float)
        C = state.R.swapaxes(1, 2) @ rotation_matrix(step[:3]) @ state.R @ estimate.C
        estimate = replace(estimate, C=C, models=solved.correct_models(estimate.models, step[3:]))
        total += step[3:]
        if np.linalg.norm(_step_columns(state) @ step) <= 1e-6:
            break
    return estimate, linearise(path, series, estimate, solved), total


def _step_columns(state: LinearisedMeasurements) -> Array:
    """Build K = [H, D] (r, 3 + q)."""
    H = np.einsum("ri,rji->rj", state.rows.attitude, state.R[state.rows.node])
    return np.hstack([H, state.rows.parameters[:, 3:]])


def _step_gain(state: LinearisedMeasurements) -> Array:
    """Compute L (q, r), which maps residuals before step one to the misalignments of step two."""
    X = np.hstack([state.rows.attitude, state.rows.parameters[:, :3]])
    Q, _ = np.linalg.qr(X / np.linalg.norm(X, axis=0))
    gain = np.linalg.pinv(_step_columns(state))[3:]
    return np.asarray(gain - (gain @ Q) @ Q.T)


def _repeat_rounds(L: Array, T: Array, rounds: int | None) -> tuple[Array, Array]:
    """Compute L_k and T_k after so many rounds, or at convergence."""
    q = len(T)
    if rounds is None:
        return np.asarray(np.linalg.solve(T, L)), np.eye(q)
    total, remaining = np.zeros((q, q)), np.eye(q)
    for _ in range(rounds):
        total += remaining
        remaining = remaining @ (np.eye(q) - T)
    return np.asarray(total @ L), np.eye(q) - remaining


def _find_undetermined(
    series: Sequence[SensorSeries],
    gyro: GyroStream,
    models: tuple[SensorModel, ...],
    epoch: float,
    attitude: Array,
    bias: Array,
) -> tuple[str, ...]:
    """Find the free combinations if every parameter of every sensor is free."""
    path = build_gyro_arc(gyro, np.append(list_measured_times(series), epoch), gyro.apriori_G)
    solved = choose_columns(series, {measurements.model.name: measurements.model.parameters for measurements in series})
    estimate = path.carry_back(epoch, attitude, bias, models)
    state = linearise(path, series, estimate, solved)
    return _format_directions(find_free_directions(state.rows, COMMON_PART), state, estimate.C[0], solved.names)


def _format_directions(directions: Array, state: LinearisedMeasurements, C: Array, names: tuple[str, ...]) -> tuple[str, ...]:
    """Describe free directions (f, 3 + p): rotations constant along the arc as rotations of all sensors, others by name."""
    if not len(directions):
        return ()
    errors = directions[:, None, :3] - np.einsum("nij,fj->fni", state.S, directions[:, 3:6])
    theta = np.einsum("nij,fnj->fni", state.R, errors)  # attitude change by each direction at each node, body axes
    # Row k of axes is the axis of a mean rotation, and column k of mix combines the directions to a unit rotation about it.
    U, size, axes = np.linalg.svd(theta.mean(axis=1))
    rank = int(np.sum(size > 1e-3 * size[0])) if size[0] > 0 else 0
    mix = U[:, :rank] / size[:rank]
    if rank == 3:
        mix, axes = mix @ axes, np.eye(3)
    texts = []
    for k in range(rank):
        combined = np.einsum("f,fni->ni", mix[:, k], theta)
        if np.sqrt(np.mean(np.sum((combined - axes[k]) ** 2, axis=1))) < SINGLE_ROTATION_SCATTER:
            axis = "xyz"[k] if rank == 3 else "({:.3f}, {:.3f}, {:.3f})".format(*(axes[k] + 0.0))
            texts.append(f"a rotation of all sensors together about body {axis}")
        else:
            texts.append(format_free_direction(mix[:, k] @ directions, C, names))
    return (*texts, *(format_free_direction(U[:, k] @ directions, C, names) for k in range(rank, len(directions))))
