"""Fit the noise terms of IEEE Std 952 to an Allan deviation, and select the significant ones.

The logarithm of each estimate is that of the model plus an error of mean ψ(ν/2) − ln(ν/2) and variance ψ′(ν/2), ν its
equivalent degrees of freedom, since ν σ̂²/σ² is χ²(ν). Errors at different averaging times correlate; their covariance under the
model itself is that of `estimate_covariance`. Generalised least squares with it gives the
coefficients and their sigmas for each set of terms (Guerrier et al., "Wavelet-variance-based estimation for composite
stochastic processes", JASA 108, 2013, for the consistency of such fits).

Sets of terms compete by χ² plus a price for each number they hold. A term that is not in the best set is *not seen*, and has an
upper bound: the coefficient at which χ² rises by that of a one-sided 95 % limit, with all others fitted anew. Sets that are as
good as the best but for less than its price are listed as alternatives, since bias instability, Markov noise and rate random
walk can often stand for one another.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations, pairwise

import numpy as np
import scipy.optimize
from scipy.special import digamma, polygamma

from gyrocal.allan.deviation import Deviation, estimate_covariance
from gyrocal.allan.terms import ANGLE_WHITE, MARKOV, RAMP, RANDOM_WALK, TERMS, compute_allan_variance
from gyrocal.arrays import Array
from gyrocal.errors import InputError

PRICE = 9.0  # of χ², for each number of a term: three sigma
CHI2_TIE_MARGIN = 4.0  # of χ² and prices, up to which a set is as good as the best
CHI2_LIMIT_95 = 2.71  # of χ², at a one-sided limit of 95 %
LARGEST_SET = 3  # terms
FEWEST_TIMES = 5
CANDIDATE_CHI2_MARGIN = 15.0  # of χ² and prices, up to which a set is looked at more closely
REWEIGHTING_ROUNDS = 2  # in which the terms of a set and the covariance that they predict follow one another
START_TIME_CONSTANTS = (0.03, 0.15, 0.6)  # of the longest averaging time: time constants that a fit begins at
SEARCH_START_SHARE = 100.0  # share of the size that fills the deviation at one time: the search for a bound begins there
STEP, STEPS = 0.5, 40  # of the logarithm, in that search
SHIFT = 1e-4  # of the logarithm of a time constant, for a derivative
LARGEST_LOG = 80.0  # of a coefficient: beyond it a term is nothing, or everything


@dataclass(frozen=True)
class TermEstimate:
    """One term."""

    term: str  # one of `gyrocal.allan.TERMS`
    seen: bool  # whether the deviation needs it
    # value, sigma: coefficient and its standard error, NaN if it is not seen; in powers of the rate's unit and seconds
    value: float
    sigma: float
    upper: float  # limit of 95 % of a term that is not seen, NaN otherwise
    # time_constant_s, time_constant_sigma_s: of Markov noise that is seen, NaN otherwise
    time_constant_s: float = float("nan")
    time_constant_sigma_s: float = float("nan")


@dataclass(frozen=True)
class Fit:
    """Terms of one axis."""

    estimates: tuple[TermEstimate, ...]  # one for each term, in the order of `TERMS`
    degrees: Array  # (t,) equivalent degrees of freedom of each averaging time under these terms
    model: Array  # (t,) Allan variance of the terms that are seen, and of what was known before
    chi2: float
    dof: int
    alternatives: tuple[tuple[str, ...], ...]  # other sets of terms that fit as well

    def estimate(self, term: str) -> TermEstimate:
        """The estimate of a term."""
        return next(one for one in self.estimates if one.term == term)


def fit_terms(found: Deviation, known: Array | None = None) -> Fit:
    """Fit the terms of IEEE Std 952 to an Allan deviation.

    An `InputError` if there is no noise at some averaging time, or there are too few of them.

    Parameters
    ----------
    found : an overlapping Allan deviation, at octaves
    known : (t,) Allan variance of what is there besides, such as the noise of references
    """
    if not np.all(found.variance > 0):
        place = float(found.tau_s[np.argmin(found.variance)])
        raise InputError(
            f"Allan deviation: it is zero at {place:g} s, where samples do not differ; there is no noise to describe"
        )
    if found.factors.size < FEWEST_TIMES:
        raise InputError(
            f"Allan deviation: {found.factors.size} averaging times are too few for terms; {FEWEST_TIMES} are needed"
        )
    floor = np.zeros(found.factors.size) if known is None else known
    # The covariance of what is known is the same under all terms; it costs as much as theirs.
    white = _compute_relative_covariance(found, {ANGLE_WHITE: 1.0}, 1.0) if floor.any() else None
    build = partial(_build_problem, found, floor, white)
    # A covariance at all needs terms: angle random walk as at the shortest time.
    first = max(found.variance[0] - floor[0], 1e-3 * found.variance[0]) * found.tau_s[0]
    rough = min(_fit_all_sets(build({RANDOM_WALK: first}, 1.0)), key=lambda one: one.cost)
    sets = _fit_all_sets(build(rough.squares, rough.time_constant_s))
    least = min(one.cost for one in sets)
    # Sets worth a thought, each under the covariance that it predicts itself: a trend scatters less than noise of its size.
    sets = [_refine_set(one, build) for one in sets if one.cost < least + CANDIDATE_CHI2_MARGIN]
    sets.sort(key=lambda one: one.cost)
    best = sets[0]
    problem = build(best.squares, best.time_constant_s)
    # A set that is the best with a term more that it does not need is no alternative.
    alike = [one for one in sets[1:] if one.cost < best.cost + CHI2_TIE_MARGIN and not set(best.terms) < set(one.terms)]
    estimates = tuple(_estimate(term, best, problem) for term in TERMS)
    model = floor + problem.compute_term_variances(best.terms, best.logs).sum(axis=0)
    dof = found.factors.size - best.logs.size
    return Fit(estimates, problem.degrees, model, best.chi2, dof, tuple(one.terms for one in alike))


@dataclass(frozen=True)
class _TermSet:
    """A set of terms with its best coefficients: their logarithms, then that of the time constant of Markov noise."""

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
        return dict(zip(self.terms, np.exp(2 * self.logs[: len(self.terms)]), strict=True))

    @property
    def time_constant_s(self) -> float:
        """Time constant of the Markov noise, s; one second without it."""
        return float(np.exp(self.logs[-1])) if MARKOV in self.terms else 1.0


@dataclass(frozen=True)
class _Problem:
    """Least squares of the logarithms of an Allan deviation."""

    logs: Array  # (t,)
    whitening: Array  # (t, t) inverse factor of their covariance
    known: Array  # (t,) Allan variance of what is known
    tau_s: Array
    degrees: Array  # (t,) equivalent degrees of freedom of each estimate

    @cached_property
    def _units(self) -> dict[tuple[str, float], Array]:
        return {}  # by term and time constant, which residuals and their derivatives share

    def _compute_unit_variance(self, term: str, logs: Array) -> Array:
        """(t,) Allan variance of a term per square of its coefficient."""
        key = term, self.limit_time_constant(logs) if term == MARKOV else 1.0
        if key not in self._units:
            self._units[key] = compute_allan_variance(term, self.tau_s, key[1])
        return self._units[key]

    def compute_term_variances(self, terms: tuple[str, ...], logs: Array) -> Array:
        """(terms, t) Allan variance of each term."""
        squares = np.exp(2 * np.clip(logs[: len(terms)], -LARGEST_LOG, LARGEST_LOG))
        return squares[:, None] * np.array([self._compute_unit_variance(term, logs) for term in terms])

    def limit_time_constant(self, logs: Array) -> float:
        """The last number as a time constant, kept between half a sample's and twice the longest averaging time, s."""
        return float(np.exp(np.clip(logs[-1], np.log(0.5 * self.tau_s[0]), np.log(2 * self.tau_s[-1]))))

    def compute_residuals(self, terms: tuple[str, ...], logs: Array) -> Array:
        """(t,) whitened."""
        model = self.known + self.compute_term_variances(terms, logs).sum(axis=0)
        return np.asarray(self.whitening @ (self.logs - np.log(model)))

    def compute_jacobian(self, terms: tuple[str, ...], logs: Array) -> Array:
        """(t, n) derivative of the whitened residuals."""
        shares = self.compute_term_variances(terms, logs)
        total = self.known + shares.sum(axis=0)
        rows = [2 * share / total for share in shares]
        if MARKOV in terms:
            share, moved = shares[terms.index(MARKOV)], np.append(logs[:-1], logs[-1] + SHIFT)
            now, then = self._compute_unit_variance(MARKOV, logs), self._compute_unit_variance(MARKOV, moved)
            rows.append(share * (then / now - 1) / total / SHIFT)
        return np.asarray(-self.whitening @ np.array(rows).T)

    def minimise(self, terms: tuple[str, ...], start: Array) -> tuple[Array, float]:
        """The numbers at which χ² is least, and that χ²."""
        # MINPACK's own call: that of `least_squares` with "lm", whose wrappers take as long as all else here.
        found, _, told, *_ = scipy.optimize.leastsq(
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
        x = np.clip(found, -LARGEST_LOG, LARGEST_LOG)
        if MARKOV in terms:
            x[-1] = np.log(self.limit_time_constant(x))
        return x, float(told["fvec"] @ told["fvec"])


def _build_problem(
    found: Deviation, floor: Array, white: Array | None, squares: Mapping[str, float], time_constant_s: float
) -> _Problem:
    """Logarithms of the estimates and the covariance of their errors under some terms.

    The share of the floor, which is the Allan variance of what is known, scatters with the relative covariance `white`.
    """
    V = _compute_relative_covariance(found, squares, time_constant_s)
    if white is not None:
        share = floor / (floor + _compute_variance(found, squares, time_constant_s))
        crossed = np.sqrt(np.diag(V) * np.diag(white)) * share * (1 - share)
        V = V * np.outer(1 - share, 1 - share) + white * np.outer(share, share) + 2 * np.diag(crossed)
    # A ramp alone does not scatter: its estimate is worth more than a χ² of the noise, but no more than that of all samples.
    degrees = np.clip(2 / np.diag(V), 0.5, max(found.lengths))
    scale = np.sqrt(polygamma(1, degrees / 2) / np.diag(V))
    covariance = V * np.outer(scale, scale) + 1e-6 * np.eye(len(V))
    logs = np.log(found.variance) - (digamma(degrees / 2) - np.log(degrees / 2))
    return _Problem(logs, np.linalg.inv(np.linalg.cholesky(covariance)), floor, found.tau_s, degrees)


def _compute_variance(found: Deviation, squares: Mapping[str, float], time_constant_s: float) -> Array:
    """(t,) Allan variance of some terms."""
    parts = (square * compute_allan_variance(term, found.tau_s, time_constant_s) for term, square in squares.items())
    return np.asarray(sum(parts, np.zeros(found.factors.size)))


def _compute_relative_covariance(found: Deviation, squares: Mapping[str, float], time_constant_s: float) -> Array:
    """(t, t) covariance of the estimates under some terms, relative to what they should be."""
    expected = _compute_variance(found, squares, time_constant_s)
    return np.asarray(estimate_covariance(found, squares, time_constant_s) / np.outer(expected, expected))


def _fit_all_sets(problem: _Problem) -> list[_TermSet]:
    """The best coefficients of every set of up to three terms, at least one of them random."""
    return [
        _fit_set(terms, problem)
        for size in range(1, LARGEST_SET + 1)
        for terms in combinations(TERMS, size)
        if terms != (RAMP,) and len(terms) + (MARKOV in terms) < problem.tau_s.size
    ]


def _fit_set(terms: tuple[str, ...], problem: _Problem, near: Array | None = None) -> _TermSet:
    """A set at its best, from several beginnings or near one."""
    starts = [near] if near is not None else []
    if near is None:
        for share in START_TIME_CONSTANTS if MARKOV in terms else (1.0,):
            constant = share * float(problem.tau_s[-1])
            # Each term begins at the size at which it touches the deviation from below.
            units = (compute_allan_variance(term, problem.tau_s, constant) for term in terms)
            first = [0.5 * np.log(np.min(np.exp(problem.logs) / unit)) for unit in units]
            starts.append(np.array([*first, np.log(constant)] if MARKOV in terms else first))
    logs, chi2 = min((problem.minimise(terms, start) for start in starts), key=lambda one: one[1])
    J = problem.compute_jacobian(terms, logs)
    return _TermSet(terms, logs, chi2, np.diag(np.linalg.pinv(J.T @ J)), float(-2 * np.log(np.diag(problem.whitening)).sum()))


def _refine_set(one: _TermSet, build: Callable[[Mapping[str, float], float], _Problem]) -> _TermSet:
    """A set at its best under its own covariance."""
    for _ in range(REWEIGHTING_ROUNDS):
        one = _fit_set(one.terms, build(one.squares, one.time_constant_s), one.logs)
    return one


def _estimate(term: str, best: _TermSet, problem: _Problem) -> TermEstimate:
    """The coefficient of a term of the best set, or the upper bound of another one."""
    nan = float("nan")
    if term not in best.terms:
        # Markov noise is worst at the time constant that hides best: the largest bound at those that a fit begins at.
        constants = [share * float(problem.tau_s[-1]) for share in START_TIME_CONSTANTS] if term == MARKOV else [1.0]
        return TermEstimate(term, False, nan, nan, max(_solve_upper_bound(term, best, problem, one) for one in constants))
    place = best.terms.index(term)
    value = float(np.exp(best.logs[place]))
    out = TermEstimate(term, True, value, value * float(np.sqrt(best.variances[place])), nan)
    if term != MARKOV:
        return out
    constant = best.time_constant_s
    return replace(out, time_constant_s=constant, time_constant_sigma_s=constant * float(np.sqrt(best.variances[-1])))


def _solve_upper_bound(term: str, best: _TermSet, problem: _Problem, constant: float) -> float:
    """The coefficient at which χ² has risen by `CHI2_LIMIT_95` from the least there is; infinite if it never does."""
    variance = compute_allan_variance(term, problem.tau_s, constant)

    def compute_chi2(log: float) -> float:
        return replace(problem, known=problem.known + np.exp(2 * log) * variance).minimise(best.terms, best.logs)[1]

    full = 0.5 * float(np.log(np.min(np.exp(problem.logs) / variance)))
    least = best.chi2
    for low, high in pairwise(full - np.log(SEARCH_START_SHARE) + STEP * np.arange(STEPS)):
        now = compute_chi2(high)
        least = min(least, now)
        if now > least + CHI2_LIMIT_95:
            limit = least + CHI2_LIMIT_95
            found = scipy.optimize.brentq(lambda log, level: compute_chi2(log) - level, low, high, (limit,), xtol=1e-3)
            return float(np.exp(found))
    return float("inf")
