"""Fit the noise terms of IEEE Std 952 to an Allan deviation, and select the significant ones.

The logarithm of each estimate is that of the model plus an error of mean ψ(ν/2) − ln(ν/2) and variance ψ′(ν/2), ν its
equivalent degrees of freedom, since ν σ̂²/σ² is χ²(ν). Errors at different averaging times correlate; their covariance under the
model itself is that of `gyrocal.allan.covariance`. Generalised least squares with it (`gyrocal.allan.problem`) gives the
coefficients and their sigmas for each set of terms (Guerrier et al., "Wavelet-variance-based estimation for composite
stochastic processes", JASA 108, 2013, for the consistency of such fits).

Sets of terms compete by χ² plus a price for each number they hold. A term that is not in the best set is *not seen*, and has an
upper bound: the coefficient at which χ² rises by that of a one-sided 95 % limit, with all others fitted anew. Sets that are as
good as the best but for less than its price are listed as alternatives, since bias instability, Markov noise and rate random
walk can often stand for one another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from gyrocal.allan.deviation import Deviation
from gyrocal.allan.problem import Problem, build_problem, compute_white_covariance
from gyrocal.allan.terms import MARKOV, RAMP, RANDOM_WALK, TERMS, compute_allan_variance
from gyrocal.errors import InputError

Array = NDArray[np.float64]

PRICE = 9.0  # of χ², for each number of a term: three sigma
CHI2_TIE_MARGIN = 4.0  # of χ² and prices, up to which a set is as good as the best
CHI2_LIMIT_95 = 2.71  # of χ², at a one-sided limit of 95 %
LARGEST_SET = 3  # terms
FEWEST_TIMES = 5
CANDIDATE_CHI2_MARGIN = 15.0  # of χ² and prices, up to which a set is looked at more closely
REWEIGHTING_ROUNDS = 2  # in which the terms of a set and the covariance that they predict follow one another
START_TIME_CONSTANTS = (0.03, 0.15, 0.6)  # of the longest averaging time: time constants that a fit begins at
SEARCH_START_SHARE = (
    100.0  # share of the size that fills the deviation at one time, at which the search for an upper bound begins
)
STEP, STEPS = 0.5, 40  # of the logarithm, in that search


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
    # chi2, dof: of the fit
    chi2: float
    dof: int
    alternatives: tuple[tuple[str, ...], ...]  # other sets of terms that fit as well

    def estimate(self, term: str) -> TermEstimate:
        """The estimate of a term."""
        return next(one for one in self.estimates if one.term == term)


@dataclass(frozen=True)
class _TermSet:
    """A set of terms with its best coefficients: their logarithms, then that of the time constant of Markov noise."""

    terms: tuple[str, ...]
    logs: Array
    chi2: float
    inverse: Array
    spread: float

    @property
    def cost(self) -> float:
        """χ², prices, and the logarithm of the determinant of the covariance."""
        return self.chi2 + self.spread + PRICE * len(self.logs)

    def squares(self) -> dict[str, float]:
        """Square of each coefficient."""
        return dict(zip(self.terms, np.exp(2 * self.logs[: len(self.terms)]), strict=True))

    @property
    def time_constant_s(self) -> float:
        """Time constant of the Markov noise, s; one second without it."""
        return float(np.exp(self.logs[-1])) if MARKOV in self.terms else 1.0


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
    build = partial(build_problem, found, floor, compute_white_covariance(found) if floor.any() else None)
    rough = min(_fit_all_sets(found, build(*_estimate_rough_terms(found, floor))), key=lambda one: one.cost)
    sets = _fit_all_sets(found, build(rough.squares(), rough.time_constant_s))
    least = min(one.cost for one in sets)
    # Sets worth a thought, each under the covariance that it predicts itself: a trend scatters less than noise of its size.
    sets = [_refine_set(one, build) for one in sets if one.cost < least + CANDIDATE_CHI2_MARGIN]
    best = min(sets, key=lambda one: one.cost)
    problem = build(best.squares(), best.time_constant_s)
    alike = tuple(one.terms for one in sorted(sets, key=lambda one: one.cost) if one is not best and _is_alike(one, best))
    model = floor + problem.compute_term_variances(best.terms, best.logs).sum(axis=0)
    return Fit(
        tuple(_estimate(term, best, problem) for term in TERMS),
        problem.degrees,
        model,
        best.chi2,
        found.factors.size - best.logs.size,
        alike,
    )


def _refine_set(one: _TermSet, build: Callable[[dict[str, float], float], Problem]) -> _TermSet:
    """A set at its best under its own covariance."""
    for _ in range(REWEIGHTING_ROUNDS):
        one = _fit_set(one.terms, build(one.squares(), one.time_constant_s), one.logs)
    return one


def _is_alike(one: _TermSet, best: _TermSet) -> bool:
    """Whether a set is as good as the best, and not the best with a term more that it does not need."""
    return one.cost < best.cost + CHI2_TIE_MARGIN and not set(best.terms) < set(one.terms)


def _estimate_rough_terms(found: Deviation, floor: Array) -> tuple[dict[str, float], float]:
    """A rough set: angle random walk as at the shortest time, so that a covariance can be had at all."""
    return {RANDOM_WALK: max(found.variance[0] - floor[0], 1e-3 * found.variance[0]) * found.tau_s[0]}, 1.0


def _fit_all_sets(found: Deviation, problem: Problem) -> list[_TermSet]:
    """The best coefficients of every set of up to three terms, at least one of them random."""
    return [
        _fit_set(terms, problem)
        for size in range(1, LARGEST_SET + 1)
        for terms in combinations(TERMS, size)
        if terms != (RAMP,) and len(terms) + (MARKOV in terms) < found.factors.size
    ]


def _fit_set(terms: tuple[str, ...], problem: Problem, near: Array | None = None) -> _TermSet:
    """A set at its best, from several beginnings or near one."""
    variance, longest = np.exp(problem.logs), float(problem.tau_s[-1])
    tries = []
    for start in START_TIME_CONSTANTS if MARKOV in terms and near is None else (1.0,):
        constant = start * longest
        # Each term begins at the size at which it touches the deviation from below.
        first = [0.5 * np.log(np.min(variance / compute_allan_variance(term, problem.tau_s, constant))) for term in terms]
        tries.append(
            problem.minimum(terms, np.array([*first, np.log(constant)] if MARKOV in terms else first) if near is None else near)
        )
    logs, chi2 = min(tries, key=lambda one: one[1])
    J = problem.jacobian(terms, logs)
    return _TermSet(terms, logs, chi2, np.asarray(np.linalg.pinv(J.T @ J)), problem.log_determinant)


def _estimate(term: str, best: _TermSet, problem: Problem) -> TermEstimate:
    nothing = float("nan")
    if term not in best.terms:
        return TermEstimate(term, False, nothing, nothing, _estimate_upper_bound(term, best, problem))
    place = best.terms.index(term)
    value = float(np.exp(best.logs[place]))
    out = TermEstimate(term, True, value, value * float(np.sqrt(best.inverse[place, place])), nothing)
    if term != MARKOV:
        return out
    constant = best.time_constant_s
    return replace(out, time_constant_s=constant, time_constant_sigma_s=constant * float(np.sqrt(best.inverse[-1, -1])))


def _estimate_upper_bound(term: str, best: _TermSet, problem: Problem) -> float:
    """Largest coefficient of a term beside the best set that the deviation allows, at 95 %.

    Markov noise is worst at the time constant that hides best; it is bounded at each of those that a fit begins at, and the
    largest bound is told.
    """
    if term == MARKOV:
        constants: Sequence[float] = [start * float(problem.tau_s[-1]) for start in START_TIME_CONSTANTS]
        return max(_solve_upper_bound(term, best, problem, constant) for constant in constants)
    return _solve_upper_bound(term, best, problem, 1.0)


def _solve_upper_bound(term: str, best: _TermSet, problem: Problem, constant: float) -> float:
    """The coefficient at which χ² has risen by `CHI2_LIMIT_95` from the least there is; infinite if it never does."""
    variance = compute_allan_variance(term, problem.tau_s, constant)

    def compute_chi2(log: float) -> float:
        return replace(problem, known=problem.known + np.exp(2 * log) * variance).minimum(best.terms, best.logs)[1]

    full = 0.5 * float(np.log(np.min(np.exp(problem.logs) / variance)))
    sizes = full - np.log(SEARCH_START_SHARE) + STEP * np.arange(STEPS)
    least = best.chi2
    for low, high in pairwise(sizes):
        now = compute_chi2(high)
        least = min(least, now)
        if now > least + CHI2_LIMIT_95:
            return float(
                np.exp(
                    scipy.optimize.brentq(
                        lambda log, limit: compute_chi2(log) - limit, low, high, (least + CHI2_LIMIT_95,), xtol=1e-3
                    )
                )
            )
    return float("inf")
