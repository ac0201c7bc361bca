"""Overlapping Allan deviation of a rate, and its covariance.

With θ_k the angle summed over samples of length τ₀, and averages over τ = m τ₀,

    σ²(τ) = 1/(2 τ² M) Σ_k z_k²,    z_k = θ_{k+2m} − 2 θ_{k+m} + θ_k,

over all M differences of second order inside stretches without a hole; those of several stretches count together. IEEE Std
952, annex C.

M overlapping differences are not M independent ones. The estimate is distributed as σ² χ²(ν)/ν with ν = 2 E² / Var equivalent
degrees of freedom, which depend on the kinds of noise. For Gaussian noise and z^a, z^b the second differences over a and b
samples,

    Cov[Σ_i (z_i^a)², Σ_j (z_j^b)²] = Σ_ij [2 c_ab(i − j)² + 4 d_a d_b c_ab(i − j)],

with c_ab(k) = Σ_st α_s α_t κ(k + s a − t b), α = (1, −2, 1), κ of `gyrocal.allan.terms`, and d_a = R (a τ₀)² what a rate ramp
adds to every difference: those of Greenhall & Riley (35th PTTI, 2003) for any mixture of noise. c_ab is smooth on the scale of
the shorter average, so that the sum takes steps of an eighth of it; angle white noise, which sits at single lags, is added at
these. Beyond `REACH` of the longer average it is negligible.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.special

from gyrocal.allan.terms import ANGLE_WHITE, RAMP, compute_term_covariance
from gyrocal.arrays import Array, Indices
from gyrocal.errors import InputError

FEWEST_STRETCH_SAMPLES = 8  # samples in the longest stretch
DIFFERENCE_WEIGHTS = (1.0, -2.0, 1.0)
FINE_AVERAGE_STEPS = 8  # steps in the shorter average
REACH = 8  # longer averages, beyond which second differences have nothing in common


@dataclass(frozen=True)
class Deviation:
    """Overlapping Allan deviation."""

    sample_s: float  # length of a sample, s
    factors: Indices  # (t,) samples in an average, m
    variance: Array  # (t,) overlapping Allan variance, in the square of the rate's unit
    counts: Indices  # (t,) number of differences
    lengths: tuple[int, ...]  # samples of each stretch

    @property
    def tau_s(self) -> Array:
        """(t,) averaging time, s."""
        return np.asarray(self.factors * self.sample_s)

    @property
    def deviation(self) -> Array:
        """(t,) Allan deviation, in the rate's unit."""
        return np.sqrt(self.variance)

    def band(self, degrees: Array, confidence: float = 0.95) -> tuple[Array, Array]:
        """Compute confidence limits of the deviation, (t,) each, from equivalent degrees of freedom (t,): ν σ̂²/χ²(ν)."""
        tail = 0.5 * (1 - confidence)
        low, high = scipy.special.chdtri(degrees, tail), scipy.special.chdtri(degrees, 1 - tail)
        return np.sqrt(degrees * self.variance / low), np.sqrt(degrees * self.variance / high)


def overlapping_allan_deviation(
    parts: Sequence[Array], sample_s: float, factors: Sequence[int] | Indices | None = None
) -> Deviation:
    """Compute the overlapping Allan deviation of some stretches of samples.

    Raises `InputError` if no stretch is long enough for a factor.

    Parameters
    ----------
    parts : (n,) each: rates of consecutive samples
    sample_s : length of a sample, s
    factors : samples in an average; octaves by default
    """
    lengths = tuple(len(part) for part in parts if len(part) > 2)
    longest = max(lengths, default=0)
    if longest < FEWEST_STRETCH_SAMPLES:
        raise InputError(
            f"Allan deviation: the longest stretch has {longest} samples; at least {FEWEST_STRETCH_SAMPLES} are needed"
        )
    if factors is None:  # 1, 2, 4 … of which the longest stretch holds at least m differences
        factors = 2 ** np.arange(int(np.floor(np.log2((longest + 1) / 3))) + 1)
    averages = np.asarray(factors, dtype=np.intp)
    if averages.size == 0 or averages.min() < 1 or 2 * averages.max() > longest:
        raise InputError(f"Allan deviation: averaging factors must be from 1 to {longest // 2}, half the longest stretch")
    total, counts = np.zeros(averages.size), np.zeros(averages.size, dtype=np.intp)
    for part in parts:
        # Without the mean the sum stays small and keeps its digits.
        angle = np.append(0.0, np.cumsum(np.asarray(part, dtype=float) - np.mean(part)))
        for k, m in enumerate(averages):
            if angle.size <= 2 * m:
                continue
            z = angle[2 * m :] - 2 * angle[m:-m] + angle[: -2 * m]
            total[k] += z @ z
            counts[k] += z.size
    return Deviation(sample_s, averages, total / (2.0 * counts * averages.astype(float) ** 2), counts, lengths)


def estimate_covariance(deviation: Deviation, squares: Mapping[str, float]) -> Array:
    """Estimate the covariance (t, t) of the Allan variances under some terms, by the square of each coefficient."""
    factors = [int(m) for m in deviation.factors]
    ramp, white = np.sqrt(squares.get(RAMP, 0.0)) * deviation.tau_s**2, squares.get(ANGLE_WHITE, 0.0)
    kappa = _build_coloured_covariance(squares, deviation.sample_s)
    covariance = np.zeros((len(factors), len(factors)))
    for i, a in enumerate(factors):
        for j, b in enumerate(factors[: i + 1]):
            # Lags i − j at which c_ab is summed; each represents `step` lags.
            step = max(1, b // FINE_AVERAGE_STEPS)
            reach = min(REACH * a, max(deviation.lengths)) // step
            lags = step * np.arange(-reach, reach + 1)
            c, trend = _compute_difference_covariance(lags, a, b, kappa), 4 * ramp[i] * ramp[j]
            total = step * _count_pairs(lags, a, b, deviation.lengths) @ (2 * c**2 + trend * c)
            if white:
                white_weights = _compute_white_covariance(a, b)
                white_lags = np.array(sorted(white_weights), dtype=np.intp)
                w = white * np.array([white_weights[int(k)] for k in white_lags])
                c = _compute_difference_covariance(white_lags, a, b, kappa)
                # 2 (c + w)² + trend (c + w) minus the terms without w, which are summed above.
                total += _count_pairs(white_lags, a, b, deviation.lengths) @ (4 * c * w + 2 * w**2 + trend * w)
            scale = 4.0 * deviation.counts[i] * deviation.counts[j] * deviation.tau_s[i] ** 2 * deviation.tau_s[j] ** 2
            covariance[i, j] = covariance[j, i] = total / scale
    return covariance


def _build_coloured_covariance(squares: Mapping[str, float], sample_s: float) -> Callable[[Indices], Array]:
    """Build κ of all terms but angle white noise and the ramp, as a function of lags in samples."""
    coloured = {term: square for term, square in squares.items() if square and term not in (ANGLE_WHITE, RAMP)}

    def compute_kappa(lags: Indices) -> Array:
        t_s = np.asarray(lags * sample_s, dtype=np.float64)
        parts = (square * compute_term_covariance(term, t_s) for term, square in coloured.items())
        return np.asarray(sum(parts, np.zeros(len(lags))))

    return compute_kappa


def _count_pairs(lags: Indices, a: int, b: int, lengths: tuple[int, ...]) -> Array:
    """Count the pairs of differences (i over a, j over b) of one stretch with i − j = lag, over all stretches."""
    total = np.zeros(len(lags))
    for n in lengths:
        first, second = n + 1 - 2 * a, n + 1 - 2 * b
        if first > 0 and second > 0:
            total += np.clip(np.minimum(first, second + lags) - np.maximum(0, lags), 0, None)
    return total


def _compute_difference_covariance(lags: Indices, a: int, b: int, kappa: Callable[[Indices], Array]) -> Array:
    """Compute c_ab at ascending lags, for κ as a function of the lag."""
    weights = _compute_white_covariance(a, b)
    step = int(lags[1] - lags[0])
    if a % step or b % step or (np.diff(lags) != step).any():
        return np.asarray(sum(weight * kappa(lags - lag) for lag, weight in weights.items()))
    # Shifted by multiples of their step the lags coincide: κ is computed once at each, instead of up to nine times.
    low, high = int(lags[0]) - max(weights), int(lags[-1]) - min(weights)
    kappas = kappa(np.arange(low, high + 1, step))
    first = {lag: (int(lags[0]) - lag - low) // step for lag in weights}
    return np.asarray(sum(weight * kappas[first[lag] : first[lag] + len(lags)] for lag, weight in weights.items()))


def _compute_white_covariance(a: int, b: int) -> dict[int, float]:
    """Compute c_ab of unit angle white noise at the lags where it is not zero."""
    covariance: dict[int, float] = {}
    for s, weight in enumerate(DIFFERENCE_WEIGHTS):
        for t, weight_t in enumerate(DIFFERENCE_WEIGHTS):
            lag = t * b - s * a
            covariance[lag] = covariance.get(lag, 0.0) + weight * weight_t
    return covariance
