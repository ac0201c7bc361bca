"""A recording prepared for evaluation at any parameters, and for other noise on the same motion.

Preparing (steps, pieces, groups of correlated residuals) is done once; what follows is the compiled core of
`gyrocal.calibration.normal_equations`. A Monte Carlo study prepares a `Problem` once and evaluates it for each case's rates
and attitudes.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrocal import attitude
from gyrocal.arrays import Array, Indices
from gyrocal.calibration import gate
from gyrocal.calibration import normal_equations as accumulation
from gyrocal.calibration.covariance import (
    FULL,
    JOINT,
    MODEL_CODES,
    CovarianceModel,
    find_chains,
    group_residuals,
    integrate_white_noise,
    model_covariance,
    whiten_chain,
)
from gyrocal.calibration.gyro_space import Parametrisation, select_parameter_space
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from gyrocal.calibration.parameters import NAMES, GyroParameters
from gyrocal.calibration.propagation import Psi, propagate
from gyrocal.calibration.sampling import Measurements
from gyrocal.errors import InputError
from gyrocal.recording import Recording

if TYPE_CHECKING:
    import pandas as pd

BoolArray = NDArray[np.bool_]

ROTATION_NAMES = ("roll", "pitch", "yaw")


@dataclass(frozen=True)
class State:
    """A problem evaluated at one set of parameters."""

    # theta, theta_linear: (m, 3) residuals by the full rotation vector N (16) and by the linear form N (29), rad
    theta: Array
    theta_linear: Array
    sigma: Array  # (m, 3) 1-sigma of each residual under the covariance model, rad
    # H, z: (3m, p) and (3m,) whitened scaled sensitivity and residuals, group by group
    H: Array
    z: Array

    @property
    def chi2(self) -> float:
        """Σ θᵀ V⁻¹ θ."""
        return float(self.z @ self.z)


@dataclass(frozen=True)
class Iterates:
    """Results of a fixed number of iterations of a case."""

    x: Array  # (iterations + 1, 12) parameters at the start and after each iteration
    theta: Array  # (iterations + 1, m, 3) residuals there, rad
    P: Array  # (p, p) covariance of the last iteration; G dimensionless, b rad/s
    chi2: float  # Σ θᵀ V⁻¹ θ after it

    def check_convergence(self) -> "Iterates":
        """Return these iterates if each is within what one linearisation can correct; they must look back.

        An `InputError` if they diverged: a residual is beyond `LARGEST_RESIDUAL`, or a number is not finite.
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
    """A recording, its steps, and how it is to be evaluated."""

    measurements: Measurements  # steps and references, see `gyrocal.calibration.sampling.prepare_measurements`
    A: Array  # (references, 3, 3) observed attitudes
    noise: Array  # (references, 3, 3) covariance of each in body axes, rad²
    arw: float  # rad/sqrt(s), of the full stream
    names: tuple[str, ...] = NAMES  # solved-for parameters
    psi: Psi = "full"  # "full" or "linear"
    model: str = "full"  # covariance model, or "given"
    # with "given": (intervals, 3, 3) C of each interval's residuals, or (3m, 3m) V of all residuals
    given: Array | None = None
    # "gain" or "gyro", see `gyrocal.calibration.gyro_space`; the names are of its parameters
    parametrisation: Parametrisation = "gain"

    @classmethod
    def build(
        cls,
        recording: Recording,
        measurements: Measurements,
        names: tuple[str, ...] = NAMES,
        psi: Psi = "full",
        model: CovarianceModel = "full",
        given: Array | None = None,
        parametrisation: Parametrisation = "gain",
    ) -> "Problem":
        """Prepare a recording."""
        A = attitude.matrix_from_quaternion(recording.attitudes.quaternions)
        code = model if given is None else "given"
        noise = recording.attitudes.compute_covariance()
        return cls(measurements, A, noise, recording.gyro.arw, names, psi, code, given, parametrisation)

    @cached_property
    def columns(self) -> Indices:
        """(p,) positions of the solved-for parameters among the twelve."""
        known = select_parameter_space(self.parametrisation).names
        return np.array([known.index(name) for name in self.names])

    @cached_property
    def scale(self) -> Array:
        """(p,) plausible range of each."""
        return PLAUSIBLE_RANGE[self.columns]

    @cached_property
    def groups(self) -> tuple[Indices, Indices]:
        """Residuals group by group, and one past the end of each group, of those that correlate."""
        measurements = self.measurements
        if self._model[0] == JOINT:
            return np.arange(len(measurements.row)), np.array([len(measurements.row)])
        return group_residuals(measurements.arcs.arc, measurements.start, measurements.row)

    @cached_property
    def _chained(self) -> BoolArray:
        """(groups,) whether each is a chain, whose residuals are whitened one after another."""
        return find_chains(*self.groups, *self.references[:3]) & (self._model[0] == FULL)

    @cached_property
    def references(self) -> tuple[Indices, Indices, Indices, Array]:
        """Interval, start, row and noise, as in `gyrocal.calibration.covariance.compute_residual_covariance`."""
        measurements = self.measurements
        return measurements.arcs.arc, measurements.start, measurements.row, np.ascontiguousarray(self.noise)

    @cached_property
    def walk(self) -> Array:
        """(m, 3, 3) covariance of the integrated gyro noise, alike about all axes, rad²."""
        measurements = self.measurements
        return integrate_white_noise(measurements.elapsed_s, self.arw * float(np.sqrt(measurements.noise_gain)))

    @cached_property
    def _model(self) -> tuple[int, Array]:
        """Code of the covariance model, and `given` as in `gyrocal.calibration.covariance.model_covariance`."""
        given = np.zeros((0, 3, 3)) if self.given is None else np.ascontiguousarray(self.given)
        return (JOINT, given[None]) if given.ndim == 2 else (MODEL_CODES[self.model], given)

    def covariance(self, R: Array, rows: Indices) -> Array:
        """Compute V (3k, 3k) of some residuals (k,) of one group, with R (k, 3, 3) there, rad²."""
        interval, start, row, noise = self.references
        return np.asarray(model_covariance(R, interval[rows], start[rows], row[rows], noise, self.walk[rows], *self._model))

    def state(self, parameters: GyroParameters) -> State:
        """Evaluate residuals, sensitivities and covariances at some parameters.

        A `gyrocal.calibration.gate.LargeResidualError` if a residual is too large to be corrected by linearisation.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            propagation = propagate(self.measurements.arcs, parameters.G, parameters.bias, self.psi)
            R, measurements = propagation.R, self.measurements
            A_start, A_obs = self.A[measurements.start], self.A[measurements.row]
            theta = accumulation.compute_attitude_residuals(R, A_start, A_obs)
        gate.check_residual_size(np.where(np.isfinite(R).all(axis=2), theta, np.inf))
        theta_linear = attitude.residual_linear(A_obs, R @ A_start)
        values = np.column_stack([self._compute_sensitivity(propagation.S, parameters), theta.ravel()])
        # Where all groups are chains, the functions for others are not called: they take as long to compile.
        if self._chained.all():
            white, variance = np.empty_like(values), np.empty_like(theta)
            whiten_chain(self.groups[0], values, R, self.references, self.walk, white, variance)
        else:
            groups = *self.groups, self._chained
            white, variance = accumulation.whiten_groups(values, R, groups, self.references, self.walk, *self._model)
        return State(theta, theta_linear, np.sqrt(variance), white[:, :-1].copy(), white[:, -1].copy())

    def _compute_sensitivity(self, S: Array, parameters: GyroParameters) -> Array:
        """Compute Θ D (3m, p) with respect to the solved-for parameters."""
        if self.parametrisation == "gain":
            return np.asarray(accumulation.build_sensitivity(S, self.columns, self.scale))
        J = select_parameter_space(self.parametrisation).jacobian(parameters)[:, self.columns] * self.scale
        return np.asarray(accumulation.build_sensitivity(S, np.arange(12), PLAUSIBLE_RANGE) @ (J / PLAUSIBLE_RANGE[:, None]))

    def iterate(self, x: Array, iterations: int, psi: Psi | None = None, look_back: bool = True) -> Iterates:
        """Iterate a fixed number of times in (G, b) without a prior, compiled from end to end.

        x: (12,) parameters to start from
        psi: in place of the problem's
        look_back: whether to propagate once more for the residuals after the last iteration; NaN without
        """
        if self.parametrisation != "gain":
            raise InputError("compiled iterations are those of the parametrisation 'gain'")
        arcs = self.measurements.arcs
        x = np.ascontiguousarray(x, dtype=float)
        values: tuple[Any, ...] = accumulation.iterate(
            iterations,
            x,
            self.columns,
            self.scale,
            (arcs.increments, arcs.ends, arcs.last),
            (psi or self.psi) == "linear",
            arcs.is_beyond_series(x[:9].reshape(3, 3), x[9:]),
            self.A[self.measurements.start],
            self.A[self.measurements.row],
            (*self.groups, self._chained),
            self.references,
            self.walk,
            *self._model,
            look_back,
        )
        return Iterates(*values)

    def replace_case(self, rates: Array, A: Array, workspace: Array | None = None) -> "Problem":
        """Build the problem of another case: gyro rates (samples, 3) rad/s and observed attitudes (references, 3, 3).

        A workspace (see `gyrocal.calibration.propagation.Arcs`) makes the new problem valid only until the next case is packed
        into it.
        """
        measurements = replace(self.measurements, arcs=self.measurements.arcs.replace_rates(rates, workspace))
        problem = replace(self, measurements=measurements, A=A)
        # What does not depend on the case is handed on.
        for name in ("columns", "scale", "groups", "references", "walk", "_model", "_chained"):
            problem.__dict__[name] = getattr(self, name)
        return problem


def tabulate_residuals(recording: Recording, prepared: Measurements, before: State, after: State) -> "pd.DataFrame":
    """Tabulate residuals before and after a calibration, and the sigma that the covariance gives each; a row an output, deg.

    Residuals stand in the full form N (16) and, as "linear", in the linear form N (29).
    """
    import pandas as pd  # late: 65 MiB that a Monte Carlo worker does without

    columns: dict[str, Any] = {
        "interval": [recording.intervals[k].name for k in prepared.arcs.arc],
        "t_s": recording.attitudes.t_s[prepared.row],
    }
    values = {"before": before.theta, "before_linear": before.theta_linear}
    values |= {"after": after.theta, "after_linear": after.theta_linear, "sigma": after.sigma}
    for label, angles in values.items():
        columns |= {f"{label}_{name}_deg": np.rad2deg(angles[:, k]) for k, name in enumerate(ROTATION_NAMES)}
    return pd.DataFrame(columns)
