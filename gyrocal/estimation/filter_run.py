"""A Kalman filter over a recorded gyro stream and series of sensor measurements.

A stop is a measurement or a wanted time. Between two stops the compiled `gyrocal.estimation.error_state.advance` propagates
over all samples, cut at both; a sample's rate holds until the next sample begins.

`smooth` goes back over the stops j of a run: the fixed-interval smoother of Rauch, Tung and Striebel. With P_j after the
measurement of stop j, P⁻_{j+1} predicted for the next, and Φ the transition between them,

    C_j = P_j Φᵀ (P⁻_{j+1})⁻¹,    s_j = C_j s⁻_{j+1},    P_j|all = P_j + C_j (P_{j+1}|all − P⁻_{j+1}) C_jᵀ

where s_j takes the filter's estimate at stop j to the smoothed one, and s⁻_{j+1} the predicted estimate of the next stop to
its smoothed one. The errors of two stops a ≤ b have the covariance C_a … C_{b−1} P_b|all: reference attitudes from one
run share the bias and the measurements between them, and their errors correlate.

All of it is linear about the filter's way. An attitude that the filter starts with has an error of second order, θ²/2, which
the covariance does not know; where it is no longer small beside the noise of the measurements, start nearer.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrocal import attitude
from gyrocal.arrays import Array, Indices
from gyrocal.calibration.parameters import NAMES
from gyrocal.errors import InputError
from gyrocal.estimation.error_state import advance
from gyrocal.estimation.mekf import Innovation, KalmanFilter
from gyrocal.recording import GyroStream
from gyrocal.sensors.series import SensorSeries

TIME_TOLERANCE_S = 1e-6  # rounding of a time tag some years after the epoch


@dataclass(frozen=True)
class Innovations:
    """All measurements of a run, in order."""

    t: Array  # (e,) s
    # series, row: (e,) which series, and which row of it
    series: Indices
    row: Indices
    # nis, dof: (e,) normalised innovation squared and its degrees of freedom
    nis: Array
    dof: Indices
    accepted: NDArray[np.bool_]  # (e,) whether it was within the gate


class Stop(NamedTuple):
    """Predicted (before) and corrected (after) state at a stop of a run, for the way back."""

    A_before: Array
    x_before: Array
    P_before: Array
    A_after: Array
    x_after: Array
    P_after: Array
    Phi: Array  # (3, n) upper rows of the transition from the stop before


class _Measured(NamedTuple):
    """A measurement that a filter has met."""

    t_s: float
    series: int
    row: int
    innovation: Innovation


@dataclass(frozen=True)
class FilterRun:
    """Estimates of a filter at the requested times, each with the measurements up to and at that time.

    Attributes
    ----------
    t : (k,) s
    A : (k, 3, 3) attitudes
    x : (k, 12) G and b in the order of `NAMES`
    covariance : (k, n, n) of attitude and solved-for parameters
    names : solved-for parameters
    innovations : of all measurements
    history : all stops, if asked for; none otherwise
    stops : (k,) stop of the history at each requested time
    """

    t: Array
    A: Array
    x: Array
    covariance: Array
    names: tuple[str, ...]
    innovations: Innovations
    history: tuple[Stop, ...]
    stops: Indices

    @property
    def bias(self) -> Array:
        """(k, 3) b, rad/s."""
        return np.asarray(self.x[:, 9:])

    @property
    def bias_deg_s(self) -> Array:
        """(k, 3) b, deg/s."""
        return np.asarray(np.rad2deg(self.bias))


def run(
    estimator: KalmanFilter,
    gyro: GyroStream,
    series: Sequence[SensorSeries],
    start_s: float,
    times: Array,
    *,
    max_gap_s: float | None = None,
    keep_history: bool = False,
) -> FilterRun:
    """Run a filter over a recorded stream.

    Parameters
    ----------
    estimator : the filter as it is at the start; changed
    gyro : samples that cover the time from start to the last requested one
    series : sensor measurements; those outside of that time are left alone
    start_s : time of the estimator's state, s
    times : (k,) ascending times of the wanted estimates, s
    max_gap_s : longest time of missing samples over which the last rate is held; half a sample by default
    keep_history : whether to keep all stops, for `smooth`

    Raises
    ------
    InputError
        The samples do not cover the time, or the times do not ascend.
    """
    times = np.asarray(times, dtype=float)
    if not times.size or times[0] < start_s or (np.diff(times) < 0).any():
        raise InputError("the requested times must ascend and not precede the start")
    k = find_held_sample(gyro, start_s, float(times[-1]), max_gap_s)
    t, series_number, row = _order_stops(series, start_s, times)
    Phi = np.empty((3, len(estimator.P)))
    rates = np.ascontiguousarray(gyro.rates)
    noise = estimator.arw, estimator.rate_random_walk
    now_s = start_s
    requested: list[tuple[Array, ...]] = []
    measured: list[_Measured] = []
    history: list[Stop] = []
    for stop in range(len(t)):
        k = advance(estimator.A, estimator.P, Phi, estimator.x, estimator.columns, gyro.t_s, rates, k, now_s, t[stop], *noise)
        now_s = float(t[stop])
        before = _copy_state(estimator) if keep_history else None
        if series_number[stop] < 0:
            requested.append(_copy_state(estimator))
        else:
            measurements, place = series[series_number[stop]], int(row[stop])
            innovation = estimator.update(measurements.model, place, measurements.y[place], measurements.sigma[place])
            if innovation is not None:
                measured.append(_Measured(now_s, int(series_number[stop]), place, innovation))
        if before is not None:
            history.append(Stop(*before, *_copy_state(estimator), Phi.copy()))
    A, x, P = (np.array(values) for values in zip(*requested, strict=True))
    return FilterRun(
        times,
        A,
        x,
        P,
        names=estimator.names,
        innovations=_gather_innovations(measured),
        history=tuple(history),
        stops=np.flatnonzero(series_number < 0),
    )


def find_held_sample(gyro: GyroStream, start_s: float, stop_s: float, max_gap_s: float | None = None) -> int:
    """Find the sample that holds at `start_s`, and check that samples cover the time from there to `stop_s`.

    An `InputError` if they do not cover it.
    """
    limit = gyro.sample_s + max(0.5 * gyro.sample_s, max_gap_s or 0.0)
    first = int(np.searchsorted(gyro.t_s, start_s + TIME_TOLERANCE_S, side="right")) - 1
    last = int(np.searchsorted(gyro.t_s, stop_s - TIME_TOLERANCE_S, side="left"))
    if first < 0:
        raise InputError(f"the gyro samples begin at {gyro.t_s[0]} s, after {start_s} s")
    tags = np.append(gyro.t_s[first : max(last, first + 1)], stop_s)
    gaps = np.flatnonzero(np.diff(tags) > limit)
    if gaps.size:
        k = gaps[0]
        raise InputError(f"no gyro samples between {tags[k] + gyro.sample_s} s and {tags[k + 1]} s; restart the filter there")
    return first


def _order_stops(series: Sequence[SensorSeries], start_s: float, times: Array) -> tuple[Array, Indices, Indices]:
    """Order measurements and requests: their times, s, the series of each (−1 for a request), and its row there.

    Measurements without a number to be used are left out.
    """
    stop_s, series_number, row = [times], [np.full(len(times), -1)], [np.arange(len(times))]
    for number, measurements in enumerate(series):
        rows = np.flatnonzero((measurements.t >= start_s) & (measurements.t <= times[-1]) & measurements.used.any(axis=1))
        stop_s.append(measurements.t[rows])
        series_number.append(np.full(len(rows), number))
        row.append(rows)
    all_s, all_numbers, all_rows = np.concatenate(stop_s), np.concatenate(series_number), np.concatenate(row)
    order = np.lexsort((all_numbers < 0, all_s))  # a request comes after the measurements of its time
    return all_s[order], all_numbers[order], all_rows[order]


def _copy_state(estimator: KalmanFilter) -> tuple[Array, Array, Array]:
    return estimator.A.copy(), estimator.x.copy(), estimator.P.copy()


def _gather_innovations(measured: Sequence[_Measured]) -> Innovations:
    """Gather the innovations of a run in arrays."""
    return Innovations(
        t=np.array([entry.t_s for entry in measured]),
        series=np.array([entry.series for entry in measured], dtype=np.intp),
        row=np.array([entry.row for entry in measured], dtype=np.intp),
        nis=np.array([entry.innovation.nis for entry in measured]),
        dof=np.array([entry.innovation.residual.size for entry in measured], dtype=np.intp),
        accepted=np.array([entry.innovation.accepted for entry in measured], dtype=bool),
    )


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
    history = run.history
    if not history:
        raise InputError("only a run with keep_history=True can be smoothed")
    n, k = run.covariance.shape[-1], len(run.t)
    columns = [NAMES.index(name) for name in run.names]
    requests = {int(stop): request for request, stop in enumerate(run.stops)}
    A, x, P = history[-1].A_after, history[-1].x_after.copy(), history[-1].P_after
    out = Smoothed(run.t, np.empty((k, 3, 3)), np.empty((k, 12)), np.zeros((k, n, k, n)))
    cross_covariances: dict[int, Array] = {}  # between the present stop and each later request
    for stop in range(len(history) - 1, -1, -1):
        if stop < len(history) - 1:
            current, later = history[stop], history[stop + 1]
            C = _compute_smoother_gain(current, later)
            state = C @ np.concatenate([attitude.residual(A, later.A_before), (later.x_before - x)[columns]])
            A, x = attitude.rotation_matrix(state[:3]) @ current.A_after, current.x_after.copy()
            x[columns] -= state[3:]
            P = current.P_after + C @ (P - later.P_before) @ C.T
            P = 0.5 * (P + P.T)
            cross_covariances = {request: C @ covariance for request, covariance in cross_covariances.items()}
        if stop in requests:
            request = requests[stop]
            out.A[request], out.x[request] = A, x
            cross_covariances[request] = P
            for later_request, covariance in cross_covariances.items():
                out.covariance[request, :, later_request] = covariance
                out.covariance[later_request, :, request] = covariance.T
    return out


def _compute_smoother_gain(current: Stop, later: Stop) -> Array:
    """Compute C (n, n) = P Φᵀ (P⁻)⁻¹ from a stop to the next, its states scaled by their sigmas for the inverse."""
    n = len(later.P_before)
    Phi = np.vstack([later.Phi, np.eye(n)[3:]])
    scale = np.sqrt(np.diag(later.P_before))
    scaled = later.P_before / np.outer(scale, scale)
    return np.asarray(np.linalg.solve(scaled, (Phi @ current.P_after) / scale[:, None]).T / scale)
