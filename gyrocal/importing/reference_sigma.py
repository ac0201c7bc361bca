"""Sigma of reference attitudes about each axis, by restricted maximum likelihood of the turns between them.

The next reference minus reference k propagated with the gyro is, about the body's axes at the next one,

    m_k = e_{k+1} − R_k e_k + w_k + X_k p,    e ~ N(0, S),    S = diag(σ_x², σ_y², σ_z²),    w ~ N(0, g a_k I),    g = ARW²

with p the errors of G, of the bias and of the time between gyro and references. Successive turns share a reference, and the
gyro's sample around it:

    Cov(m_k, m_k) = g a_k I + S + R_k S R_kᵀ,    Cov(m_k, m_{k−1}) = R_k (g c_k I − S)

A sample of the length T has the noise g/T: a_k is the sum of the squares of the times for which each holds, over T, and c_k the
product of those of the shared one, over T. V is banded. ln σ_x², ln σ_y², ln σ_z² and ln g maximise −½ (ln|V| + ln|XᵀV⁻¹X| +
rᵀV⁻¹r), the likelihood after p is integrated out (Patterson and Thompson, Biometrika 58, 1971). An estimate ĝ with ν degrees of
freedom adds −½ ν (ln g + ĝ/g).

The curvature there gives the covariance of the logarithms. An axis whose ln σ² has a standard deviation above one is hidden by
the gyro's noise: its value is then the upper bound at which the likelihood, greatest over g, has fallen to 95 % confidence.

Errors that last over many references are not white noise. A random walk significantly larger than the gyro's fits them; then
the sigma is taken from the robust scatter of the turns, which the model with the gyro's own walk would exceed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize

from gyrocal.arrays import Array, Mask

MAD_TO_SIGMA = 1.4826
# Relative 1-sigma of the robust variance of n successive turns, times √n: a median absolute deviation has the efficiency 0.367
# (Huber, Robust Statistics, 1981, section 5.1), and successive turns have 1.2 times the variance of separate ones.
SPREAD = np.sqrt(2 * 1.2 / 0.367)
CLIP = 4.0  # times the median size: turns beyond hold an outlier
SIGNIFICANT_IN_SIGMA = 3.0
LEAST_SCATTER_RATIO = 0.5  # of the variance of the turns to that of the gyro's noise
LARGEST_MEASURED_VARIANCE = 1.0  # of ln σ²
BOUND_DROP = 1.645**2  # of −2 ln L: one-sided 95 %
RANGE = 12.0  # of a logarithm about its start
CURVATURE_STEP = 0.1  # of a logarithm
LEAST_CURVATURE = 0.02  # a standard deviation of a logarithm above seven makes no difference
BANDS = 6  # of the lower triangle of V


@dataclass(frozen=True)
class Turns:
    """References minus the one before each, propagated with the gyro."""

    miss: Array  # (n, 3) about the axes at the second reference, rad
    columns: Array  # (n, 3, q) derivatives of the miss by the calibration's parameters and the time offset
    R: Array  # (n, 3, 3) rotation from the first reference to the second
    noise_s: Array  # (n,) variance of the gyro's noise in a turn over ARW², s
    shared_s: Array  # (n,) covariance of this noise with that in the turn before over ARW², s
    follows: Mask  # (n,) whether the turn before ends at its first reference

    def select(self, kept: Mask) -> Turns:
        """Select the turns (n,) that are kept."""
        follows = self.follows & np.append(False, kept[:-1])
        return Turns(self.miss[kept], self.columns[kept], self.R[kept], self.noise_s[kept], self.shared_s[kept], follows[kept])

    def rotate(self, M: Array) -> Turns:
        """Rotate the turns to axes that M (3, 3) takes those of the body to."""
        return Turns(self.miss @ M.T, M @ self.columns, M @ self.R @ M.T, self.noise_s, self.shared_s, self.follows)


@dataclass(frozen=True)
class ReferenceSigma:
    """Sigma of references, and how well it is known."""

    sigma: Array  # (3,) rad; an upper bound of 95 % where `hidden`
    variance: Array  # (3,) of ln σ²
    hidden: Mask  # (3,) whether the gyro's noise hides it
    degrees: float  # of freedom of its share in a χ² of the turns; 0 if all are bounds

    def exceeds(self, other: ReferenceSigma) -> bool:
        """Whether the sigma is significantly larger about an axis; an own upper bound never is."""
        joint = np.sqrt(np.where(self.hidden, np.inf, self.variance) + np.where(other.hidden, 0.0, other.variance))
        return bool((2 * np.log(self.sigma / other.sigma) > SIGNIFICANT_IN_SIGMA * joint).any())


def fit_reference_sigma(turns: Turns, arw: float, arw_degrees: float) -> ReferenceSigma:
    """Fit the sigma (3,) of references to the turns between them, rad; zero if these scatter less than the gyro.

    arw, arw_degrees: angle random walk, rad/sqrt(s), and its degrees of freedom: infinite if stated, 0 of an upper bound
    """
    turns, residuals = _leave_out_outliers(turns)
    scatter, scatter_sigma = _estimate_scatter(turns, residuals, arw)
    if np.mean(_compute_robust_variance(residuals)) < LEAST_SCATTER_RATIO * arw**2 * np.median(turns.noise_s):
        return ReferenceSigma(np.zeros(3), np.zeros(3), np.zeros(3, dtype=bool), 0.0)
    unit = float(np.mean(np.square(residuals)))
    start = np.log(np.append(np.maximum(scatter, 0.01 * unit) / unit, max(arw**2, 1e-12 * unit) / unit))
    compute_deviance = _build_deviance(turns, unit, start[3], arw_degrees)
    below, above = RANGE * (arw_degrees < np.inf), RANGE * (0 < arw_degrees < np.inf)
    bounds = [*((x - RANGE, x + RANGE) for x in start[:3]), (start[3] - below, start[3] + above)]
    fit = scipy.optimize.minimize(compute_deviance, start, method="L-BFGS-B", bounds=bounds)
    C = _compute_covariance(compute_deviance, fit.x, 4 if fit.x[3] < bounds[3][1] else 3)
    variance = np.diag(C)[:3]
    hidden = variance > LARGEST_MEASURED_VARIANCE
    squares = unit * np.exp(fit.x[:3])
    predicted = np.square(turns.R) @ squares + squares + unit * np.exp(fit.x[3]) * turns.noise_s[:, None]
    # Errors that last look like a larger walk: the likelihood ratio of a fit with free walk shows them.
    compute_free_deviance = _build_deviance(turns, unit, start[3], 0.0)
    free_fit = scipy.optimize.minimize(
        compute_free_deviance, fit.x, method="L-BFGS-B", bounds=[*bounds[:3], (start[3] - RANGE, start[3] + RANGE)]
    )
    if compute_free_deviance(fit.x) - free_fit.fun > SIGNIFICANT_IN_SIGMA**2 and free_fit.x[3] > fit.x[3]:
        squares = np.where(hidden, squares, np.maximum(scatter, scatter_sigma))
        variance = np.where(hidden, variance, np.square(scatter_sigma / squares))
        C = np.diag(variance)
    for axis in np.flatnonzero(hidden):
        squares[axis] = unit * np.exp(_find_bound(compute_deviance, fit.x, int(axis), bounds[3]))
    # Weight of each axis: its share in the variance of the turns.
    weight = squares * np.mean(1 / predicted + np.einsum("nba,nb->na", np.square(turns.R), 1 / predicted), axis=0) * ~hidden
    degrees = float(2 * weight.sum() ** 2 / (weight @ C[:3, :3] @ weight)) if weight.any() else 0.0
    return ReferenceSigma(np.sqrt(squares), variance, hidden, degrees)


def _leave_out_outliers(turns: Turns) -> tuple[Turns, Array]:
    """Return the turns without outliers, and the residuals (n, 3) of their fit, scaled by its degrees of freedom, rad."""
    columns = turns.columns.reshape(turns.miss.size, -1)
    columns = columns / np.maximum(np.sqrt(np.mean(np.square(columns), axis=0)), np.finfo(float).tiny)
    is_inlier = np.ones(len(turns.miss), dtype=bool)
    for _ in range(3):
        rows = np.repeat(is_inlier, 3)
        solution, _, rank, _ = np.linalg.lstsq(columns[rows], turns.miss.ravel()[rows], rcond=1e-10)
        residuals = turns.miss - (columns @ solution).reshape(-1, 3)
        fitted, residuals = is_inlier, residuals * np.sqrt(rows.sum() / max(rows.sum() - rank, 1))
        scale = np.maximum(np.sqrt(_compute_robust_variance(residuals)), np.finfo(float).tiny)
        size = np.linalg.norm(residuals / scale, axis=1)
        is_inlier = size <= CLIP * np.median(size)
    return turns.select(fitted), residuals[fitted]


def _compute_robust_variance(residuals: Array) -> Array:
    """Compute the robust variance (3,) about the median, so that a bias at rest other than in motion does not count, rad²."""
    return np.asarray(np.square(MAD_TO_SIGMA * np.median(np.abs(residuals - np.median(residuals, axis=0)), axis=0)))


def _estimate_scatter(turns: Turns, residuals: Array, arw: float) -> tuple[Array, Array]:
    """Estimate σ² (3,) rad² by the robust variance of the turns minus that of the gyro, which may be negative, and its 1-sigma.

    The variance of a turn is σ_a² + Σ_b R_ab² σ_b² and the gyro's noise.
    """
    mixing = np.linalg.inv(np.eye(3) + np.mean(np.square(turns.R), axis=0))
    variance = _compute_robust_variance(residuals)
    noise = arw**2 * float(np.median(turns.noise_s))
    return mixing @ (variance - noise), SPREAD * np.sqrt(np.square(mixing) @ np.square(variance) / len(residuals))


def _build_deviance(turns: Turns, unit: float, log_walk: float, degrees: float) -> Callable[[Array], float]:
    """Build −2 ln L as a function of ln σ² and ln g (4,), in units of rad²; log_walk is ln ĝ, with its degrees of freedom."""
    n, gram = len(turns.miss), turns.columns.reshape(turns.miss.size, -1)
    U, s, _ = np.linalg.svd(gram / np.maximum(np.linalg.norm(gram, axis=0), np.finfo(float).tiny), full_matrices=False)
    right = np.column_stack([U[:, s > 1e-10 * s[0]], turns.miss.ravel() / np.sqrt(unit)])
    bands = np.zeros((BANDS, 3 * n))
    row, column = np.indices((3, 3))
    lower = row >= column
    place = 3 * np.arange(n)[:, None]
    prior = degrees if np.isfinite(degrees) else 0.0

    def compute_deviance(x: Array) -> float:
        squares, walk = np.exp(x[:3]), np.exp(x[3])
        diagonal = np.einsum("nij,j,nkj->nik", turns.R, squares, turns.R) + np.diag(squares)
        diagonal[:, range(3), range(3)] += walk * turns.noise_s[:, None]
        shared = (walk * turns.shared_s[:, None] - squares) * turns.follows[:, None]
        coupling = turns.R * shared[:, None]  # rows of turn k, columns of turn k − 1
        bands[(row - column)[lower], place + column[lower]] = diagonal[:, lower]
        bands[(3 + row - column).ravel(), place[:-1] + column.ravel()] = coupling[1:].reshape(n - 1, 9)
        try:
            L = scipy.linalg.cholesky_banded(bands, lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            return 1e300
        solved = scipy.linalg.cho_solve_banded((L, True), right, check_finite=False)
        normal = right.T @ solved
        sign, log_normal = np.linalg.slogdet(normal[:-1, :-1])
        quadratic = normal[-1, -1] - normal[-1, :-1] @ np.linalg.solve(normal[:-1, :-1], normal[:-1, -1])
        walk_prior = prior * (x[3] - log_walk + np.exp(log_walk - x[3]))
        return float(2 * np.sum(np.log(L[0])) + log_normal + quadratic + walk_prior) if sign > 0 else 1e300

    return compute_deviance


def _compute_covariance(deviance: Callable[[Array], float], x: Array, free: int) -> Array:
    """Compute the covariance (4, 4) of the logarithms from the curvature of −2 ln L; with three free ones ln g is fixed."""
    step = CURVATURE_STEP * np.eye(4)
    H = np.empty((free, free))
    for a in range(free):
        for b in range(a + 1):
            differences = (deviance(x + i * step[a] + j * step[b]) * i * j for i in (1, -1) for j in (1, -1))
            H[a, b] = H[b, a] = sum(differences) / (4 * CURVATURE_STEP**2)
    values, vectors = np.linalg.eigh(0.5 * H)
    C = np.zeros((4, 4))
    C[:free, :free] = vectors / np.maximum(values, LEAST_CURVATURE) @ vectors.T
    return C


def _find_bound(deviance: Callable[[Array], float], x: Array, axis: int, walk_room: tuple[float, float]) -> float:
    """Find the ln σ² of an axis at which −2 ln L, least over ln g, has risen by `BOUND_DROP` above that of x."""
    limit, walks = deviance(x) + BOUND_DROP, (max(walk_room[0], x[3] - 3), min(walk_room[1], x[3] + 3))

    def rise(value: float) -> float:
        y = np.where(np.arange(3) == axis, value, x[:3])
        return float(scipy.optimize.minimize_scalar(lambda w: deviance(np.append(y, w)), bounds=walks).fun) - limit

    top = float(x[axis]) + 1
    while rise(top) < 0:
        top += 1
    return float(scipy.optimize.brentq(rise, top - 1, top, xtol=1e-3))
