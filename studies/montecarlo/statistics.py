"""Statistics of independent cases: NEES, binomial intervals and tolerance intervals.

NEES, the normalised estimation error squared eᵀP⁻¹e, is χ² with p degrees of freedom if the covariance P is consistent with
the errors; the sum over n cases is χ² with np.
"""

from dataclasses import dataclass

import numpy as np
import scipy.special
from numpy.typing import ArrayLike

from gyrocal.arrays import Array


@dataclass(frozen=True)
class Nees:
    """Mean NEES over the cases and its two-sided bounds."""

    value: float
    lower: float
    upper: float
    dof: int
    cases: int

    @property
    def is_inside(self) -> bool:
        """Whether the mean lies within its bounds."""
        return self.lower <= self.value <= self.upper


def compute_nees(errors: Array, covariances: Array) -> Array:
    """Compute eᵀP⁻¹e of each case; errors (n, p), covariances (n, p, p), normalised first, so that units may be mixed."""
    scale = np.sqrt(np.einsum("nii->ni", covariances))
    normalised = errors / scale
    correlation = covariances / (scale[:, :, None] * scale[:, None, :])
    return np.einsum("ni,ni->n", normalised, np.linalg.solve(correlation, normalised[..., None])[..., 0])


def check_mean_nees(values: ArrayLike, dof: int, confidence: float = 0.99) -> Nees:
    """Compute the mean NEES of n independent cases with its χ² bounds at the given confidence; NaN is left out."""
    present = np.asarray(values, dtype=float)
    present = present[~np.isnan(present)]
    n = len(present)
    tail = (1 - confidence) / 2
    lower, upper = scipy.special.chdtri(n * dof, [1 - tail, tail]) / n  # the survival function's inverse
    return Nees(float(np.mean(present)), float(lower), float(upper), dof, n)


def compute_binomial_interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Compute Wilson's interval of a proportion; [0, 1] without a trial. J. Am. Stat. Assoc. 22 (1927) 209."""
    from scipy.stats import binomtest  # scipy.stats costs every worker 45 MiB, and no case needs it

    if trials == 0:
        return 0.0, 1.0
    interval = binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)


def compute_binomial_band(trials: int, probability: float, confidence: float, counts: int = 1) -> tuple[int, int]:
    """Compute bounds that all of several counts of `trials` with this share keep with at least this confidence."""
    from scipy.stats import binom

    tail = (1 - confidence) / (2 * counts)
    low, high = binom.ppf([tail, 1 - tail], trials, probability)
    return int(low), int(high)


def _interpolate(below: Array, above: Array, weight: float) -> Array:
    """Interpolate between two order statistics; an infinite one reaches as far as the other, and both ends have no middle."""
    finite = np.isfinite(below) & np.isfinite(above)
    with np.errstate(invalid="ignore"):
        return np.where(below == above, below, np.where(finite, below + weight * (above - below), below + above))


def compute_quantile(values: ArrayLike, probability: float) -> float:
    """Compute a quantile of values (n,), also infinite ones, between two order statistics; NaN without a value."""
    ordered = np.sort(np.asarray(values, dtype=float))
    if not len(ordered):
        return np.nan
    position = probability * (len(ordered) - 1)
    return float(_interpolate(ordered[int(np.floor(position))], ordered[int(np.ceil(position))], position % 1))


def compute_tolerance_interval(values: ArrayLike, content: float = 0.95, confidence: float = 0.95) -> Array:
    """Compute the interval (..., 2) with this content and confidence from values (..., n); NaN for too few.

    Infinite values count: an end that reaches them is infinite.

    Between the order statistics r and r + d lies a share Beta(d, n − d + 1), so P(share ≥ content) = P(K ≤ d − 1) of a binomial
    K (S. S. Wilks, Ann. Math. Stat. 12 (1941) 91). The smallest d with enough confidence has too much of it. The upper end is
    therefore interpolated towards that of d − 1, by the weight of J. Nyblom, Stat. Probab. Lett. 14 (1992) 129.
    """
    from scipy.stats import binom

    ordered = np.sort(np.asarray(values, dtype=float))
    n = ordered.shape[-1]
    d = int(binom.ppf(confidence, n, content)) + 1 if n else 0
    if d > n - 1 or not n:
        return np.full((*ordered.shape[:-1], 2), np.nan)
    reached_below, reached = binom.cdf([d - 2, d - 1], n, content)
    lower = (n - d + 1) // 2  # counted from 1
    gain, loss = (n - d + 1) * content * (confidence - reached_below), (d - 1) * (1 - content) * (reached - confidence)
    below, above = ordered[..., lower + d - 2], ordered[..., lower + d - 1]
    return np.stack([ordered[..., lower - 1], _interpolate(below, above, gain / (gain + loss))], axis=-1)
