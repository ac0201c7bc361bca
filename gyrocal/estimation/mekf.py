"""Multiplicative extended Kalman filter: attitude and gyro bias, or any of the twelve gyro parameters.

The gyro replaces a dynamics model: its samples, adjusted with the present parameters, propagate the attitude, and sensor
measurements correct attitude and parameters. State, transition, noise and correction are those of
`gyrocal.estimation.error_state`. By default the solved-for parameters are the three biases and G is fixed, as N section VI has
it; `gyrocal.estimation.full_filter` takes all twelve.

`KalmanFilter` takes a sample or a measurement and forgets it. `gyrocal.estimation.filter_run` does a recorded stream and
series of measurements, and goes back over it.

A gate rejects a measurement whose normalised innovation squared, zᵀ S⁻¹ z, a good one would exceed with the stated
probability. It takes P for consistent: a filter whose attitude is wrong by more than it knows rejects everything, and what a
gate keeps out is no longer Gaussian. It is off by default.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy.special
from numpy.typing import NDArray

from gyrocal.arrays import Array, Indices
from gyrocal.calibration.parameters import BIAS_NAMES, NAMES, GyroParameters, select
from gyrocal.errors import InputError
from gyrocal.estimation.error_state import compute_kalman_gain, correct_attitude, propagate_step, update_covariance
from gyrocal.sensors.series import SensorModel


@dataclass(frozen=True)
class Innovation:
    """One measurement as the filter met it."""

    residual: Array  # (m,) y − h(A), of the numbers used
    S: Array  # (m, m) its covariance as the filter has it
    nis: float  # zᵀ S⁻¹ z, χ² with m degrees of freedom in a consistent filter
    accepted: bool  # whether it was within the gate and has been used
    H: Array  # (m, 3) sensitivity to the attitude error
    K: Array  # (n, m) gain, zero if it was not accepted
    used: NDArray[np.bool_]  # (model's size,) which of the sensor's numbers those are


class KalmanFilter:
    """The filter, one sample or one measurement at a time, in constant memory.

    Parameters
    ----------
    A : (3, 3) attitude to start from
    parameters : G and b to start from
    covariance : (3 + p, 3 + p) of the errors of A and of the solved-for parameters; rad, G dimensionless, rad/s
    arw : rad/√s
    rate_random_walk : of the biases, rad/s^1.5
    names : solved-for parameters, see `gyrocal.calibration.parameters.select`
    gate : probability of rejecting a good measurement; None uses all

    Attributes
    ----------
    A : (3, 3) present attitude, inertial to body
    x : (12,) present G and b in the order of `NAMES`
    P : (3 + p, 3 + p) present covariance

    Raises
    ------
    InputError
        The covariance does not fit, or a bias walks that is not solved for.
    """

    def __init__(
        self,
        A: Array,
        parameters: GyroParameters,
        covariance: Array,
        arw: float,
        rate_random_walk: float = 0.0,
        names: str | Iterable[str] = "bias",
        gate: float | None = None,
    ):
        self.names = select(names)
        if rate_random_walk > 0 and self.names[-3:] != BIAS_NAMES:
            raise InputError("a bias that walks must be solved for: with a rate random walk the filter needs all three")
        if gate is not None and not 0 < gate < 1:
            raise InputError(f"the gate must be a probability between 0 and 1, not {gate:g}")
        self.columns: Indices = np.array([NAMES.index(name) for name in self.names])
        self.arw, self.rate_random_walk, self.gate = float(arw), float(rate_random_walk), gate
        self.x = parameters.vector
        self._R, self._B = np.empty((3, 3)), np.empty((3, len(self.names)))
        self.P = np.empty((0, 0))
        self.restart(A, covariance)

    @property
    def parameters(self) -> GyroParameters:
        """Present G and b."""
        return GyroParameters.from_vector(self.x)

    def restart(self, A: Array, covariance: Array) -> None:
        """Take another attitude A (3, 3) and covariance, as after a gap; the parameters stay as they are."""
        n = 3 + len(self.names)
        P = np.array(covariance, dtype=float)
        if P.shape != (n, n) or not np.isfinite(P).all() or not np.allclose(P, P.T):
            raise InputError(f"the covariance of attitude and {n - 3} parameters must be symmetric and {n}×{n}, not {P.shape}")
        self.A, self.P = np.array(A, dtype=float), P

    def step(self, raw: Array, dt: float) -> tuple[Array, Array]:
        """Propagate over one gyro sample, raw (3,) rad/s held for dt seconds.

        Returns
        -------
        R (3, 3) and ψF (3, p) of the step; overwritten by the next.
        """
        noise = (self.arw, self.rate_random_walk)
        propagate_step(self.A, self.P, self.x, np.asarray(raw, dtype=float), float(dt), self.columns, *noise, self._R, self._B)
        return self._R, self._B

    def update(self, model: SensorModel, row: int, y: Array, sigma: Array) -> Innovation | None:
        """Correct with one measurement.

        Parameters
        ----------
        model : the sensor
        row : row of its series
        y, sigma : (m,) measurement and 1-sigma, infinite where a number is not to be used

        Returns
        -------
        The innovation, or None if no number was to be used, or the sensor should see nothing at this attitude.
        """
        stated = np.isfinite(sigma)
        if not stated.any():
            return None
        rows = np.array([row])
        expected = model.predict(self.A[None], rows)[0]
        used = stated & np.isfinite(expected)
        if not used.any():
            return None
        z, H = y - expected, model.jacobian(self.A[None], rows)[0]
        if not used.all():
            z, H, sigma = z[used], H[used], sigma[used]
        H, sigma = np.ascontiguousarray(H), np.ascontiguousarray(sigma)
        K, S, nis = compute_kalman_gain(self.P, H, sigma, z)
        if self.gate is not None and nis > scipy.special.chdtri(len(z), self.gate):
            return Innovation(z, S, nis, False, H, np.zeros_like(K), used)
        update_covariance(self.P, K, H, sigma)
        self.correct(K @ z)
        return Innovation(z, S, nis, True, H, K, used)

    def correct(self, state: Array) -> None:
        """Move the estimate by an estimated state (n,): A ← exp([θ×]) A, x ← x − Δx."""
        self.A = correct_attitude(self.A, state[:3])
        self.x[self.columns] -= state[3:]
