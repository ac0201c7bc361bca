"""Score tests of innovations, which are white noise if the model is true.

Innovations in the order of time are N(0, I − U Uᵀ), with U an orthonormal basis of the directions of nuisance parameters.
Those of all references under M0 (`diagnosis.model.misfit`) are so. Their tests have p-values that need no draws:

* size: |e|² is χ²;
* regressors: the components of e along the projected regressors are N(0, I);
* correlation in time: products at some lags, less their mean −U Uᵀ, over their own scatter (the score test of an
  autoregression; Godfrey, Econometrica 46, 1978);
* scatter: whether e² follows the intervals and the rate (Breusch and Pagan, Econometrica 47, 1979). |e|^⅔ stands for e², since
  its sums are nearly normal (Wilson and Hilferty, PNAS 17, 1931);
* shape: kurtosis (Anscombe and Glynn, Biometrika 70, 1983).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.special

from gyrocal.arrays import Array, Indices
from gyrocal.calibration.estimated_noise import compute_chi2_p, compute_smaller_chi2_p

LEAST_POSITIVE = 1e-300  # least p-value

FEWEST = 30  # degrees of freedom below which the approximate p-values do not hold and nothing is tested
LAGS = 6  # of the correlation in time
# share of its variance that an innovation keeps beside the nuisance parameters, from which on its size counts; that of a
# regressor is the same
SHOWN = 0.1
POWER = 2 / 3  # of |e| in the test of the scatter

MEAN_ABSOLUTE_POWER = 2 ** (POWER / 2) * scipy.special.gamma((POWER + 1) / 2) / np.sqrt(np.pi)  # of |z|^POWER, z normal
VARIANCE = 2**POWER * scipy.special.gamma(POWER + 0.5) / np.sqrt(np.pi) - MEAN_ABSOLUTE_POWER**2


@dataclass(frozen=True)
class Check:
    """One test: its name, the statistic, the mean of this under the explanation, and the p-value."""

    name: str
    value: float
    expected: float
    p_value: float


@dataclass(frozen=True)
class Layout:
    """Axes, interval and regressors of each observation of a linear model."""

    axes: Array  # (r, 3, 3) rotation of its three rows to body axes
    interval: Indices  # (r,) number of its interval
    regressors: Array  # (r, q) series that the innovations may follow, such as rates, accelerations and temperatures
    speed: Array  # (r,) size of the rate, rad/s


@dataclass(frozen=True)
class Innovations:
    """Innovations (r, 3) along the body axes, and (r, 3, q) the orthonormal basis of the directions that they lack."""

    e: Array
    basis: Array

    @property
    def dof(self) -> int:
        """Degrees of freedom."""
        return self.e.size - self.basis.shape[2]

    @property
    def remaining_variance(self) -> Array:
        """(r, 3) variance of each."""
        return np.asarray(1 - np.sum(self.basis**2, axis=2))


def combine_checks(checks: Sequence[Check]) -> float:
    """Combine the p-values of all checks, with an allowance for their number; one without checks."""
    return min([1.0, *(check.p_value * len(checks) for check in checks)])


def check_innovations(innovations: Innovations, layout: Layout, noise_degrees: float = np.inf) -> Iterator[Check]:
    """Test whether innovations are white noise of variance one.

    Parameters
    ----------
    innovations, layout : the innovations, and their axes, intervals and regressors
    noise_degrees : degrees of freedom of an estimated noise level, with which the size has an F distribution
        (`gyrocal.calibration.estimated_noise`)
    """
    size = float(np.sum(innovations.e**2))
    larger = compute_chi2_p(size, innovations.dof, noise_degrees)
    yield _build_check(
        "size", size, innovations.dof, 2 * min(larger, compute_smaller_chi2_p(size, innovations.dof, noise_degrees))
    )
    yield _test_regressors(innovations, layout.regressors)
    yield _test_correlation(innovations, layout.interval)
    is_visible = innovations.remaining_variance > SHOWN
    standard = innovations.e / np.sqrt(np.where(is_visible, innovations.remaining_variance, 1.0))
    sizes = (np.abs(standard) ** POWER - MEAN_ABSOLUTE_POWER) / np.sqrt(VARIANCE)
    yield _test_scatter(np.where(is_visible, sizes, 0.0), layout)
    kurtosis, p = compute_kurtosis(standard[is_visible])
    yield _build_check("shape", kurtosis, 3.0, p)


def compute_kurtosis(x: Array) -> tuple[float, float]:
    """Compute the kurtosis of numbers (n,) and its p-value under normality (Anscombe and Glynn, Biometrika 70, 1983)."""
    n, centred = x.size, x - x.mean()
    kurtosis = float(np.mean(centred**4) / np.mean(centred**2) ** 2)
    spread = np.sqrt(24 * n * (n - 2) * (n - 3) / ((n + 1) ** 2 * (n + 3) * (n + 5)))
    score = (kurtosis - 3 * (n - 1) / (n + 1)) / spread
    skewness = 6 * (n**2 - 5 * n + 2) / ((n + 7) * (n + 9)) * np.sqrt(6 * (n + 3) * (n + 5) / (n * (n - 2) * (n - 3)))
    degrees = 6 + 8 / skewness * (2 / skewness + np.sqrt(1 + 4 / skewness**2))
    root = np.cbrt((1 - 2 / degrees) / (1 + score * np.sqrt(2 / (degrees - 4))))
    normal = (1 - 2 / (9 * degrees) - root) / np.sqrt(2 / (9 * degrees))
    return kurtosis, float(2 * scipy.special.ndtr(-abs(normal)))


def _build_check(name: str, value: float, expected: float, p_value: float) -> Check:
    return Check(name, value, float(expected), float(np.clip(p_value, LEAST_POSITIVE, 1.0)))


def _test_regressors(innovations: Innovations, regressors: Array) -> Check:
    """Test the components of the innovations along regressors (r, k) about each axis."""
    basis = innovations.basis.reshape(innovations.e.size, -1)
    X = np.kron(_build_orthonormal_basis(regressors), np.eye(3))
    U, s, _ = np.linalg.svd(X - basis @ (basis.T @ X), full_matrices=False)
    along = U[:, s**2 > SHOWN].T @ innovations.e.ravel()
    value = float(along @ along)
    return _build_check("dependence on what is known", value, along.size, scipy.special.chdtrc(max(along.size, 1), value))


def _test_correlation(innovations: Innovations, interval: Indices) -> Check:
    """Test the products of innovations at some lags about each axis."""
    value, count = 0.0, 0
    for lag in range(1, LAGS + 1):
        same = interval[lag:] == interval[:-lag]
        mean = -np.einsum("raq,raq->ra", innovations.basis[lag:][same], innovations.basis[:-lag][same])
        products = innovations.e[lag:][same] * innovations.e[:-lag][same] - mean
        if len(products) >= FEWEST:
            value += float(np.sum(products.sum(axis=0) ** 2 / np.sum(products**2, axis=0)))
            count += 3
    return _build_check("correlation in time", value, count, scipy.special.chdtrc(count, value) if count else 1.0)


def _test_scatter(sizes: Array, layout: Layout) -> Check:
    """Test whether normalised sizes (r, 3) follow the intervals and the rate."""
    indicators = (layout.interval[:, None] == np.unique(layout.interval)).astype(float)
    W = _build_orthonormal_basis(np.column_stack([indicators, layout.speed]))
    value, count = float(np.sum((W.T @ sizes) ** 2)), 3 * W.shape[1]
    return _build_check("scatter over intervals and rates", value, count, scipy.special.chdtrc(max(count, 1), value))


def _build_orthonormal_basis(regressors: Array) -> Array:
    """Build an orthonormal basis (r, ≤ k) of regressors (r, k) less their means."""
    centred = regressors - regressors.mean(axis=0)
    size = np.linalg.norm(centred, axis=0)
    return np.asarray(scipy.linalg.orth(centred[:, size > 0] / size[size > 0], rcond=1e-6))
