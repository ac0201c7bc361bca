"""The parts of a recording: the samples of the gyro, the reference attitudes, the calibration intervals and the orbit."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gyrocal.arrays import Array, Indices

FORWARD_AXES = ("+x", "-x", "+y", "-y", "none")
AXES = np.arange(3)
ROWS, COLUMNS = np.array([0, 0, 1]), np.array([1, 2, 2])  # of the elements of a covariance above its diagonal
TIME_TOLERANCE_S = 1e-6  # rounding of a time tag some years after the epoch


@dataclass(frozen=True)
class Interval:
    """One calibration interval; starts and ends in a constant-rate mode.

    Attributes
    ----------
    name : of its own
    activity : for people
    start_s, stop_s : s since the epoch
    forward : one of `FORWARD_AXES`, the body axis along the velocity throughout; None leaves it to the attitudes
    """

    name: str
    activity: str
    start_s: float
    stop_s: float
    forward: str | None = None


@dataclass(frozen=True)
class GyroStream:
    """Raw gyro samples and the a-priori calibration of the gyro.

    Attributes
    ----------
    t_s : (n,) sample start times, s since the epoch, strictly increasing
    rates : (n, 3) raw rates, rad/s
    sample_s : duration of one sample, s
    arw : angle random walk, rad/sqrt(s); the noise of one sample's rate is arw / sqrt(sample_s)
    apriori_G : (3, 3) rows are body axes, columns gyros
    apriori_bias : (3,) rad/s
    arw_estimated : whether `arw` was estimated from these samples instead of stated
    arw_degrees : degrees of freedom of an estimated `arw`; 0 if it is an upper bound
    """

    t_s: Array
    rates: Array
    sample_s: float
    arw: float
    apriori_G: Array = field(default_factory=lambda: np.eye(3))
    apriori_bias: Array = field(default_factory=lambda: np.zeros(3))
    arw_estimated: bool = False
    arw_degrees: float = float("inf")

    @property
    def rates_deg_s(self) -> Array:
        """(n, 3) raw rates, deg/s."""
        return np.asarray(np.rad2deg(self.rates))

    @property
    def arw_deg_per_sqrt_s(self) -> float:
        """Angle random walk, deg/sqrt(s)."""
        return float(np.rad2deg(self.arw))

    @property
    def apriori_bias_deg_s(self) -> Array:
        """(3,) a-priori b, deg/s."""
        return np.asarray(np.rad2deg(self.apriori_bias))


@dataclass(frozen=True)
class Attitudes:
    """Reference attitudes; empty in a recording of the gyro's noise alone.

    Attributes
    ----------
    t_s : (m,) s since the epoch, strictly increasing
    quaternions : (m, 4) inertial to body, scalar last
    sigma : (m, 3) 1-sigma per body axis, rad
    sigma_estimated : whether `sigma` was estimated from this recording instead of stated
    correlation : (m, 3) of the errors about x and y, x and z, y and z; None if they are independent
    sigma_degrees : degrees of freedom of an estimated `sigma`; 0 if it is an upper bound
    """

    t_s: Array
    quaternions: Array
    sigma: Array
    sigma_estimated: bool = False
    correlation: Array | None = None
    sigma_degrees: float = float("inf")

    def compute_covariance(self, sigma: Array | None = None) -> Array:
        """Compute the covariance (m, 3, 3) of the errors about the body's axes, rad², of these or other sigmas (m, 3)."""
        s = self.sigma if sigma is None else sigma
        P = np.zeros((len(s), 3, 3))
        P[:, AXES, AXES] = s**2
        if self.correlation is not None:
            P[:, ROWS, COLUMNS] = P[:, COLUMNS, ROWS] = self.correlation * s[:, ROWS] * s[:, COLUMNS]
        return P

    def build_error_axes(self, sigma: Array | None = None) -> Array | None:
        """Build D (m, 3, 3) of errors D ν, ν independent with these or other sigmas; None if the errors are independent."""
        if self.correlation is None:
            return None
        s = self.sigma if sigma is None else sigma
        return np.asarray(np.linalg.cholesky(self.compute_covariance(s)) / s[:, None])

    def select_rows(self, rows: Any) -> Attitudes:
        """Select references by their rows."""
        correlation = None if self.correlation is None else self.correlation[rows]
        return replace(
            self, t_s=self.t_s[rows], quaternions=self.quaternions[rows], sigma=self.sigma[rows], correlation=correlation
        )

    def replace_covariance(self, P: Array) -> Attitudes:
        """Replace the covariances of the attitudes by P (m, 3, 3), rad²."""
        s, covariance = np.sqrt(np.diagonal(P, axis1=1, axis2=2)), P[:, ROWS, COLUMNS]
        return replace(self, sigma=s, correlation=covariance / (s[:, ROWS] * s[:, COLUMNS]) if covariance.any() else None)

    @property
    def sigma_deg(self) -> Array:
        """(m, 3) 1-sigma per body axis, deg."""
        return np.asarray(np.rad2deg(self.sigma))


@dataclass(frozen=True)
class Orbit:
    """Orbit of the recording, None where unknown; node and argument of latitude are those at the epoch."""

    period_s: float
    altitude_km: float
    inclination_deg: float
    raan_deg: float | None = None
    argument_of_latitude_deg: float | None = None


def build_empty_attitudes() -> Attitudes:
    """Build reference attitudes without rows."""
    return Attitudes(np.empty(0), np.empty((0, 4)), np.empty((0, 3)))


def find_reference_rows(t_s: Array, interval: Interval) -> Indices:
    """Find the rows of the reference attitudes inside an interval, both ends included."""
    inside = (t_s >= interval.start_s - TIME_TOLERANCE_S) & (t_s <= interval.stop_s + TIME_TOLERANCE_S)
    return np.flatnonzero(inside)
