"""The Davenport gyro calibration in the recursive form of N section IV.

The state error Δx = x_adj − x_true moves the residual of a maneuver, exp([θ×]) = A_obs A_propᵀ (N 16), by θ = Θ Δx, with
δω = ω_adj − ω_true = F Δx. Maneuver by maneuver,

    u ← u + Θᵀ C⁻¹ θ,    W ← W + Θᵀ C⁻¹ Θ                                                        N (31), (32)
    Δx = P u,  P = W⁻¹,    x ← x − Δx                                                                  N (33)

With an a-priori covariance P₀ about x₀, W starts at P₀⁻¹ and u at P₀⁻¹ (x − x₀), so that further iterations do not count
the prior twice. N (29) as printed has the opposite sign of N (16); see `gyrocal.attitude`. A sign slip here diverges: the
tests recover known parameters from noise-free data.

x is (G, b), or each gyro's own scale factor, axis and bias, as N has it: see `gyrocal.calibration.gyro_space`.

`RecursiveCalibrator` takes samples and forgets them. `calibrate` does a whole recording with the compiled pass, iterates, and
accepts series of reference attitudes, whose residuals correlate within an interval: then C is the joint covariance of a
group of residuals, see `gyrocal.calibration.covariance`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gyrocal import attitude
from gyrocal.arrays import Array, Indices
from gyrocal.calibration import normal_equations as accumulation
from gyrocal.calibration.attenuation import estimate_attenuation
from gyrocal.calibration.covariance import CovarianceModel
from gyrocal.calibration.estimated_noise import count_noise_degrees
from gyrocal.calibration.gate import LargeResidualError, build_refusal
from gyrocal.calibration.gyro_space import Parametrisation, select_parameter_space
from gyrocal.calibration.observability import PLAUSIBLE_RANGE, evaluate_observability, list_combinations
from gyrocal.calibration.parameters import GyroParameters, select
from gyrocal.calibration.plausible_ranges import PlausibleRanges, estimate_plausible_ranges
from gyrocal.calibration.problem import Problem, State, tabulate_residuals
from gyrocal.calibration.propagation import Psi, StreamingPropagation
from gyrocal.calibration.result import PLAUSIBLE_PRIOR, CalibrationResult
from gyrocal.calibration.sampling import Resampling, prepare_measurements
from gyrocal.errors import InputError, UnobservableError
from gyrocal.recording import Recording

if TYPE_CHECKING:
    import pandas as pd


logger = logging.getLogger(__name__)

SINGULAR = 1e-14  # eigenvalue of a correlation matrix that is rounding


class Accumulation:
    """u and W of N (31)–(32), and the solution (33), for the solved-for parameters.

    Parameters are scaled by their plausible range inside, since W spans twelve decades in units of G and rad/s.

    columns: (p,) positions of the solved-for parameters among the twelve
    apriori_covariance: (p, p) P₀, biases in rad/s and the others dimensionless, or None
    apriori_error: (p,) x − x₀, zero at the first iteration
    """

    def __init__(self, columns: Indices, apriori_covariance: Array | None = None, apriori_error: Array | None = None):
        self.scale = PLAUSIBLE_RANGE[columns]
        p = len(columns)
        self.W: Array = np.zeros((p, p))
        self.u: Array = np.zeros(p)
        if apriori_covariance is not None:
            self.W = np.asarray(np.linalg.inv(apriori_covariance / np.outer(self.scale, self.scale)))
            self.u = self.W @ ((np.zeros(p) if apriori_error is None else apriori_error) / self.scale)

    def add(self, H: Array, z: Array) -> None:
        """Add whitened residuals z (r,) with whitened, scaled sensitivity H (r, p)."""
        self.W += H.T @ H
        self.u += H.T @ z

    def solve(self) -> tuple[Array, Array]:
        """Solve for Δx (p,) and P (p, p)."""
        P = np.asarray(np.linalg.inv(self.W) * np.outer(self.scale, self.scale))
        return np.asarray(self.scale * np.linalg.solve(self.W, self.u)), P


class RecursiveCalibrator:
    """One pass of N section IV, sample by sample, in constant memory: one residual a maneuver.

    Parameters
    ----------
    parameters : what the rates are adjusted with
    arw : rad/sqrt(s); adds ARW² T to each maneuver's C, zero for the paper's
    solve_for : see `gyrocal.calibration.parameters.select`
    psi : "full" or "linear"
    apriori_covariance : (p, p) or None
    parametrisation : "gain" or "gyro", see `gyrocal.calibration.gyro_space`
    """

    def __init__(
        self,
        parameters: GyroParameters,
        arw: float = 0.0,
        solve_for: str | Iterable[str] = "all",
        psi: Psi = "full",
        apriori_covariance: Array | None = None,
        parametrisation: Parametrisation = "gain",
    ):
        self.parameters = parameters
        self._space = select_parameter_space(parametrisation)
        self.names = select(solve_for, self._space.names)
        self._columns = np.array([self._space.names.index(name) for name in self.names])
        self._jacobian = self._space.jacobian(parameters)[:, self._columns]
        self._arw, self._psi = arw, psi
        self._sums = Accumulation(self._columns, apriori_covariance)

    def start(self, A_obs: Array, sigma: Array) -> None:
        """Begin a maneuver at the observed attitude A_obs (3, 3), with 1-sigma (3,) rad per body axis."""
        self._A, self._C = np.array(A_obs), np.diag(np.square(sigma))
        self._pass = StreamingPropagation(self.parameters.G, self.parameters.bias, psi=self._psi)

    def sample(self, raw: Array, dt: float) -> None:
        """Propagate over one gyro sample, raw (3,) rad/s over dt seconds."""
        self._pass.update(raw, dt)

    def finish(self, A_obs: Array, sigma: Array) -> Array:
        """End the maneuver at the observed attitude; return the residual θ (3,) of N (16), rad."""
        R = self._pass.R
        theta = attitude.residual(A_obs, R @ self._A)
        C = np.diag(np.square(sigma)) + R @ self._C @ R.T + self._arw**2 * self._pass.t * np.eye(3)
        Theta = self._pass.Theta @ self._jacobian * self._sums.scale
        white = accumulation.whiten(C, np.column_stack([Theta, theta]))
        self._sums.add(white[:, :-1], white[:, -1])
        return theta

    def solve(self) -> tuple[GyroParameters, Array]:
        """Solve N (33) after the last maneuver: corrected parameters, and the covariance (p, p) of those solved for."""
        correction, P = self._sums.solve()
        x = self._space.vector(self.parameters)
        x[self._columns] -= correction
        return self._space.parameters(x), P


def calibrate(
    recording: Recording,
    *,
    initial: GyroParameters | None = None,
    solve_for: str | Iterable[str] = "all",
    psi: Psi = "full",
    iterations: int | None = None,
    max_iterations: int = 10,
    tolerance_G: float = 1e-9,
    tolerance_bias: float = 1e-12,
    apriori_covariance: Array | None = None,
    covariance_model: CovarianceModel = "full",
    interval_covariance: Array | None = None,
    residual_covariance: Array | None = None,
    step_s: float | None = None,
    resampling: Resampling = "average",
    max_gap_s: float | None = None,
    plausible_G: float | None = None,
    plausible_bias: float | None = None,
    parametrisation: Parametrisation = "gain",
) -> CalibrationResult:
    """Calibrate the gyro of a recording.

    Parameters
    ----------
    recording : gyro stream, reference attitudes (ends only, or a series), intervals
    initial : parameters to start from; the recording's a-priori ones by default
    solve_for : parameters to estimate, the rest is held; names of the parametrisation, or groups of them, see
        `gyrocal.calibration.parameters.select`
    psi : "full" N (11), or "linear" for Davenport's conventional form
    iterations : exactly so many; None iterates to the tolerance
    max_iterations : bound on the iterations to tolerance
    tolerance_G, tolerance_bias : largest last correction of a parameter without unit, and of a bias (rad/s)
    apriori_covariance : (p, p) of the solved-for parameters about `initial`; biases in rad/s, the others dimensionless
    covariance_model : "full" with gyro noise and shared references, or "references only", the paper's C
    interval_covariance : (intervals, 3, 3) C of each interval's residuals, rad², instead of a model
    residual_covariance : (3m, 3m) V of all m residuals together, rad², interval by interval in the order of time, instead;
        see `gyrocal.estimation.reference_covariance`
    step_s, resampling, max_gap_s : see `gyrocal.calibration.sampling.prepare_measurements`
    plausible_G, plausible_bias : how far parameters without unit, and biases (rad/s), may plausibly be off; those of the gyro's
        grade by default, see `gyrocal.calibration.plausible_ranges`. A combination the data do not determine better than that
        counts as not found; without an a-priori covariance these ranges then are the a-priori sigmas of all solved-for
        parameters about `initial`
    parametrisation : "gain" iterates in G and b of R (7); "gyro" in each gyro's own scale factor, axis and bias, as N did, and
        can calibrate one gyro alone (solve_for="gyro_x"); see `gyrocal.calibration.gyro_space`

    Returns
    -------
    CalibrationResult

    Raises
    ------
    UnobservableError
        The data determine no combination, and no a-priori covariance is given.
    InputError
        The recording or an argument cannot be used.
    """
    space = select_parameter_space(parametrisation)
    names = select(solve_for, space.names)
    p = len(names)
    if (limit := max_iterations if iterations is None else iterations) < 1:
        raise InputError(f"at least one iteration is needed, not {limit}")
    if apriori_covariance is not None:
        apriori_covariance = _check_covariance(apriori_covariance, p, "the a-priori covariance")
    if recording.without_references:
        raise InputError("calibrate: the recording has no reference attitudes")
    prepared = prepare_measurements(recording, step_s, resampling, max_gap_s)
    given = _select_given_covariance(interval_covariance, residual_covariance, len(recording.intervals), len(prepared.row))
    problem = Problem.build(recording, prepared, names, psi, covariance_model, given, parametrisation)
    ranges = estimate_plausible_ranges(recording, plausible_G, plausible_bias)
    plausible = ranges.vector(problem.columns >= 9)
    start = initial or GyroParameters(recording.gyro.apriori_G, recording.gyro.apriori_bias)
    x0 = space.vector(start)
    first = _evaluate_problem(problem, recording, start, start)
    observability = evaluate_observability(first.H / problem.scale, plausible, names)
    prior_from = None if apriori_covariance is None else "given"
    if observability.unobservable and apriori_covariance is None:
        if len(observability.unobservable) == p:
            message = _format_unobservable(recording, len(first.theta), observability.unobservable, ranges, problem)
            raise UnobservableError(message, observability.unobservable)
        apriori_covariance, prior_from = np.diag(plausible**2), PLAUSIBLE_PRIOR
    tolerance = (tolerance_G, tolerance_bias)
    last = _iterate(problem, recording, start, x0, first, apriori_covariance, iterations, max_iterations, tolerance)
    covariance = np.zeros((12, 12))
    covariance[np.ix_(problem.columns, problem.columns)] = last.P
    J = space.jacobian(last.parameters)
    attenuation = None
    if problem.model == "full":
        attenuation = estimate_attenuation(problem, last.parameters.G, J @ covariance @ J.T)
    dof, prior_chi2, prior_sigma = 3 * len(last.state.theta) - p, 0.0, None
    if apriori_covariance is not None:  # it adds p equations, as many as the solution takes away
        prior_chi2 = float(last.change @ np.linalg.solve(apriori_covariance, last.change))
        dof, prior_sigma = dof + p, dict(zip(names, np.sqrt(np.diag(apriori_covariance)).tolist(), strict=True))
    return CalibrationResult(
        recording=recording.title,
        parameters=last.parameters,
        initial=start,
        solved_for=names,
        own_covariance=covariance,
        covariance_model=problem.model,
        psi=psi,
        corrections=last.corrections,
        converged=last.converged,
        residuals=tabulate_residuals(recording, prepared, first, last.state),
        observability=observability,
        chi2=last.state.chi2 + prior_chi2,
        dof=dof,
        options={
            "step_s": step_s or recording.gyro.sample_s,
            "resampling": resampling,
            "max_gap_s": max_gap_s,
            "held_s": prepared.held_s,
            "prior_sigma": prior_sigma,
            "prior_from": prior_from,
            "iterations": iterations,
        },
        parametrisation=parametrisation,
        noise_degrees=count_noise_degrees(recording, dof),
        attenuation=attenuation,
        plausible=ranges,
    )


class _Iteration(NamedTuple):
    """Parameters and state after the last iteration."""

    parameters: GyroParameters
    state: State
    change: Array  # (p,) of the solved-for parameters since the start
    P: Array  # (p, p)
    corrections: tuple[GyroParameters, ...]
    converged: bool


def _iterate(
    problem: Problem,
    recording: Recording,
    start: GyroParameters,
    x0: Array,
    state: State,
    apriori_covariance: Array | None,
    iterations: int | None,
    max_iterations: int,
    tolerance: tuple[float, float],
) -> _Iteration:
    """Iterate N (31)–(33) from the start, x0 (12,) in the parametrisation, and its state; tolerance of G and of the bias."""
    space, columns = select_parameter_space(problem.parametrisation), problem.columns
    x, parameters, converged = x0, start, False
    corrections: list[GyroParameters] = []
    for _ in range(max_iterations if iterations is None else iterations):
        sums = Accumulation(columns, apriori_covariance, (x - x0)[columns])
        sums.add(state.H, state.z)
        step = np.zeros(12)
        step[columns], P = sums.solve()
        x = x - step
        previous, parameters = parameters, space.parameters(x)
        corrections.append(GyroParameters.from_vector(parameters.vector - previous.vector))
        state = _evaluate_problem(problem, recording, parameters, start)
        converged = bool(np.abs(step[:9]).max() <= tolerance[0] and np.abs(step[9:]).max() <= tolerance[1])
        if converged and iterations is None:
            break
    logger.debug("%s: %d iterations, %sconverged", recording.title, len(corrections), "" if converged else "not ")
    return _Iteration(parameters, state, (x - x0)[columns], P, tuple(corrections), converged)


def _evaluate_problem(problem: Problem, recording: Recording, parameters: GyroParameters, start: GyroParameters) -> State:
    """Evaluate a problem; for too large residuals, raise an error with the place and what would fit at the start."""
    try:
        return problem.state(parameters)
    except LargeResidualError as error:
        prepared = problem.measurements
        interval = recording.intervals[prepared.arcs.arc[error.output]].name
        t_s = recording.attitudes.t_s[prepared.row[error.output]]
        raise build_refusal(error, recording, interval, t_s, start.G, start.bias) from None


def residual_table(
    recording: Recording,
    parameters: GyroParameters,
    *,
    psi: Psi = "full",
    step_s: float | None = None,
    resampling: Resampling = "average",
    max_gap_s: float | None = None,
) -> pd.DataFrame:
    """Tabulate residuals under given parameters without estimating; the "before" columns of `CalibrationResult.residuals`."""
    prepared = prepare_measurements(recording, step_s, resampling, max_gap_s)
    state = _evaluate_problem(Problem.build(recording, prepared, psi=psi), recording, parameters, parameters)
    table = tabulate_residuals(recording, prepared, state, state)
    return table[[column for column in table.columns if not column.startswith("after")]]


def _check_covariance(value: Array, size: int, what: str) -> Array:
    """Return a covariance (size, size) as floats; an `InputError` that names it if it is not positive definite."""
    value = np.array(value, dtype=float)
    if value.shape != (size, size):
        raise InputError(f"{what} must be {size}×{size}, not {'×'.join(map(str, value.shape))}")
    variance = np.diag(value)
    if np.isfinite(value).all() and (variance > 0).all():
        # Correlations: of variances in rad², an absolute tolerance would take anything for symmetric.
        scaled = value / np.sqrt(np.outer(variance, variance))
        if np.allclose(scaled, scaled.T, rtol=0, atol=1e-6) and np.linalg.eigvalsh(scaled)[0] > SINGULAR:
            return value
    raise InputError(f"{what} must be symmetric and positive definite")


def _select_given_covariance(
    interval_covariance: Array | None, residual_covariance: Array | None, intervals: int, residuals: int
) -> Array | None:
    """Check the covariance that is given, if any, and return it: (intervals, 3, 3), or (3m, 3m) of m residuals."""
    if residual_covariance is not None:
        if interval_covariance is not None:
            raise InputError("give interval_covariance or residual_covariance, not both")
        what = f"residual_covariance, three rows for each of {residuals} residuals,"
        return _check_covariance(residual_covariance, 3 * residuals, what)
    if interval_covariance is None:
        return None
    if np.shape(interval_covariance) != (intervals, 3, 3):
        raise InputError(f"interval_covariance must be {intervals}×3×3, a C for each interval")
    return np.array([_check_covariance(C, 3, f"C of interval {k}") for k, C in enumerate(interval_covariance)])


def _format_unobservable(
    recording: Recording, references: int, combinations: tuple[str, ...], ranges: PlausibleRanges, problem: Problem
) -> str:
    """Format the error for a recording that determines no parameter combination; references: number of residual vectors."""
    intervals = len(recording.intervals)
    equations, p = 3 * references, problem.columns.size
    lead = f"{equations} equations for {p} parameters: " if equations < p else ""
    matrix, bias = ("G", "b") if problem.parametrisation == "gain" else ("s and u", "c")
    is_bias = problem.columns >= 9
    limits = [f"{ranges.G:g} in {matrix}"] if not is_bias.all() else []
    limits += [f"{ranges.bias_deg_h:.3g} deg/h in {bias}"] if is_bias.any() else []
    return (
        f"{lead}none of {p} parameter combination(s) can be found from {intervals} interval(s) with the stated noise to "
        f"within its plausible range ({', '.join(limits)}; {ranges.reason}): {list_combinations(combinations)}; "
        "add maneuvers with other rates, hold parameters that are known better (solve_for, --solve-for), state wider plausible "
        "ranges (--plausible-g, --plausible-bias) or give what is known before (apriori_covariance, --prior-sigma-g with "
        "--prior-sigma-bias)"
    )
