"""The attitude carried on by gyro alone, with its covariance.

From a time t₀ on, with the rates adjusted by parameters x, the gyro propagates an anchor attitude to A_prop(t) = R(t) A₀. The
true attitude is exp([c×]) A_prop with, to first order (see `gyrocal.calibration.covariance` for the signs),

    c(t) = R(t) (a + w(t)) + Θ(t) Δx

a the error of the anchor, w the gyro's integrated white noise in the axes of t₀, and Δx = x − x_true. A reference at t_j says
θ_j = c(t_j) + e_j. All of these are Gaussian, with the joint covariance

    cov(c(s), c(t)) = R(s) (σ_a² + ARW² min(s, t)) R(t)ᵀ + Θ(s) P₀ Θ(t)ᵀ,    cov(e_j) = diag(σ_j²)

(or the full covariance of a reference whose errors correlate), so that c at any time, and Δx, follow from the references used
by conditioning. That is the best linear estimate; it counts no reference twice, and knows that the attitude at the last
reference and the parameters correlate. Δx is applied and all is done again, since Θ is linearised.

The prior of a and Δx is up to a million times wider than their posterior, and a difference of the two would be rounding. So V
holds noise alone, V = L Lᵀ, and S u with u ~ N(0, I) are a and Δx, which F takes to c:

    [L⁻¹ F S; I] = Q U,    S u ~ N(S U⁻¹ Qᵀ [L⁻¹ z; 0], T Tᵀ),    T = S U⁻¹

L⁻¹ z, L⁻¹ F S, the walk ŵ(z) that the references show, and its covariance W come from `gyrocal.estimation.error_smoother`,
whose time and memory are linear in the number of references. With ŵ linear in its argument,

    c(t) = R ŵ(z − F S u) + F(t) S u,    cov c(t) = R W Rᵀ + B Bᵀ,    B = F(t) T − R ŵ(F S) U⁻¹

With a calibration that has a remainder the walk and the errors of the references have its processes too, see
`gyrocal.estimation.remainder_noise`.

P₀ is the covariance of x without the references of this stretch. The combinations of x that they leave free stay as wide as P₀
makes them; they do no harm to the prediction for as long as the motion goes on in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from gyrocal import attitude
from gyrocal.arrays import Array, Mask
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from gyrocal.calibration.parameters import GyroParameters
from gyrocal.calibration.plausible_ranges import estimate_plausible_ranges
from gyrocal.calibration.propagation import propagate
from gyrocal.calibration.remainder import interpolate_rates
from gyrocal.calibration.remainder_processes import compute_turns
from gyrocal.errors import InputError
from gyrocal.estimation.arc import GyroArc, build_gyro_arc
from gyrocal.estimation.error_smoother import ErrorStates
from gyrocal.estimation.remainder_noise import RemainderNoise
from gyrocal.recording import Attitudes, Recording

ANCHOR = 1e3  # sigmas of a reference: a-priori sigma of the anchor, before the reference itself is used
CALIBRATION_ITERATIONS = 3
CORRELATED_STEPS = 60  # of a stretch with rate errors that correlate: their turn is taken as constant over a step
LARGEST_PREDICTION_BYTES = 4_000_000_000
SAME_TIME_S = 1e-6
GAP_SAMPLES = 1.5  # samples
LARGEST_SIGMA = 1e6  # of a prior; a larger one is a mistake, and its square may be no number


@dataclass(frozen=True)
class Prediction:
    """Attitudes by gyro, conditioned on references.

    Attributes
    ----------
    t_s : (k,) s since the epoch
    A : (k, 3, 3) inertial to body
    covariance : (k, 3, 3) of their errors about the body's axes, rad²
    parameters : G and b, estimated from the references
    parameter_covariance : (12, 12) G dimensionless, b rad/s
    used : references that were used
    chi2, dof : χ² of the innovations of these references (each against its prediction from the earlier ones), and their number
    readings : (k, 3, 3) covariance of a reference at each time less the prediction, with the reference's remainder and without
        its stated noise, rad²
    """

    t_s: Array
    A: Array
    covariance: Array
    parameters: GyroParameters
    parameter_covariance: Array
    used: int
    chi2: float
    dof: int
    readings: Array

    @property
    def sigma(self) -> Array:
        """(k, 3) 1-sigma about each body axis, rad."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))


def prior_covariance(
    sigma_G: float | None = None,
    sigma_bias: float | None = None,
    sigma_mounting: float = 0.0,
    sigma_scale: float = 0.0,
    G: Array | None = None,
) -> Array:
    """Build P₀ (12, 12): elements of G and b by themselves, a common rotation of all gyros, and a common scale factor.

    Parameters
    ----------
    sigma_G, sigma_bias : 1-sigma of each element of G and of b (rad/s); the plausible ranges of
        `gyrocal.calibration.observability` if None
    sigma_mounting : 1-sigma about each axis, rad
    sigma_scale : 1-sigma
    G : (3, 3) that the rotation and the scale factor act on; the identity by default

    Raises
    ------
    InputError
        A sigma is negative, or larger than any gyro's.
    """
    sigmas = {"sigma_G": sigma_G, "sigma_bias": sigma_bias, "sigma_mounting": sigma_mounting, "sigma_scale": sigma_scale}
    for name, value in sigmas.items():
        if value is not None and not 0 <= value < LARGEST_SIGMA:
            raise InputError(f"prior {name} {value:g}: must not be negative, and below {LARGEST_SIGMA:g}")
    plausible = PLAUSIBLE_RANGE
    element_sigma = np.where(
        np.arange(12) < 9, plausible if sigma_G is None else sigma_G, plausible if sigma_bias is None else sigma_bias
    )
    P = np.diag(np.square(element_sigma))
    G = np.eye(3) if G is None else G
    directions = [sigma_mounting * attitude.cross_matrix(e) @ G for e in np.eye(3)] + [sigma_scale * G]
    for direction in directions:
        P[:9, :9] += np.outer(direction.ravel(), direction.ravel())
    return np.asarray(P)


def predict(
    recording: Recording,
    from_s: float,
    times: Array | None = None,
    apriori_covariance: Array | None = None,
    noise: RemainderNoise | None = None,
) -> Prediction:
    """Predict the attitude from a time on by gyro alone.

    Parameters
    ----------
    recording : its interval that holds from_s, or is the last to begin before it, is the
        stretch
    from_s : references later than this are not used
    times : (k,) s, of the prediction; each end of a gyro sample after from_s, to
        its first gap, by default
    apriori_covariance : (12, 12) P₀ of the recording's a-priori parameters, see `prior_covariance`
    noise : remainder of a calibration, beside the stated noise

    Raises
    ------
    InputError
        There are no references before from_s, or no gyro samples after it.
    """
    gyro = recording.gyro
    earlier_intervals = [candidate for candidate in recording.intervals if candidate.start_s < from_s]
    if not earlier_intervals:
        raise InputError(f"no interval begins before {from_s:g} s; the first starts at {recording.intervals[0].start_s:g} s")
    interval = max(earlier_intervals, key=lambda candidate: candidate.start_s)
    end_s = gyro.t_s[-1] + gyro.sample_s
    if times is None:
        last = _find_last_sample(recording, from_s)
        times = np.append(gyro.t_s[: last + 1], gyro.t_s[last] + gyro.sample_s)
        times = times[times > from_s]
    times = np.asarray(times, dtype=float)
    if times.size == 0 or times[-1] > end_s + SAME_TIME_S:
        raise InputError(f"the gyro ends at {end_s:g} s, and nothing can be predicted beyond it")
    t_ref = recording.attitudes.t_s
    used = (t_ref >= interval.start_s - SAME_TIME_S) & (t_ref <= from_s)
    return condition_on_references(recording, used, times, apriori_covariance, noise)


def _find_last_sample(recording: Recording, from_s: float) -> int:
    """Find the last sample of the gyro before its first gap after a time."""
    gyro = recording.gyro
    gaps = np.flatnonzero((np.diff(gyro.t_s) > GAP_SAMPLES * gyro.sample_s) & (gyro.t_s[1:] > from_s))
    return int(gaps[0]) if gaps.size else gyro.t_s.size - 1


def list_step_times(recording: Recording, from_s: float, step_s: float) -> Array:
    """List times (k,) of equal steps from a time, s, to the gyro's first gap after it."""
    gyro = recording.gyro
    stop = gyro.t_s[_find_last_sample(recording, from_s)] + gyro.sample_s
    return np.asarray(from_s + step_s * np.arange(1, max(int((stop - from_s) / step_s + SAME_TIME_S), 0) + 1), dtype=np.float64)


@dataclass(frozen=True)
class _Problem:
    """References, gyro and prior of one stretch."""

    references: Attitudes  # the n that are used
    times: Array  # (k,) of the outputs, s
    path: GyroArc  # from the start through the references and outputs
    anchor: Array  # (3, 3) attitude at the start
    # reference_columns, output_columns: (n, 3, q), (k, 3, q) lasting errors of references, at these and at the outputs
    reference_columns: Array
    output_columns: Array
    arw: float  # angle random walk, rad/√s
    noise: RemainderNoise  # remainder of a calibration
    x0: Array  # (12,) parameters known beforehand
    S: Array  # (15, 15) root of the covariance of the anchor and of x


@dataclass(frozen=True)
class _Solution:
    """The conditioned problem, linearised at x; R, F, states and spread are those of the outputs."""

    x: Array
    R: Array
    F: Array
    states: Array
    spread: Array
    variance: Array  # of the lasting errors
    U: Array
    y: Array
    chi2: float


def condition_on_references(
    recording: Recording,
    used: Mask,
    times: Array,
    apriori_covariance: Array | None = None,
    noise: RemainderNoise | None = None,
) -> Prediction:
    """Estimate attitudes at any times of one gap-free stretch, from the references that are to be used.

    An `InputError` if no reference is used, a time is not after the first reference, or the gyro does not cover the stretch.

    used: (m,) which references
    times: (k,) s, ascending
    apriori_covariance: (12, 12) P₀
    noise: remainder of a calibration, beside the stated noise
    """
    remainder = RemainderNoise() if noise is None else noise
    problem = _build_problem(recording, np.flatnonzero(used), times, apriori_covariance, remainder)
    x = problem.x0
    for _ in range(CALIBRATION_ITERATIONS):
        solution = _solve_linearised(problem, x)
        x = problem.x0 - (problem.S @ solution.y)[3:]
    return _build_prediction(problem, solution, x)


def _build_problem(
    recording: Recording, rows: NDArray[np.intp], times: Array, apriori_covariance: Array | None, noise: RemainderNoise
) -> _Problem:
    """Collect the arrays that the conditioning of a stretch needs, see `condition_on_references`."""
    attitudes, gyro = recording.attitudes, recording.gyro
    anchor = _find_anchor(attitudes, rows, times)
    references = attitudes.select_rows(rows)
    if apriori_covariance is None:
        ranges = estimate_plausible_ranges(recording, use_rests=False)
        apriori_covariance = prior_covariance(ranges.G, ranges.bias)
    start_s = float(attitudes.t_s[anchor])
    node_times = np.maximum(np.union1d(times, references.t_s), start_s)
    if any(process.kind == "rate" for process in noise.processes):  # which correlate, and turn evenly over a short step only
        node_times = np.union1d(node_times, np.linspace(start_s, node_times[-1], CORRELATED_STEPS + 1))
    _check_memory(node_times.size, noise)
    path = build_gyro_arc(gyro, np.append(start_s, node_times), gyro.apriori_G, name="prediction")
    reference_columns, output_columns = (
        noise.build_reference_columns(interpolate_rates(gyro, gyro.apriori_G, gyro.apriori_bias, t))
        for t in (references.t_s, times)
    )
    anchor_sigma = ANCHOR * float(attitudes.sigma[anchor].max())
    return _Problem(
        references=references,
        times=times,
        path=path,
        anchor=attitude.matrix_from_quaternion(attitudes.quaternions[anchor]),
        reference_columns=reference_columns,
        output_columns=output_columns,
        arw=gyro.arw * float(np.sqrt(noise.factor)),
        noise=noise,
        x0=np.concatenate([gyro.apriori_G.ravel(), gyro.apriori_bias]),
        S=scipy.linalg.block_diag(anchor_sigma * np.eye(3), _compute_covariance_root(apriori_covariance)),
    )


def _find_anchor(references: Attitudes, rows: NDArray[np.intp], times: Array) -> int:
    """Find the last reference at or before the first time and the first row; refuse what cannot be predicted."""
    if rows.size < 2 or np.any(np.diff(times) <= 0):
        raise InputError("a prediction needs two references or more, and ascending times")
    anchor = int(np.searchsorted(references.t_s, min(times[0], references.t_s[rows[0]]) - SAME_TIME_S))
    if times[0] < references.t_s[anchor] - SAME_TIME_S:
        anchor -= 1
    if anchor < 0:
        raise InputError(f"no attitude to start from at or before {times[0]:g} s")
    return anchor


def _solve_linearised(problem: _Problem, x: Array) -> _Solution:
    """Solve [L⁻¹ F S; I] = Q U with Θ taken at parameters x (12,)."""
    path, references = problem.path, problem.references
    nodes, outputs, steps_s = path.find_nodes(references.t_s), path.find_nodes(problem.times), np.diff(path.t)
    propagation = propagate(path.arcs, x[:9].reshape(3, 3), x[9:])
    R = np.concatenate([np.eye(3)[None], propagation.R])
    F = np.zeros((len(R), 3, 3 + x.size))
    F[:, :, :3], F[1:, :, 3:] = R, propagation.Theta
    F_references = F[nodes]
    theta = attitude.residual(attitude.matrix_from_quaternion(references.quaternions), R[nodes] @ problem.anchor)
    # Both means: c has that of Θ (x − x₀), whose covariance is P₀.
    z = theta - F_references[:, :, 3:] @ (x - problem.x0)
    turns = compute_turns(propagation.R, propagation.Theta, np.zeros(steps_s.size, dtype=np.intp))
    errors = ErrorStates.build(turns, steps_s, problem.arw, problem.noise.processes)
    H = np.concatenate([R[nodes], problem.reference_columns], axis=2)
    stated_noise = problem.noise.factor * references.compute_covariance()
    white, states, spread = errors.smooth(
        nodes, H, stated_noise, np.concatenate([F_references @ problem.S, z[:, :, None]], axis=2)
    )
    white, size = white.reshape(z.size, -1), len(problem.S)
    right_side = np.append(white[:, -1], np.zeros(size))
    Q, U = scipy.linalg.qr(np.vstack([white[:, :-1], np.eye(size)]), mode="economic")
    y = scipy.linalg.solve_triangular(U, Q.T @ right_side)
    remaining = right_side - Q @ (Q.T @ right_side)
    return _Solution(
        x, R[outputs], F[outputs], states[outputs], spread[outputs], errors.variance, U, y, float(remaining @ remaining)
    )


def _build_prediction(problem: _Problem, solution: _Solution, x: Array) -> Prediction:
    """Build attitudes and covariances from the last solution and the parameters x (12,) that it leads to."""
    R, F, states, spread = solution.R, solution.F, solution.states, solution.spread
    S, y, d, used = problem.S, solution.y, problem.output_columns, len(problem.references.t_s)
    walk = (states[:, :3, -1:] - states[:, :3, :-1] @ y[:, None])[:, :, 0]
    c = np.einsum("kij,kj->ki", R, walk) + F @ (S @ y) + F[:, :, 3:] @ (solution.x - problem.x0)
    # cov(u) = U⁻¹ U⁻ᵀ. Beside the smoothed states, c is off by B u′, and the lasting error of a reading by D u′, u′ ~ N(0, I).
    root = scipy.linalg.solve_triangular(solution.U, np.eye(len(S)))
    T, R_spread = S @ root, R @ spread[:, :3]
    B = F @ T - R @ states[:, :3, :-1] @ root
    D = -d @ states[:, 3:, :-1] @ root
    covariance = R_spread[:, :, :3] @ R.transpose(0, 2, 1) + B @ B.transpose(0, 2, 1)
    cross = R_spread[:, :, 3:] @ d.transpose(0, 2, 1) + B @ D.transpose(0, 2, 1)  # of c and the lasting error of a reading
    readings = covariance + cross + cross.transpose(0, 2, 1) + (d * solution.variance) @ d.transpose(0, 2, 1)
    return Prediction(
        problem.times,
        np.asarray(attitude.rotation_matrix(c) @ R @ problem.anchor),
        np.asarray(0.5 * (covariance + covariance.transpose(0, 2, 1))),
        GyroParameters.from_vector(x),
        T[3:] @ T[3:].T,
        used,
        solution.chi2,
        3 * used,
        readings,
    )


def _check_memory(count: int, noise: RemainderNoise) -> None:
    """Refuse a prediction whose arrays would not fit: they grow with the number of references and output times."""
    states = 3 + sum(len(process.members) for process in noise.processes)
    bytes_per_time = 8 * (2 * states**2 + (states + 6) * 16 + 3 * states + 60)
    if count * bytes_per_time > LARGEST_PREDICTION_BYTES:
        raise InputError(
            f"{count} references and output times need {count * bytes_per_time / 1e9:.1f} GB, the limit is"
            f" {LARGEST_PREDICTION_BYTES / 1e9:.0f} GB: give a larger --step, or predict from a shorter interval"
        )


def _compute_covariance_root(P: Array) -> Array:
    """Compute S (p, p) of a covariance P = S Sᵀ, of any units and rank."""
    scale = np.sqrt(np.maximum(np.diag(P), 0.0))
    safe = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(P / np.outer(safe, safe))
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))
