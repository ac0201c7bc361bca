"""A recording prepared for evaluation at any parameters, and for other noise on the same motion.

Preparing (steps, pieces, groups of correlated residuals) is done once; what follows is the compiled core of
`gyrocal.calibration.normal_equations`. A Monte Carlo study prepares a `Problem` once and evaluates it for each case's rates
and attitudes.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal import attitude
from gyrocal.calibration import gate
from gyrocal.calibration import normal_equations as accumulation
from gyrocal.calibration.covariance import JOINT, MODEL_CODES, CovarianceModel, chained, residual_covariance
from gyrocal.calibration.gyro_space import Parametrisation, space_of
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from gyrocal.calibration.parameters import NAMES, GyroParameters
from gyrocal.calibration.propagation import Psi, propagate
from gyrocal.calibration.sampling import Measurements
from gyrocal.calibration.trackers import Eliminated, Mountings, grouped
from gyrocal.calibration.trackers import residual_covariance as of_several
from gyrocal.errors import InputError
from gyrocal.recording import Recording
from gyrocal.recording.trackers import covariance as in_body_axes

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class State:
    """A problem evaluated at one set of parameters.

    Attributes
    ----------
    theta, theta_linear : (m, 3) residuals by the full rotation vector N (16) and by the linear form N (29), rad
    sigma : (m, 3) 1-sigma of each residual under the covariance model, rad
    H, z : (3m, p) and (3m,) whitened scaled sensitivity and residuals, group by group; with mountings that are estimated,
        these taken out of them
    eliminated : how that was done; None where none is
    """

    theta: Array
    theta_linear: Array
    sigma: Array
    H: Array
    z: Array
    eliminated: Eliminated | None = None

    @property
    def chi2(self) -> float:
        """Σ θᵀ V⁻¹ θ."""
        return float(self.z @ self.z)


@dataclass(frozen=True)
class Iterates:
    """What a fixed number of iterations made of a case.

    Attributes
    ----------
    x : (iterations + 1, 12) parameters at the start and after each iteration
    theta : (iterations + 1, m, 3) residuals there, rad
    P : (p, p) covariance of the last iteration; G dimensionless, b rad/s
    chi2 : Σ θᵀ V⁻¹ θ after it
    """

    x: Array
    theta: Array
    P: Array
    chi2: float

    def checked(self) -> "Iterates":
        """These, if each iteration was within what one linearisation can correct, as `Problem.state` asks; they must look back.

        Raises
        ------
        InputError
            They diverged: a residual is beyond `LARGEST_RESIDUAL`, or a number is not finite.
        """
        largest = np.linalg.norm(self.theta, axis=2).max(axis=1)
        if not (largest <= gate.LARGEST_RESIDUAL).all():  # NaN too
            k = int(np.argmax(~(largest <= gate.LARGEST_RESIDUAL)))
            when = f"after iteration {k}" if k else "under the parameters to start from"
            raise InputError(
                f"diverged: an attitude residual of {np.rad2deg(largest[k]):.1f} deg {when} is too large to linearise"
            )
        if not (np.isfinite(self.x).all() and np.isfinite(self.P).all() and (np.diag(self.P) >= 0).all()):
            raise InputError("diverged: the estimate or its covariance is not finite")
        return self


@dataclass(frozen=True)
class Problem:
    """A recording, its steps, and how it is to be evaluated.

    Attributes
    ----------
    measurements : steps and references, see `gyrocal.calibration.sampling.measurements`
    A : (references, 3, 3) observed attitudes
    sigma : (references, 3) rad
    arw : rad/sqrt(s), of the full stream
    names : solved-for parameters
    psi : "full" or "linear"
    model : covariance model, or "given"
    given : (intervals, 3, 3) C of each interval's residuals, with "given"
    joint : (3m, 3m) V of all residuals, with "given", in place of `given`
    parametrisation : "gain" or "gyro", see `gyrocal.calibration.gyro_space`; the names are of its parameters
    noise : (references, 3, 3) covariance of each in body axes, of references by several sensors; None for `sigma` about them
    mountings : of sensors whose mounting is estimated, as adjusted so far; None for a single sensor
    """

    measurements: Measurements
    A: Array
    sigma: Array
    arw: float
    names: tuple[str, ...] = NAMES
    psi: Psi = "full"
    model: str = "full"
    given: Array | None = None
    joint: Array | None = None
    parametrisation: Parametrisation = "gain"
    noise: Array | None = None
    mountings: Mountings | None = None

    @classmethod
    def of(
        cls,
        recording: Recording,
        measurements: Measurements,
        names: tuple[str, ...] = NAMES,
        psi: Psi = "full",
        model: CovarianceModel = "full",
        given: Array | None = None,
        joint: Array | None = None,
        parametrisation: Parametrisation = "gain",
    ) -> "Problem":
        """Prepare a recording."""
        A = attitude.matrix_from_quaternion(recording.attitudes.quaternions)
        code = model if given is None and joint is None else "given"
        sigma, arw = recording.attitudes.sigma, recording.gyro.arw
        noise = mountings = None
        if recording.attitudes.sensor is not None:
            if code != "full":
                raise InputError(f"covariance '{code}': references of several sensors take the full one")
            noise, mountings = in_body_axes(recording.attitudes), Mountings.of(recording.attitudes)
        return cls(measurements, A, sigma, arw, names, psi, code, given, joint, parametrisation, noise, mountings)

    @cached_property
    def columns(self) -> Indices:
        """(p,) positions of the solved-for parameters among the twelve."""
        known = space_of(self.parametrisation).names
        return np.array([known.index(name) for name in self.names])

    @cached_property
    def scale(self) -> Array:
        """(p,) plausible range of each."""
        return PLAUSIBLE_RANGE[self.columns]

    @cached_property
    def groups(self) -> tuple[Indices, Indices]:
        """Residuals group by group, and one past the end of each group, of those that correlate."""
        prepared = self.measurements
        if self.joint is not None:
            return np.arange(len(prepared.row)), np.array([len(prepared.row)])
        if self.noise is not None:
            return grouped(prepared.arcs.arc, prepared.start, prepared.row)
        arcs, firsts = np.unique(prepared.arcs.arc, return_index=True)
        lasts = np.append(firsts[1:], len(prepared.row)) - 1
        members = [
            np.flatnonzero(np.isin(prepared.arcs.arc, arcs[group]))
            for group in chained(prepared.start[firsts], prepared.row[lasts])
        ]
        return np.concatenate(members), np.cumsum([len(rows) for rows in members])

    @cached_property
    def _covariance(self) -> tuple[float, int, Array]:
        arw = self.arw * float(np.sqrt(self.measurements.noise_gain))
        if self.joint is not None:
            return arw, JOINT, np.ascontiguousarray(self.joint)[None]
        given = np.zeros((0, 3, 3)) if self.given is None else np.ascontiguousarray(self.given)
        return arw, MODEL_CODES[self.model], given

    @cached_property
    def _references(self) -> tuple[Indices, Indices, Array, Array]:
        prepared = self.measurements
        return prepared.start, prepared.row, prepared.elapsed_s, np.ascontiguousarray(self.sigma)

    def state(self, parameters: GyroParameters) -> State:
        """Residuals, sensitivities and covariances at these parameters.

        Raises
        ------
        gyrocal.calibration.gate.LargeResidualError
            A residual is too large to be corrected by linearisation.
        """
        prepared = self.measurements
        with np.errstate(over="ignore", invalid="ignore"):
            propagation = propagate(prepared.arcs, parameters.G, parameters.bias, self.psi)
        A = self.A if self.mountings is None else self.mountings.corrected(self.A)
        A_start, A_obs = A[prepared.start], A[prepared.row]
        theta = accumulation.residuals(propagation.R, A_start, A_obs)
        gate.check(np.where(np.isfinite(propagation.R).all(axis=2), theta, np.inf))
        Theta = self._sensitivity(propagation.S, parameters)
        if self.noise is not None:
            linear = attitude.residual_linear(A_obs, propagation.R @ A_start)
            return self._of_several(theta, linear, Theta, propagation.R)
        start, row, elapsed_s, sigma = self._references
        options = (*self.groups, prepared.arcs.arc, start, row, elapsed_s, sigma, *self._covariance)
        H, z = accumulation.whitened(theta, Theta, propagation.R, *options)
        alone = [self._alone(propagation.R, k) for k in range(len(theta))]
        return State(theta, attitude.residual_linear(A_obs, propagation.R @ A_start), np.sqrt(np.array(alone)), H, z)

    def _of_several(self, theta: Array, linear: Array, Theta: Array, R: Array) -> State:
        """The state with references of several sensors."""
        assert self.noise is not None
        assert self.mountings is not None
        made, arw, q = self.measurements, self._covariance[0], self.mountings.misalignment.size
        values = np.column_stack([Theta, self.mountings.sensitivity(R, made.start, made.row), theta.ravel()])
        white, variance = np.empty_like(values), np.empty(theta.size)
        rows, ends = self.groups
        for own in np.split(rows, ends[:-1]):
            V = of_several(R[own], made.arcs.arc[own], made.start[own], made.row[own], made.elapsed_s[own], self.noise, arw)
            places = (3 * own[:, None] + np.arange(3)).ravel()
            white[places] = accumulation.whiten(V, values[places])
            variance[places] = np.diag(V)
        p = Theta.shape[1]
        H, z, sigma = white[:, :p], white[:, -1], np.sqrt(variance).reshape(-1, 3)
        if not q:
            return State(theta, linear, sigma, H, z)
        free = self.mountings.eliminated(H, z, white[:, p:-1])
        return State(theta, linear, sigma, free.H, free.z, free)

    def after(self, state: State, change: Array) -> "Problem":
        """The problem with mountings as they are after a correction Δx (p,) of the solved-for parameters."""
        if self.mountings is None:
            return self
        return replace(self, mountings=self.mountings.moved(state.eliminated, change / self.scale))

    def _sensitivity(self, S: Array, parameters: GyroParameters) -> Array:
        """Θ D (3m, p) with respect to the solved-for parameters."""
        if self.parametrisation == "gain":
            return np.asarray(accumulation.sensitivity(S, self.columns, self.scale))
        J = space_of(self.parametrisation).jacobian(parameters)[:, self.columns] * self.scale
        return np.asarray(accumulation.sensitivity(S, np.arange(12), PLAUSIBLE_RANGE) @ (J / PLAUSIBLE_RANGE[:, None]))

    def _alone(self, R: Array, k: int) -> Array:
        """(3,) variance of residual k by itself, rad²."""
        if self.joint is not None:
            return np.diag(self.joint)[3 * k : 3 * k + 3]
        start, row, elapsed_s, sigma = self._references
        one = slice(k, k + 1)
        arc = self.measurements.arcs.arc[one]
        return np.diag(residual_covariance(R[one], arc, start[one], row[one], elapsed_s[one], sigma, *self._covariance))

    def iterate(self, x: Array, iterations: int, psi: Psi | None = None, look_back: bool = True) -> Iterates:
        """A fixed number of iterations in (G, b) without a prior, compiled from end to end.

        Parameters
        ----------
        x : (12,) parameters to start from
        iterations : how many
        psi : in place of the problem's
        look_back : whether to propagate once more for the residuals after the last iteration; NaN without
        """
        if self.parametrisation != "gain" or self.noise is not None:
            raise InputError("compiled iterations are those of the parametrisation 'gain' and of references by one sensor")
        arcs = self.measurements.arcs
        x = np.ascontiguousarray(x, dtype=float)
        values: tuple[Any, ...] = accumulation.iterate(
            iterations,
            x,
            self.columns,
            self.scale,
            (arcs.increments, arcs.ends, arcs.last, arcs.arc),
            (psi or self.psi) == "linear",
            arcs.beyond_series(x[:9].reshape(3, 3), x[9:]),
            self.A[self.measurements.start],
            self.A[self.measurements.row],
            self.groups,
            self._references,
            *self._covariance,
            look_back,
        )
        return Iterates(*values)

    def with_case(self, rates: Array, A: Array, workspace: Array | None = None) -> "Problem":
        """The same problem with another case's gyro rates (samples, 3) rad/s and observed attitudes (references, 3, 3).

        A workspace (see `gyrocal.calibration.propagation.Arcs`) makes the new problem valid only until the next case is packed
        into it.
        """
        moved = replace(self.measurements, arcs=self.measurements.arcs.with_rates(rates, workspace))
        new = replace(self, measurements=moved, A=A)
        # What does not depend on the case is handed on.
        for name in ("columns", "scale", "groups", "_covariance", "_references"):
            new.__dict__[name] = getattr(self, name)
        return new
