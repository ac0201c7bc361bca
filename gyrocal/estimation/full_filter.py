"""The alternative that N names: a Kalman filter which carries the twelve gyro parameters beside the attitude.

State (θ, Δx) with all of G and b, transition N (20)–(22), one pass through the same samples and sensor measurements; it is
`gyrocal.estimation.mekf.KalmanFilter` with ``names="all"``. With a right model and errors small enough to linearise it is the
least-squares solution of everything at once: the Davenport scheme's where attitudes are measured at the ends of maneuvers
only, and better where sensors also see what happens between. It does worse where one of the two fails:

- G shows in maneuvers only. At a constant rate ω_raw the attitude follows b + G ω_raw, three numbers; yet a filter that
  gets a measurement every few seconds for hours believes that it averages them. A sensor error that does not average out
  (alignment, horizon, a transfer function) makes an attitude error that changes as the Sun and the Earth turn through the
  sensors, and so looks like a rate. It goes into b and, by the correlation that maneuvers have left, into scale factors and
  misalignments. An alignment of the size of one measurement's noise leaves the innovations within a few percent of what
  they should be and the parameters wrong by many times their sigma. The references of the separate scheme are as wrong,
  and so, then, are its parameters; but they are a few attitudes, to each of which such an error can be stated once.
- It linearises once, where it happens to be when a measurement comes. With measurements all through a maneuver that is
  often enough. Where there are none until the maneuver's end, errors of a percent in G are degrees of attitude by then,
  and the second-order terms exceed sensor noise. The Davenport scheme goes back over the maneuvers and iterates.

`run_legs` detects the first of these from the data alone. In a right filter the estimate's change over a leg has the
covariance by which P shrank,

    x_after − x_before ~ N(0, P_before − P_after)

so that χ² of the change, over the combinations of parameters that the leg has determined better, should be its
degrees of freedom. With sensors that do not fit the model it is too large, also in legs between maneuvers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrocal.arrays import Array
from gyrocal.calibration.parameters import GyroParameters
from gyrocal.errors import InputError
from gyrocal.estimation.filter_run import FilterRun, run
from gyrocal.estimation.mekf import KalmanFilter
from gyrocal.recording import GyroStream
from gyrocal.sensors.series import SensorSeries

LEARNT = 0.02  # of the variance of a combination; less is not counted as found in a leg


@dataclass(frozen=True)
class Leg:
    """A part of the pass.

    Attributes
    ----------
    name : of the maneuver or mode
    start_s, stop_s : s
    A : (3, 3) attitude to restart from where the samples were interrupted before it; None goes on
    """

    name: str
    start_s: float
    stop_s: float
    A: Array | None = None


@dataclass(frozen=True)
class Change:
    """Change of the solved-for parameters by one leg."""

    name: str  # of the leg
    # chi2, dof: of the change, over the combinations that the leg has determined better
    chi2: float
    dof: int


@dataclass(frozen=True)
class FullFilterResult:
    """Result of a pass of the filter.

    Attributes
    ----------
    parameters : G and b
    covariance : (p, p) of the solved-for ones
    names : those
    changes : one for each leg
    runs : the filter's own record of each leg
    """

    parameters: GyroParameters
    covariance: Array
    names: tuple[str, ...]
    changes: tuple[Change, ...]
    runs: tuple[FilterRun, ...]


def build_starting_covariance(attitude_sigma: float, parameter_covariance: Array) -> Array:
    """Build (3 + p, 3 + p) of an attitude with equal 1-sigma about all axes, rad, and of parameters (p, p)."""
    p = len(parameter_covariance)
    P = np.zeros((3 + p, 3 + p))
    P[:3, :3] = attitude_sigma**2 * np.eye(3)
    P[3:, 3:] = parameter_covariance
    return P


def run_legs(
    estimator: KalmanFilter,
    gyro: GyroStream,
    series: Sequence[SensorSeries],
    legs: Sequence[Leg],
    restart_sigma: float = np.pi / 180,
) -> FullFilterResult:
    """Run a filter through legs, one after another.

    Parameters
    ----------
    estimator : as it is at the start of the first; changed
    gyro, series : samples that cover each leg, and sensor measurements
    legs : in time order; one without an attitude starts where the one before has stopped
    restart_sigma : 1-sigma of an attitude to restart from, rad

    Raises
    ------
    InputError
        Samples are missing, or a leg neither goes on nor restarts.
    """
    if not legs:
        raise InputError("no legs to run through")
    runs: list[FilterRun] = []
    changes: list[Change] = []
    used_until = -np.inf  # a measurement at a joint belongs to the leg before
    for number, leg in enumerate(legs):
        if leg.A is not None:
            estimator.restart(leg.A, build_starting_covariance(restart_sigma, estimator.P[3:, 3:]))
        elif number and leg.start_s != legs[number - 1].stop_s:
            raise InputError(f"leg {leg.name} starts at {leg.start_s} s without an attitude and does not go on")
        x_before, P_before = estimator.x[estimator.columns].copy(), estimator.P[3:, 3:].copy()
        unused_series = [part for measurements in series if (part := _mask_until(measurements, used_until)) is not None]
        runs.append(run(estimator, gyro, unused_series, leg.start_s, np.array([leg.stop_s])))
        used_until = leg.stop_s
        change = estimator.x[estimator.columns] - x_before
        changes.append(Change(leg.name, *compute_change_chi2(change, P_before, estimator.P[3:, 3:])))
    return FullFilterResult(estimator.parameters, estimator.P[3:, 3:].copy(), estimator.names, tuple(changes), tuple(runs))


def compute_change_chi2(change: Array, P_before: Array, P_after: Array) -> tuple[float, int]:
    """Compute χ² and its degrees of freedom of a change (p,) while P_before became P_after (p, p).

    In the combinations that diagonalise both, those whose variance shrank by less than the share `LEARNT` are left out.
    """
    scale = np.sqrt(np.diag(P_before))
    L = np.linalg.cholesky(P_before / np.outer(scale, scale))
    white = np.linalg.solve(L, np.eye(len(L)))
    lost_variance, basis = np.linalg.eigh(np.eye(len(L)) - white @ (P_after / np.outer(scale, scale)) @ white.T)
    components = basis.T @ white @ (change / scale)
    is_learnt = lost_variance > LEARNT  # a share of the variance of each component
    return float(np.sum(components[is_learnt] ** 2 / lost_variance[is_learnt])), int(is_learnt.sum())


def _mask_until(series: SensorSeries, time: float) -> SensorSeries | None:
    """Mask everything in a series up to a time; None if nothing remains."""
    sigma = np.where((series.t > time)[:, None], series.sigma, np.inf)
    return replace(series, sigma=sigma) if np.isfinite(sigma).any() else None
