"""A Kalman filter over a recorded gyro stream and series of sensor measurements.

A stop is a measurement or a wanted time. Between two stops the compiled `gyrocal.estimation.error_state.advance` propagates
over all samples, cut at both; a sample's rate holds until the next sample begins.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.estimation.error_state import Indices, advance
from gyrocal.estimation.mekf import Innovation, KalmanFilter
from gyrocal.recording import GyroStream
from gyrocal.recording.gyros import need_triad
from gyrocal.sensors.series import SensorSeries

Array = NDArray[np.float64]

TIME_TOLERANCE_S = 1e-6  # rounding of a time tag some years after the epoch


@dataclass(frozen=True)
class Innovations:
    """All measurements of a run, in order.

    Attributes
    ----------
    t : (e,) s
    series, row : (e,) which series, and which row of it
    residual, sigma : (e, m) y − h(A) and the filter's own 1-sigma of it; NaN where a number was not used
    nis, dof : (e,) normalised innovation squared and its degrees of freedom
    accepted : (e,) whether it was within the gate
    """

    t: Array
    series: Indices
    row: Indices
    residual: Array
    sigma: Array
    nis: Array
    dof: Indices
    accepted: NDArray[np.bool_]


@dataclass(frozen=True)
class History:
    """Every stop of a run, for the way back: predicted (before) and corrected (after) state.

    Attributes
    ----------
    A_before, A_after : (k, 3, 3)
    x_before, x_after : (k, 12)
    P_before, P_after : (k, n, n)
    Phi : (k, 3, n) upper rows of the transition from the stop before
    """

    A_before: Array
    A_after: Array
    x_before: Array
    x_after: Array
    P_before: Array
    P_after: Array
    Phi: Array


@dataclass(frozen=True)
class FilterRun:
    """What a filter found at the requested times; a measurement made at such a time is used.

    Attributes
    ----------
    t : (k,) s
    A : (k, 3, 3) attitudes
    x : (k, 12) G and b in the order of `NAMES`
    covariance : (k, n, n) of attitude and solved-for parameters
    names : solved-for parameters
    innovations : of all measurements
    rejected : how many of them the gate kept out
    history : all stops, if asked for
    stops : (k,) stop of the history at each requested time
    """

    t: Array
    A: Array
    x: Array
    covariance: Array
    names: tuple[str, ...]
    innovations: Innovations
    rejected: int
    history: History | None
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
    keep_history : whether to keep all stops, for `gyrocal.estimation.smoother`

    Raises
    ------
    InputError
        The samples do not cover the time, or the times do not ascend.
    """
    times = np.asarray(times, dtype=float)
    if not times.size or times[0] < start_s or (np.diff(times) < 0).any():
        raise InputError("the requested times must ascend and not precede the start")
    k = covering(gyro, start_s, float(times[-1]), max_gap_s)
    t, which, row = _stops(series, start_s, times)
    n, width = len(estimator.P), max((s.model.size for s in series), default=0)
    found = _Found(len(times), n, int(np.sum(which >= 0)), width, len(t) if keep_history else 0)
    Phi = np.empty((3, n))
    rates = np.ascontiguousarray(gyro.rates)
    rejected, present = estimator.rejected, start_s
    for stop in range(len(t)):
        noise = (estimator.arw, estimator.rate_random_walk)
        k = advance(estimator.A, estimator.P, Phi, estimator.x, estimator.columns, gyro.t_s, rates, k, present, t[stop], *noise)
        present = t[stop]
        if keep_history:
            found.before(stop, estimator, Phi)
        if which[stop] < 0:
            found.requested(row[stop], stop, estimator)
        else:
            one = series[which[stop]]
            innovation = estimator.update(one.model, int(row[stop]), one.y[row[stop]], one.sigma[row[stop]])
            if innovation is not None:
                found.measured(present, which[stop], row[stop], innovation)
        if keep_history:
            found.after(stop, estimator)
    return found.result(times, estimator, estimator.rejected - rejected)


def covering(gyro: GyroStream, start_s: float, stop_s: float, max_gap_s: float | None = None) -> int:
    """The sample that holds at `start_s`, once it is sure that samples cover the time from there to `stop_s`.

    Raises
    ------
    InputError
        They do not.
    """
    need_triad(gyro)
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


def _stops(series: Sequence[SensorSeries], start_s: float, times: Array) -> tuple[Array, Indices, Indices]:
    """Times at which something happens, which series it belongs to (−1 a request), and the row of that; ordered.

    Measurements without a number to be used are left out.
    """
    t, which, row = [times], [np.full(len(times), -1)], [np.arange(len(times))]
    for number, one in enumerate(series):
        rows = np.flatnonzero((one.t >= start_s) & (one.t <= times[-1]) & one.used.any(axis=1))
        t.append(one.t[rows])
        which.append(np.full(len(rows), number))
        row.append(rows)
    at, of, rows = np.concatenate(t), np.concatenate(which), np.concatenate(row)
    order = np.lexsort((of < 0, at))  # a request comes after the measurements of its time
    return at[order], of[order], rows[order]


class _Found:
    """Arrays that a run fills."""

    def __init__(self, requests: int, n: int, measurements: int, width: int, stops: int):
        self.A, self.x, self.P = np.empty((requests, 3, 3)), np.empty((requests, 12)), np.empty((requests, n, n))
        self.stops = np.zeros(requests, dtype=np.intp)
        self.count = 0
        self.innovations = Innovations(
            t=np.empty(measurements),
            series=np.zeros(measurements, dtype=np.intp),
            row=np.zeros(measurements, dtype=np.intp),
            residual=np.full((measurements, width), np.nan),
            sigma=np.full((measurements, width), np.nan),
            nis=np.empty(measurements),
            dof=np.zeros(measurements, dtype=np.intp),
            accepted=np.zeros(measurements, dtype=bool),
        )
        shapes = ((3, 3), (3, 3), (12,), (12,), (n, n), (n, n), (3, n))
        self.history = History(*(np.empty((stops, *shape)) for shape in shapes)) if stops else None

    def before(self, stop: int, estimator: KalmanFilter, Phi: Array) -> None:
        assert self.history is not None
        self.history.A_before[stop], self.history.x_before[stop] = estimator.A, estimator.x
        self.history.P_before[stop], self.history.Phi[stop] = estimator.P, Phi

    def after(self, stop: int, estimator: KalmanFilter) -> None:
        assert self.history is not None
        self.history.A_after[stop], self.history.x_after[stop] = estimator.A, estimator.x
        self.history.P_after[stop] = estimator.P

    def requested(self, request: int, stop: int, estimator: KalmanFilter) -> None:
        self.A[request], self.x[request], self.P[request] = estimator.A, estimator.x, estimator.P
        self.stops[request] = stop

    def measured(self, t: float, series: int, row: int, innovation: Innovation) -> None:
        found, e = self.innovations, self.count
        columns = np.flatnonzero(innovation.used)
        found.t[e], found.series[e], found.row[e] = t, series, row
        found.residual[e, columns], found.sigma[e, columns] = innovation.residual, np.sqrt(np.diag(innovation.S))
        found.nis[e], found.dof[e], found.accepted[e] = innovation.nis, len(columns), innovation.accepted
        self.count += 1

    def result(self, times: Array, estimator: KalmanFilter, rejected: int) -> FilterRun:
        return FilterRun(times, self.A, self.x, self.P, estimator.names, self.innovations, rejected, self.history, self.stops)
