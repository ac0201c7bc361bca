"""Fit the noise terms of IEEE Std 952 to an Allan deviation, and select the significant ones.

The logarithm of each estimate is that of the model plus an error of mean ψ(ν/2) − ln(ν/2) and variance ψ′(ν/2), ν its
equivalent degrees of freedom, since ν σ̂²/σ² is χ²(ν). Errors at different averaging times correlate; their covariance under the
model itself is that of `estimate_covariance`. Generalised least squares with it gives the
coefficients and their sigmas for each set of terms (Guerrier et al., "Wavelet-variance-based estimation for composite
stochastic processes", JASA 108, 2013, for the consistency of such fits).

Sets of terms compete by their cost: χ² plus a price for each term. A term that is not in the best set is *not seen*. Sets whose
cost is almost that of the best are listed as alternatives, since bias instability and rate random walk can often replace one
another.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np
import scipy.optimize
from scipy.special import digamma, polygamma

from gyrocal.allan.deviation import Deviation, estimate_covariance
from gyrocal.allan.terms import ANGLE_WHITE, RAMP, RANDOM_WALK, TERMS, compute_allan_variance
from gyrocal.arrays import Array
from gyrocal.errors import InputError

PRICE = 9.0  # of χ², for each term: three sigma
CHI2_TIE_MARGIN = 4.0  # of the cost: largest excess of a set that is as good as the best
LARGEST_SET = 3  # terms
FEWEST_TIMES = 5
CANDIDATE_CHI2_MARGIN = 15.0  # of the cost: largest excess of a set that is refitted with its own covariance
REWEIGHTING_ROUNDS = 2  # of fitting a set's terms and computing the covariance that they predict
LARGEST_LOG = 80.0  # of a coefficient: keeps exp finite; beyond it a term is negligible or dominates


@dataclass(frozen=True)
class TermEstimate:
    """One term."""

    term: str  # one of `gyrocal.allan.TERMS`
    seen: bool  # whether the deviation needs it
    # value, sigma: coefficient and its standard error, NaN if it is not seen; in powers of the rate's unit and seconds
    value: float = float("nan")
    sigma: float = float("nan")


@dataclass(frozen=True)
class Fit:
    """Terms of one axis."""

    estimates: tuple[TermEstimate, ...]  # one for each term, in the order of `TERMS`
    degrees: Array  # (t,) equivalent degrees of freedom of each averaging time under these terms
    model: Array  # (t,) Allan variance of the seen terms and of the known noise
    chi2: float
    dof: int
    alternatives: tuple[tuple[str, ...], ...]  # other sets of terms that fit as well

    def estimate(self, term: str) -> TermEstimate:
        """Return the estimate of a term."""
        return next(estimate for estimate in self.estimates if estimate.term == term)


def fit_terms(deviation: Deviation, known: Array | None = None) -> Fit:
    """Fit the terms of IEEE Std 952 to an Allan deviation.

    Raises `InputError` if there is no noise at some averaging time, or if there are too few of them.

    Parameters
    ----------
    deviation : an overlapping Allan deviation, at octaves
    known : (t,) Allan variance of further known noise, such as that of references
    """
    _check_deviation(deviation)
    floor = np.zeros(deviation.factors.size) if known is None else known
    # The covariance of the known noise is the same under all terms, and computed once.
    white = _compute_relative_covariance(deviation, {ANGLE_WHITE: 1.0}) if floor.any() else None
    build = partial(_build_problem, deviation, floor, white)
    # The first covariance needs terms: angle random walk of the size at the shortest time.
    first = max(deviation.variance[0] - floor[0], 1e-3 * deviation.variance[0]) * deviation.tau_s[0]
    rough = min(_fit_all_sets(build({RANDOM_WALK: first})), key=lambda term_set: term_set.cost)
    best, *others = _select_likely_sets(_fit_all_sets(build(rough.squares)), build)
    problem = build(best.squares)
    # The best set with a further term is no alternative: it does not need the term.
    tied = [other.terms for other in others if other.cost < best.cost + CHI2_TIE_MARGIN]
    alternatives = tuple(terms for terms in tied if not set(best.terms) < set(terms))
    return Fit(
        estimates=tuple(best.estimate(term) for term in TERMS),
        degrees=problem.degrees,
        model=floor + problem.compute_term_variances(best.terms, best.logs).sum(axis=0),
        chi2=best.chi2,
        dof=deviation.factors.size - best.logs.size,
        alternatives=alternatives,
    )


def _check_deviation(deviation: Deviation) -> None:
    """Raise `InputError` for a deviation without noise, or with too few averaging times."""
    if not np.all(deviation.variance > 0):
        time_s = float(deviation.tau_s[np.argmin(deviation.variance)])
        raise InputError(
            f"Allan deviation: it is zero at {time_s:g} s, where samples do not differ; there is no noise to describe"
        )
    if deviation.factors.size < FEWEST_TIMES:
        raise InputError(
            f"Allan deviation: {deviation.factors.size} averaging times are too few for terms; {FEWEST_TIMES} are needed"
        )


@dataclass(frozen=True)
class _TermSet:
    """A set of terms with the logarithms of its best coefficients."""

    terms: tuple[str, ...]
    logs: Array
    chi2: float
    variances: Array  # of each of the logarithms
    log_determinant: float  # of the covariance of the estimates

    @property
    def cost(self) -> float:
        """χ², prices, and the logarithm of the determinant of the covariance."""
        return self.chi2 + self.log_determinant + PRICE * len(self.logs)

    @property
    def squares(self) -> dict[str, float]:
        """Square of each coefficient."""
        return dict(zip(self.terms, np.exp(2 * self.logs), strict=True))

    def estimate(self, term: str) -> TermEstimate:
        """Return the coefficient of a term, which is not seen if the set is without it."""
        if term not in self.terms:
            return TermEstimate(term, seen=False)
        index = self.terms.index(term)
        value = float(np.exp(self.logs[index]))
        return TermEstimate(term, True, value, value * float(np.sqrt(self.variances[index])))


@dataclass(frozen=True)
class _Problem:
    """Least squares of the logarithms of an Allan deviation."""

    logs: Array  # (t,)
    whitening: Array  # (t, t) inverse factor of their covariance
    known: Array  # (t,) Allan variance of the known noise
    tau_s: Array
    degrees: Array  # (t,) equivalent degrees of freedom of each estimate

    def compute_term_variances(self, terms: tuple[str, ...], logs: Array) -> Array:
        """Compute the Allan variance (terms, t) of each term."""
        squares = np.exp(2 * np.clip(logs, -LARGEST_LOG, LARGEST_LOG))
        return squares[:, None] * np.array([compute_allan_variance(term, self.tau_s) for term in terms])

    def compute_residuals(self, terms: tuple[str, ...], logs: Array) -> Array:
        """Compute the whitened residuals (t,)."""
        model = self.known + self.compute_term_variances(terms, logs).sum(axis=0)
        return np.asarray(self.whitening @ (self.logs - np.log(model)))

    def compute_jacobian(self, terms: tuple[str, ...], logs: Array) -> Array:
        """Compute the derivative (t, terms) of the whitened residuals."""
        variances = self.compute_term_variances(terms, logs)
        total = self.known + variances.sum(axis=0)
        return np.asarray(-self.whitening @ (2 * variances / total).T)

    def minimise(self, terms: tuple[str, ...], start: Array) -> tuple[Array, float]:
        """Find the logarithms of least χ², and that χ²."""
        # MINPACK's own call: the wrappers of `least_squares` with "lm" take as long as the rest of the fit.
        solution, _, details, *_ = scipy.optimize.leastsq(
            lambda x: self.compute_residuals(terms, x),
            start,
            Dfun=lambda x: self.compute_jacobian(terms, x),
            full_output=True,
            ftol=1e-8,
            xtol=1e-8,
            gtol=1e-8,
            maxfev=200,
            diag=np.ones(len(start)),
        )
        return np.clip(solution, -LARGEST_LOG, LARGEST_LOG), float(details["fvec"] @ details["fvec"])


def _build_problem(deviation: Deviation, floor: Array, white: Array | None, squares: Mapping[str, float]) -> _Problem:
    """Build the problem of the estimates' logarithms, with the covariance of their errors under some terms.

    The share of the floor, the Allan variance of the known noise, has the relative covariance `white`.
    """
    V = _compute_relative_covariance(deviation, squares)
    if white is not None:
        s = floor / (floor + _compute_variance(deviation, squares))  # share of the floor
        cross_variance = np.sqrt(np.diag(V) * np.diag(white)) * s * (1 - s)
        V = V * np.outer(1 - s, 1 - s) + white * np.outer(s, s) + 2 * np.diag(cross_variance)
    # A ramp alone has no scatter, so that ν would be infinite: it is limited to the number of samples.
    degrees = np.clip(2 / np.diag(V), 0.5, max(deviation.lengths))
    scale = np.sqrt(polygamma(1, degrees / 2) / np.diag(V))
    covariance = V * np.outer(scale, scale) + 1e-6 * np.eye(len(V))
    logs = np.log(deviation.variance) - (digamma(degrees / 2) - np.log(degrees / 2))
    return _Problem(logs, np.linalg.inv(np.linalg.cholesky(covariance)), floor, deviation.tau_s, degrees)


def _compute_variance(deviation: Deviation, squares: Mapping[str, float]) -> Array:
    """Compute the Allan variance (t,) of some terms."""
    parts = (square * compute_allan_variance(term, deviation.tau_s) for term, square in squares.items())
    return np.asarray(sum(parts, np.zeros(deviation.factors.size)))


def _compute_relative_covariance(deviation: Deviation, squares: Mapping[str, float]) -> Array:
    """Compute the covariance (t, t) of the estimates under some terms, relative to their expected values."""
    expected = _compute_variance(deviation, squares)
    return np.asarray(estimate_covariance(deviation, squares) / np.outer(expected, expected))


def _fit_all_sets(problem: _Problem) -> list[_TermSet]:
    """Fit the coefficients of every set of up to three terms, at least one of them random."""
    return [
        _fit_set(terms, problem)
        for size in range(1, LARGEST_SET + 1)
        for terms in combinations(TERMS, size)
        if terms != (RAMP,)
    ]


def _fit_set(terms: tuple[str, ...], problem: _Problem, start: Array | None = None) -> _TermSet:
    """Fit a set of terms; by default each starts at the size at which it touches the deviation from below."""
    if start is None:
        units = (compute_allan_variance(term, problem.tau_s) for term in terms)
        start = np.array([0.5 * np.log(np.min(np.exp(problem.logs) / unit)) for unit in units])
    logs, chi2 = problem.minimise(terms, start)
    J = problem.compute_jacobian(terms, logs)
    return _TermSet(terms, logs, chi2, np.diag(np.linalg.pinv(J.T @ J)), float(-2 * np.log(np.diag(problem.whitening)).sum()))


def _select_likely_sets(sets: list[_TermSet], build: Callable[[Mapping[str, float]], _Problem]) -> list[_TermSet]:
    """Select the sets near the best one, each fitted under the covariance that it predicts, the best first.

    The covariances differ, since a trend has less scatter than noise of its size.
    """
    least_cost = min(term_set.cost for term_set in sets)
    likely = [term_set for term_set in sets if term_set.cost < least_cost + CANDIDATE_CHI2_MARGIN]
    for _ in range(REWEIGHTING_ROUNDS):
        likely = [_fit_set(term_set.terms, build(term_set.squares), term_set.logs) for term_set in likely]
    return sorted(likely, key=lambda term_set: term_set.cost)
