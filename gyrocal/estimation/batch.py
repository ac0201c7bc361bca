"""Reference attitudes by batch least squares: epoch attitude and gyro bias from any sensors and the gyro.

R takes its reference attitudes from a batch over an orbit or an arc of constant rate: the gyro, with G held, carries one
epoch attitude to every measurement, and attitude and bias are found that fit all measurements best. While the rate is
constant an error of G acts as a bias, R (8), and the attitude does not suffer. The linear algebra is in
`gyrocal.estimation.least_squares`, the nodes in `gyrocal.estimation.arc`; here Gauss and Newton's iteration is run to
convergence, and the errors of the estimates are propagated to the wanted times.

Two weightings:

"plain"
    Each measurement by its own sigma and no noise of the gyro: the batch of the flight. The attitude at a wanted time is that
    of the epoch, carried by the gyro.
"exact"
    The angle random walk weighted as it correlates the residuals, the best linear estimate. The attitude at a wanted time is
    smoothed. With a Kalman filter that is run back and forth it shares the answer.

The covariance of the plain estimate holds what the gyro's noise does to it. The formal one, (Xᵀ X)⁻¹, would be far too small
once the gyro noise gathered over the batch is comparable with the attitude error.

Errors are true minus estimate: exp([θ×]) = A_true A_estᵀ in body axes at the time of the attitude.

What the measurements leave free is found as in `gyrocal.calibration.observability`: columns are scaled by a plausible range of
each unknown, and below a singular value of one the range is narrower than the sigma by the data. One Sun direction
leaves the rotation about it; with every sensor's alignment free, a rotation of all of them goes unnoticed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.linalg
import scipy.special
from numpy.typing import NDArray

from gyrocal.arrays import Array
from gyrocal.attitude import residual, rotation_matrix
from gyrocal.calibration.observability import OBSERVABILITY_RANK_TOLERANCE, PLAUSIBLE_BIAS
from gyrocal.calibration.parameters import BIAS_NAMES
from gyrocal.errors import InputError, UnobservableError
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
from gyrocal.estimation.least_squares import ExactLeastSquares, Influence, PlainLeastSquares, Rows
from gyrocal.recording import GyroStream
from gyrocal.sensors.series import SensorModel, SensorSeries

Weighting = Literal["exact", "plain"]

# The band's condition is 4 N² over the square of the walk in sigmas: below, rounding costs more than plain weights do.
NEGLIGIBLE_WALK = 1e-3  # in sigmas of all measurements together, times the root of the number of nodes
PLAUSIBLE_ATTITUDE = float(np.deg2rad(1.0))
PLAUSIBLE_SENSOR = float(np.deg2rad(0.5))  # a misalignment or a penetration bias
NAMED_SHARE = 0.01  # of its plausible range, below which an unknown is not named


@dataclass(frozen=True)
class Errors:
    """Errors of J numbers a batch found, by their sources."""

    measurements: Array  # (J, J) covariance by the measurements' noise
    t_s: Array  # (N,) nodes of the batch, s
    walk: Array  # (N − 1, J, 3) error per rad that the gyro's noise adds between a node and the next, in inertial axes
    arw: float  # rad/sqrt(s)

    @property
    def covariance(self) -> Array:
        """(J, J) of all together."""
        weighted = self.walk * (self.arw * np.sqrt(np.diff(self.t_s)))[:, None, None]
        flat = weighted.transpose(1, 0, 2).reshape(len(self.measurements), -1)
        return np.asarray(self.measurements + flat @ flat.T)


@dataclass(frozen=True)
class BatchResult:
    """Result of a batch estimate.

    Attributes
    ----------
    epoch_s : time of `attitude`
    attitude : (3, 3) inertial to body at the epoch
    bias : (3,) rad/s
    models : the sensor models, with the parameters found
    names : (q,) solved-for sensor parameters, "sensor parameter"
    covariance : (6 + q, 6 + q) of attitude at the epoch (rad, body axes), bias (rad/s) and sensor parameters
    t_s : (k,) wanted times
    attitudes : (k, 3, 3) there
    joint : (6 + q + 3k, 6 + q + 3k) covariance of all of the above, the attitudes last
    errors : the same by source
    residuals : of each series (n, m), measured minus predicted; NaN where not used
    chi2, dof : weighted square sum and degrees of freedom; with "plain" weights chi2 is not that of χ² where the gyro is noisy
    iterations : how many it took
    """

    epoch_s: float
    attitude: Array
    bias: Array
    models: tuple[SensorModel, ...]
    names: tuple[str, ...]
    covariance: Array
    t_s: Array
    attitudes: Array
    joint: Array
    errors: Errors
    residuals: tuple[Array, ...]
    chi2: float
    dof: int
    iterations: int

    @property
    def bias_deg_s(self) -> Array:
        """(3,) b, deg/s."""
        return np.asarray(np.rad2deg(self.bias))

    @property
    def attitude_covariance(self) -> Array:
        """(3k, 3k) of the attitudes at the wanted times, which correlate through epoch, bias and gyro noise; rad²."""
        return self.joint[len(self.covariance) :, len(self.covariance) :]

    @property
    def attitude_sigma(self) -> Array:
        """(k, 3) of each wanted attitude by itself, rad."""
        return np.asarray(np.sqrt(np.diag(self.attitude_covariance)).reshape(-1, 3))

    @property
    def p_value(self) -> float:
        """Probability of a larger chi2 if the noise is as stated; NaN without degrees of freedom."""
        return float(scipy.special.chdtrc(self.dof, self.chi2)) if self.dof > 0 else float("nan")


def batch(
    series: Sequence[SensorSeries],
    gyro: GyroStream,
    start: Array,
    *,
    epoch_s: float | None = None,
    times: Sequence[float] | Array = (),
    free: Mapping[str, Sequence[str]] | None = None,
    weighting: Weighting = "exact",
    max_iterations: int = 20,
    tolerance: float = 1e-6,
) -> BatchResult:
    """Estimate epoch attitude and gyro bias, and sensor parameters if asked, from an arc of measurements.

    Parameters
    ----------
    series : measurements of each sensor
    gyro : raw rates; its a-priori G is held, its a-priori bias is started from
    start : (3, 3) attitude at the epoch, within some degrees
    epoch_s : s; the first measurement by default
    times : (k,) s at which attitudes are wanted, before, among or after the measurements
    free : names of sensor parameters to solve for, by name of the sensor
    weighting : see the module
    max_iterations, tolerance : of Gauss and Newton's iteration; the last correction in sigmas

    Raises
    ------
    UnobservableError
        The measurements leave an attitude or another combination free; its direction is named.
    InputError
        Too few measurements, a gyro stream that does not cover them, or no convergence.
    """
    if np.shape(start) != (3, 3) or not np.allclose(start @ np.transpose(start), np.eye(3), atol=1e-6):
        raise InputError("the start attitude must be a rotation matrix, 3×3, inertial to body")
    solved = choose_columns(series, free or {})
    measured = list_measured_times(series)
    if not measured.size:
        raise InputError("a batch needs measurements; there are none to be used")
    epoch = float(measured.min()) if epoch_s is None else float(epoch_s)
    wanted = np.asarray(times, dtype=float)
    path = build_gyro_arc(gyro, np.concatenate([measured, [epoch], wanted]), gyro.apriori_G)
    starting_estimate = path.carry_back(epoch, start, gyro.apriori_bias, [measurements.model for measurements in series])
    estimate, iterations = _iterate(path, series, starting_estimate, solved, weighting, max_iterations, tolerance)
    state = linearise(path, series, estimate, solved)
    system = build_solver(path, state.rows, estimate.C, weighting)
    nodes = path.find_nodes(np.concatenate([[epoch], wanted]))
    errors = _compute_errors(
        path, state, system.compute_influence(nodes, state.S[nodes]), estimate.C[0], nodes, len(solved.names)
    )
    joint = errors.covariance
    size = 6 + len(solved.names)
    A = state.R[nodes] @ estimate.C[nodes]
    # The increments are as many measurements as unknowns.
    chi2 = state.rows.chi2 + (system.walk_chi2 if isinstance(system, ExactLeastSquares) else 0.0)
    return BatchResult(
        epoch_s=epoch,
        attitude=A[0],
        bias=estimate.bias,
        models=estimate.models,
        names=solved.names,
        covariance=joint[:size, :size],
        t_s=wanted,
        attitudes=A[1:],
        joint=joint,
        errors=errors,
        residuals=state.residuals,
        chi2=chi2,
        dof=len(state.rows.z) - size,
        iterations=iterations,
    )


def build_solver(path: GyroArc, rows: Rows, C: Array, weighting: Weighting) -> PlainLeastSquares | ExactLeastSquares:
    """Factorise the system of a weighting; plain for a negligible walk: as good as exact, and better conditioned."""
    walk = np.sqrt(np.sum(path.q**2)) * np.linalg.norm(rows.attitude)
    if weighting == "plain" or walk < NEGLIGIBLE_WALK * np.sqrt(len(path.t)):
        return PlainLeastSquares(rows, len(path.t))
    return ExactLeastSquares(rows, path.q, residual(C[1:], C[:-1]))


def _iterate(
    path: GyroArc,
    series: Sequence[SensorSeries],
    estimate: Estimate,
    solved: Columns,
    weighting: Weighting,
    max_iterations: int,
    tolerance: float,
) -> tuple[Estimate, int]:
    """Iterate by Gauss and Newton to convergence; returns the estimate and the number of iterations."""
    for iteration in range(1, max_iterations + 1):
        rows = linearise(path, series, estimate, solved).rows
        if not (np.isfinite(rows.z).all() and np.isfinite(rows.plain).all()):
            break
        # Every time: a wrong start or bias can make a direction look determined that is not.
        check_observable(rows, estimate.C[0], solved.names)
        gamma, delta, length = build_solver(path, rows, estimate.C, weighting).step()
        estimate = correct_estimate(estimate, gamma, delta, solved)
        if length <= tolerance:
            return estimate, iteration
    raise InputError(
        f"the batch did not converge within {max_iterations} iterations; is the start attitude within some degrees, "
        "are the rates in rad/s and the a-priori bias right, or do the sensors hardly determine the attitude?"
    )


def correct_estimate(estimate: Estimate, gamma: Array, delta: Array, solved: Columns) -> Estimate:
    """Correct an estimate by γ (N, 3) and δ (3 + q,)."""
    return Estimate(
        rotation_matrix(gamma) @ estimate.C,
        estimate.bias + delta[:3],
        solved.correct_models(estimate.models, delta[3:]),
    )


def _compute_errors(
    path: GyroArc, state: LinearisedMeasurements, influence: Influence, C: Array, nodes: NDArray[np.intp], q: int
) -> Errors:
    """Compute the errors of epoch attitude, bias, sensor parameters and wanted attitudes, in this order; in body axes there."""
    p = 3 + q
    turn = scipy.linalg.block_diag(np.eye(p), *state.R[nodes])
    order = np.concatenate([np.arange(p, p + 3), np.arange(p), np.arange(p + 3, len(turn))])
    by_measurement = (turn @ influence.measurements)[order]
    # The increments are in the axes of the first node; C turns inertial components into these.
    walk = (turn @ influence.walk)[:, order] @ C
    arw = float(path.q[0] / np.sqrt(path.t[1] - path.t[0]))
    return Errors(by_measurement @ by_measurement.T, path.t, walk, arw)


def check_observable(rows: Rows, C: Array, names: tuple[str, ...]) -> None:
    """Refuse measurements that leave something free, or are fewer than the unknowns.

    C: (3, 3) attitude at the first node
    names: the sensor parameters after the bias
    """
    unknowns = 6 + len(names)
    if len(rows.z) < unknowns:
        raise InputError(f"{len(rows.z)} measured numbers are too few for {unknowns} unknowns; take a longer arc")
    free = find_free_directions(rows)
    if len(free):
        texts = tuple(format_free_direction(direction, C, names) for direction in free)
        raise UnobservableError(
            f"the measurements do not determine {'; nor '.join(texts)}; add another sensor, a longer arc or a prior", texts
        )


def list_plausible_ranges(p: int) -> Array:
    """List plausible ranges (3 + p,) of attitude, bias and sensor parameters."""
    return np.array([PLAUSIBLE_ATTITUDE] * 3 + [PLAUSIBLE_BIAS] * 3 + [PLAUSIBLE_SENSOR] * (p - 3))


def find_free_directions(rows: Rows, part: float = 1.0) -> Array:
    """Find changes (f, 3 + p) of (γ, δ) that measurements do not determine to within this part of the plausible range.

    They are as sparse as pivoting makes them; the largest element of each is its plausible range.
    """
    scale = list_plausible_ranges(rows.parameters.shape[1])
    _, values, directions = np.linalg.svd(np.linalg.qr(rows.plain * scale, mode="r"))
    free = directions[(values * part < 1) | (values < OBSERVABILITY_RANK_TOLERANCE * values[0])]
    if not len(free):
        return free
    _, _, pivots = scipy.linalg.qr(free, pivoting=True, mode="economic")
    basis = np.linalg.solve(free[:, pivots[: len(free)]], free)
    return np.asarray(basis / np.abs(basis).max(axis=1, keepdims=True) * scale)


def format_free_direction(direction: Array, C: Array, names: tuple[str, ...]) -> str:
    """Describe a free direction: the rotation, by its inertial axis, and the bias and sensor parameters that go with it."""
    scale = list_plausible_ranges(len(direction) - 3)
    relative_size = np.abs(direction / scale)
    terms = []
    size = float(np.linalg.norm(direction[:3]))
    if relative_size[:3].max() > NAMED_SHARE:
        axis = C.T @ direction[:3] / size
        axis *= np.sign(axis[np.argmax(np.abs(axis))])
        terms.append("a rotation about the inertial direction ({:.3f}, {:.3f}, {:.3f})".format(*(axis + 0.0)))
    labels = (*BIAS_NAMES, *names)
    terms += [labels[k - 3] for k in range(3, len(direction)) if relative_size[k] > NAMED_SHARE]
    return " together with ".join([terms[0], ", ".join(terms[1:])] if len(terms) > 1 else terms)
