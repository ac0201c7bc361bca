"""The on-board form of N section VI: Kalman filter and recursive calibrator side by side on one pass of samples.

The filter solves for attitude and gyro bias; its estimates at the start and at the end of each maneuver are the reference
attitudes of the Davenport scheme, so that no batch and no stored data are needed. Its rates are adjusted with its own bias,
which changes with every measurement. The calibrator's are adjusted with an a-priori bias that stays the same for all
maneuvers, and both with the same G. Hence two transition matrices run in parallel: the filter's Φ = [[R, ψF], [0, I]], and
the calibrator's R̄ and Θ with θ = Θ Δx.

**C.** The references are not independent of each other nor of the gyro. Let e be the filter's attitude error, so that the
reference is exp(−[e×]) A_true, and follow the error ρ of the attitude that the calibrator propagates, less what Δx does to
it. It starts as the filter's, ρ = e at the start, is turned by R̄ and collects the very noise n of the gyro samples that the
filter's error collects:

    ρ ← R̄_k ρ + n_k,    (e, Δb) ← Φ_k (e, Δb) + (n_k, 0),    (e, Δb) ← (I − K H)(e, Δb) − K ν at a measurement

The residual of N (16) is, to first order, θ = Θ Δx + ρ − e. Beside the filter's covariance P three more rows are therefore
carried, the covariance of ρ and its cross-covariance X with the filter's state; K leaves ρ alone:

    P_ρ ← R̄_k P_ρ R̄_kᵀ + q I,    X ← R̄_k X Φ_kᵀ + (q I, 0),    X ← X (I − K H)ᵀ,    q = ARW² Δt
    C = P_ρ + P_e − X_e − X_eᵀ

at the start P_ρ = X_e = P_e. Without a measurement during a maneuver X_e keeps pace, θ holds no new information, and C is
small accordingly. Taking start, end and gyro noise for independent, C = P_e + R̄ P_e0 R̄ᵀ + ARW² T I, counts the noise of
the filter's last time constant twice.

**Θ.** The errors of a filter with a wrong G depend on the errors of the parameters. With S the sensitivity of its state to
the errors of the parameters that it holds, S ← Φ_k S + (ψF; 0) and S ← (I − K H) S,

    θ = (Θ + R̄ S_0 − S) Δx + ρ − e                                                     attitude rows of S

N leaves S out: before and after a maneuver the rates are constant, the solved-for bias makes up for the errors of G, and S
vanishes. That takes a filter that has forgotten the maneuver when the reference is taken: either `open` it at the end of the
slew, or wait. With S no such care is needed. The bias walk of a filter (see `gyrocal.estimation.mekf`) acts in the filter
alone, since the calibrator's bias is a constant.

**Sensor errors that do not average out** (alignment, horizon) are in no filter's P: it takes a thousand measurements with
one common error for a thousand independent ones. `reference_sigma` adds them to C, once for the start and once for the end,
C + diag(σ²) + R̄ diag(σ²) R̄ᵀ.

One pass linearises once, about the a-priori parameters. Errors of 1e-3 in G leave nothing, as N found; errors of percents
take a second set of maneuvers from the first one's solution, since the samples of the first are gone.

Residuals of different maneuvers are taken for independent, as in N (31)–(32): a maneuver should start some of the filter's
time constants after the one before has ended.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gyrocal import attitude
from gyrocal.arrays import Array, Indices
from gyrocal.calibration.davenport import Accumulation
from gyrocal.calibration.normal_equations import whiten
from gyrocal.calibration.parameters import NAMES, GyroParameters, select
from gyrocal.errors import InputError
from gyrocal.estimation.error_state import compute_transition, rotate_attitude
from gyrocal.estimation.filter_run import find_held_sample
from gyrocal.estimation.mekf import Innovation, KalmanFilter
from gyrocal.jit_cache import compile_cached
from gyrocal.recording import GyroStream
from gyrocal.sensors.series import SensorModel, SensorSeries

MEASUREMENT, OPENING, END, START = range(4)  # kinds of events in a replay, in their order at one time


@dataclass(frozen=True)
class Maneuver:
    """Contribution of a maneuver to the calibration.

    Attributes
    ----------
    A_start, A_end : (3, 3) reference attitudes, the filter's estimates
    P_start, P_end : (3, 3) their covariances as the filter has them, rad²
    R : (3, 3) rotation R̄ between them by the calibrator's rates
    elapsed_s : s
    residual : (3,) θ of N (16), rad
    Theta : (3, p) sensitivity it was weighted with
    C : (3, 3) its covariance, rad²
    """

    A_start: Array
    A_end: Array
    P_start: Array
    P_end: Array
    R: Array
    elapsed_s: float
    residual: Array
    Theta: Array
    C: Array


class OnBoardCalibrator:
    """Filter and calibrator on one pass of samples; memory does not depend on their number.

    Parameters
    ----------
    estimator : Kalman filter of attitude and bias, as it is at the start; it keeps its G
    apriori : parameters that the calibrator adjusts its rates with; G must be the filter's
    solve_for : see `gyrocal.calibration.parameters.select`
    apriori_covariance : (p, p) of the solved-for parameters about `apriori`, or None
    through_filter : whether to carry S, the references' own dependence on G; without, Θ is N's
    reference_sigma : (3,) rad, error of a reference attitude about each body axis beside the filter's own

    Raises
    ------
    InputError
        The filter's G is another one.
    """

    def __init__(
        self,
        estimator: KalmanFilter,
        apriori: GyroParameters,
        solve_for: str | Iterable[str] = "all",
        apriori_covariance: Array | None = None,
        through_filter: bool = True,
        reference_sigma: Array | None = None,
    ):
        if not np.array_equal(estimator.parameters.G, apriori.G):
            raise InputError("filter and calibrator must adjust the rates with the same G")
        self.estimator, self.apriori, self.names = estimator, apriori, select(solve_for)
        self._x = apriori.vector
        self._reference = np.diag(np.zeros(3) if reference_sigma is None else np.square(reference_sigma))
        self._columns: Indices = np.array([NAMES.index(name) for name in self.names])
        self._sums = Accumulation(self._columns, apriori_covariance)
        held = [name for name in self.names if name not in estimator.names] if through_filter else []
        self._held: Indices = np.array([NAMES.index(name) for name in held], dtype=np.intp)
        self._held_among = [self.names.index(name) for name in held]
        filtered, p = len(estimator.names), len(self.names)
        self._S_e, self._S_x = np.zeros((3, len(held))), np.zeros((filtered, len(held)))
        self._S_start = np.zeros_like(self._S_e)
        self._P_rho, self._X_e, self._X_x = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, filtered))
        self._R, self._Theta = np.eye(3), np.zeros((3, p))
        self._A_start, self._P_start = np.eye(3), np.zeros((3, 3))
        self._elapsed_s = 0.0
        self._running = False

    def sample(self, raw: Array, dt: float) -> None:
        """Propagate both over one gyro sample, raw (3,) rad/s held for dt seconds."""
        raw = np.asarray(raw, dtype=float)
        x = self.estimator.x
        R, B = self.estimator.step(raw, dt)
        if len(self._held):
            _propagate_sensitivity(x, raw, dt, self._held, R, B, self._S_e, self._S_x)
        if self._running:
            q = self.estimator.arw**2 * dt
            _propagate_maneuver(
                self._x, raw, dt, self._columns, self._R, self._Theta, self._P_rho, self._X_e, self._X_x, R, B, q
            )
            self._elapsed_s += dt

    def measurement(self, model: SensorModel, row: int, y: Array, sigma: Array) -> Innovation | None:
        """Correct the filter with a measurement, see `gyrocal.estimation.mekf.KalmanFilter.update`."""
        innovation = self.estimator.update(model, row, y, sigma)
        if innovation is not None and innovation.accepted:
            K, H = innovation.K, innovation.H
            self._S_x -= K[3:] @ (H @ self._S_e)
            self._S_e -= K[:3] @ (H @ self._S_e)
            X_H = self._X_e @ H.T
            self._X_e -= X_H @ K[:3].T
            self._X_x -= X_H @ K[3:].T
        return innovation

    def start(self) -> None:
        """Begin a maneuver at the filter's present attitude."""
        P = self.estimator.P
        self._A_start, self._P_start = self.estimator.A.copy(), P[:3, :3].copy()
        self._P_rho, self._X_e, self._X_x = P[:3, :3].copy(), P[:3, :3].copy(), P[:3, 3:].copy()
        self._S_start = self._S_e.copy()
        self._R, self._Theta = np.eye(3), np.zeros((3, len(self.names)))
        self._elapsed_s, self._running = 0.0, True

    def open(self, covariance: Array) -> None:
        """Make the filter forget, as at the end of a slew: add (n, n) to its covariance."""
        self.estimator.P = self.estimator.P + covariance

    def finish(self) -> Maneuver:
        """End the maneuver at the filter's present attitude and add its residual to the sums.

        Raises
        ------
        InputError
            None has begun, or no time has passed.
        """
        if not self._running or self._elapsed_s == 0:
            raise InputError("a maneuver must be started and last for at least a sample before it can be finished")
        self._running = False
        P_end = self.estimator.P[:3, :3].copy()
        C = self._P_rho + P_end - self._X_e - self._X_e.T
        C += self._reference + self._R @ self._reference @ self._R.T
        Theta = self._Theta.copy()
        Theta[:, self._held_among] += self._R @ self._S_start - self._S_e
        theta = attitude.residual(self.estimator.A, self._R @ self._A_start)
        white = whiten(C, np.column_stack([Theta * self._sums.scale, theta]))
        self._sums.add(white[:, :-1], white[:, -1])
        A_end, R = self.estimator.A.copy(), self._R.copy()
        return Maneuver(self._A_start, A_end, self._P_start, P_end, R, self._elapsed_s, theta, Theta, C)

    def solve(self) -> tuple[GyroParameters, Array]:
        """Solve N (33) for the corrected parameters and their covariance (p, p)."""
        correction, P = self._sums.solve()
        x = self.apriori.vector
        x[self._columns] -= correction
        return GyroParameters.from_vector(x), P


def replay(
    onboard: OnBoardCalibrator,
    gyro: GyroStream,
    series: Sequence[SensorSeries],
    start_s: float,
    maneuvers: Sequence[tuple[float, float]],
    openings: Mapping[float, Array] | None = None,
) -> tuple[Maneuver, ...]:
    """Feed a recorded stream to the on-board form in the order of time.

    Parameters
    ----------
    onboard : as it is at the start; changed
    gyro : samples that cover the time from start to the end of the last maneuver
    series : sensor measurements
    start_s : time of the filter's state, s
    maneuvers : start and end of each, s; ascending, not overlapping
    openings : what to add to the filter's covariance (n, n), by time

    Raises
    ------
    InputError
        Samples are missing, or the maneuvers overlap.
    """
    bounds = np.array(maneuvers, dtype=float).ravel()
    if not len(bounds) or bounds[0] < start_s or (np.diff(bounds) < 0).any() or (np.diff(bounds)[::2] == 0).any():
        raise InputError("maneuvers must begin after the start, last, and follow one another")
    k = find_held_sample(gyro, start_s, float(bounds[-1]))
    finished: list[Maneuver] = []
    now_s = start_s
    for event in _list_events(series, start_s, bounds, openings or {}):
        while now_s < event.t_s:
            while k + 1 < len(gyro.t_s) and gyro.t_s[k + 1] <= now_s:
                k += 1
            until = min(event.t_s, float(gyro.t_s[k + 1])) if k + 1 < len(gyro.t_s) else event.t_s
            onboard.sample(gyro.rates[k], until - now_s)
            now_s = until
        if event.kind == MEASUREMENT:
            measurements, row = series[event.series], event.row
            onboard.measurement(measurements.model, row, measurements.y[row], measurements.sigma[row])
        elif event.kind == OPENING and openings:
            onboard.open(openings[event.t_s])
        elif event.kind == END:
            finished.append(onboard.finish())
        elif event.kind == START:
            onboard.start()
    return tuple(finished)


class _Event(NamedTuple):
    """An event of a replay; those of one time come in the order of their kinds."""

    t_s: float
    kind: int  # MEASUREMENT, OPENING, END or START
    series: int = 0  # number of the series of a measurement, and its row
    row: int = 0


def _list_events(
    series: Sequence[SensorSeries], start_s: float, bounds: Array, openings: Mapping[float, Array]
) -> list[_Event]:
    """List measurements, openings, and starts and ends of maneuvers (2 n,), s, in the order of time."""
    events: list[_Event] = []
    for number, measurements in enumerate(series):
        rows = np.flatnonzero((measurements.t >= start_s) & (measurements.t <= bounds[-1]) & measurements.used.any(axis=1))
        events += [_Event(float(measurements.t[row]), MEASUREMENT, number, int(row)) for row in rows]
    events += [_Event(time, OPENING) for time in openings]
    events += [_Event(float(time), END if n % 2 else START) for n, time in enumerate(bounds)]
    return sorted(events)


@compile_cached
def _propagate_sensitivity(x: Array, raw: Array, dt: float, held: Indices, R: Array, B: Array, S_e: Array, S_x: Array) -> None:
    """Propagate S ← Φ S + (ψF; 0) in place, of the parameters that the filter holds."""
    B_held = np.empty((3, len(held)))
    compute_transition(x, raw, dt, held, np.empty((3, 3)), B_held)
    S_e[:] = R @ S_e + B @ S_x + B_held


@compile_cached
def _propagate_maneuver(
    x: Array,
    raw: Array,
    dt: float,
    columns: Indices,
    R: Array,
    Theta: Array,
    P_rho: Array,
    X_e: Array,
    X_x: Array,
    R_filter: Array,
    B_filter: Array,
    q: float,
) -> None:
    """Propagate R̄, Θ, P_ρ and X over one sample, in place.

    x: (12,) G and b that the calibrator linearises about
    columns: (p,) positions of the solved-for parameters among the twelve
    X_e, X_x: rows of X for the filter's attitude error and for its parameters
    R_filter, B_filter: the blocks R and ψF of the filter's own transition
    q: variance that the gyro's white noise adds about each axis in a sample, rad²
    """
    step, B = np.empty((3, 3)), np.empty((3, len(columns)))
    compute_transition(x, raw, dt, columns, step, B)
    rotate_attitude(R, step)
    Theta[:] = step @ Theta + B
    P_rho[:] = step @ P_rho @ step.T
    X_e[:] = step @ (X_e @ R_filter.T + X_x @ B_filter.T)
    X_x[:] = step @ X_x
    for i in range(3):
        P_rho[i, i] += q
        X_e[i, i] += q
