"""Least squares of the logarithms of an Allan deviation: the estimates, the covariance of their errors, and a set's minimum."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.optimize
from numpy.typing import NDArray
from scipy.special import digamma, polygamma

from gyrocal.allan.covariance import estimate_covariance
from gyrocal.allan.deviation import Deviation
from gyrocal.allan.terms import ANGLE_WHITE, MARKOV, TERMS, compute_allan_variance

Array = NDArray[np.float64]

SHIFT = 1e-4  # of the logarithm of a time constant, for a derivative
LARGEST_LOG = 80.0  # of a coefficient: beyond it a term is nothing, or everything


@dataclass(frozen=True)
class Problem:
    """What is fitted: logarithms (t,), the inverse factor of their covariance (t, t), what is known, the times, and degrees."""

    logs: Array
    whitening: Array
    known: Array
    tau_s: Array
    degrees: Array  # (t,) equivalent degrees of freedom of each estimate

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the covariance."""
        return float(-2 * np.log(np.diag(self.whitening)).sum())

    @cached_property
    def _units(self) -> dict[str, Array]:
        """Allan variance of each term per square of its coefficient, but for Markov noise, whose time constant is fitted."""
        return {term: compute_allan_variance(term, self.tau_s) for term in TERMS if term != MARKOV}

    def compute_term_variances(self, terms: tuple[str, ...], logs: Array) -> Array:
        """(terms, t) Allan variance of each term."""
        squares = np.exp(2 * np.clip(logs[: len(terms)], -LARGEST_LOG, LARGEST_LOG))
        return squares[:, None] * np.array(
            [self._compute_markov_variance(logs) if term == MARKOV else self._units[term] for term in terms]
        )

    @cached_property
    def _last_markov(self) -> dict[float, Array]:
        """Allan variance of Markov noise at the last time constant, which residuals and their derivatives share."""
        return {}

    def _compute_markov_variance(self, logs: Array) -> Array:
        """(t,) Allan variance of Markov noise per square of its coefficient."""
        constant = self.time_constant_s(logs)
        if constant not in self._last_markov:
            self._last_markov.clear()
            self._last_markov[constant] = compute_allan_variance(MARKOV, self.tau_s, constant)
        return self._last_markov[constant]

    def time_constant_s(self, logs: Array) -> float:
        """The last number, kept between half a sample's and twice the longest averaging time."""
        return float(np.exp(np.clip(logs[-1], np.log(0.5 * self.tau_s[0]), np.log(2 * self.tau_s[-1]))))

    def residuals(self, terms: tuple[str, ...], logs: Array) -> Array:
        """(t,) whitened."""
        return np.asarray(
            self.whitening @ (self.logs - np.log(self.known + self.compute_term_variances(terms, logs).sum(axis=0)))
        )

    def jacobian(self, terms: tuple[str, ...], logs: Array) -> Array:
        """(t, n) derivative of the whitened residuals."""
        shares = self.compute_term_variances(terms, logs)
        total = self.known + shares.sum(axis=0)
        rows = [2 * share / total for share in shares]
        if MARKOV in terms:
            share, moved = shares[terms.index(MARKOV)], np.append(logs[:-1], logs[-1] + SHIFT)
            now, then = self._compute_markov_variance(logs), self._compute_markov_variance(moved)
            rows.append(share * (then / now - 1) / total / SHIFT)
        return np.asarray(-self.whitening @ np.array(rows).T)

    def minimum(self, terms: tuple[str, ...], start: Array) -> tuple[Array, float]:
        """The numbers at which χ² is least, and that χ²."""
        # MINPACK's own call: that of `least_squares` with "lm", whose wrappers take as long as all else here.
        found, _, told, *_ = scipy.optimize.leastsq(
            lambda x: self.residuals(terms, x),
            start,
            Dfun=lambda x: self.jacobian(terms, x),
            full_output=True,
            ftol=1e-8,
            xtol=1e-8,
            gtol=1e-8,
            maxfev=200,
            diag=np.ones(len(start)),
        )
        x = np.clip(found, -LARGEST_LOG, LARGEST_LOG)
        if MARKOV in terms:
            x[-1] = np.log(self.time_constant_s(x))
        return x, float(told["fvec"] @ told["fvec"])


def compute_white_covariance(found: Deviation) -> Array:
    """(t, t) covariance of the estimates of angle white noise alone, relative to what they should be."""
    return _compute_relative_covariance(found, {ANGLE_WHITE: 1.0}, 1.0)


def build_problem(
    found: Deviation, floor: Array, white: Array | None, squares: Mapping[str, float], time_constant_s: float
) -> Problem:
    """Logarithms of the estimates and the covariance of their errors under some terms.

    Parameters
    ----------
    found : the estimates
    floor : (t,) Allan variance of what is known, whose share of each estimate scatters as that of angle white noise
    white : `compute_white_covariance` of the estimates; None where nothing is known
    squares, time_constant_s : of the terms, as for `estimate_covariance`
    """
    own = _compute_relative_covariance(found, squares, time_constant_s)
    if white is not None:
        share = floor / (floor + _compute_variance(found, squares, time_constant_s))
        crossed = np.sqrt(np.diag(own) * np.diag(white)) * share * (1 - share)
        V = own * np.outer(1 - share, 1 - share) + white * np.outer(share, share) + 2 * np.diag(crossed)
    else:
        V = own
    degrees = 2 / np.diag(V)
    # A ramp alone does not scatter: its estimate is worth more than a χ² of the noise, but no more than that of all samples.
    degrees = np.clip(degrees, 0.5, max(found.lengths))
    scale = np.sqrt(polygamma(1, degrees / 2) / np.diag(V))
    covariance = V * np.outer(scale, scale) + 1e-6 * np.eye(len(V))
    logs = np.log(found.variance) - (digamma(degrees / 2) - np.log(degrees / 2))
    return Problem(logs, np.linalg.inv(np.linalg.cholesky(covariance)), floor, found.tau_s, degrees)


def _compute_variance(found: Deviation, squares: Mapping[str, float], time_constant_s: float) -> Array:
    """(t,) Allan variance of some terms."""
    parts = (square * compute_allan_variance(term, found.tau_s, time_constant_s) for term, square in squares.items())
    return np.asarray(sum(parts, np.zeros(found.factors.size)))


def _compute_relative_covariance(found: Deviation, squares: Mapping[str, float], time_constant_s: float) -> Array:
    """(t, t) covariance of the estimates under some terms, relative to what they should be."""
    expected = _compute_variance(found, squares, time_constant_s)
    return np.asarray(estimate_covariance(found, squares, time_constant_s) / np.outer(expected, expected))
