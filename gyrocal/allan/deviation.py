"""Overlapping Allan deviation of a rate, and how far it scatters.

With θ_k the angle that samples of length τ₀ add up to, and averages over τ = m τ₀,

    σ²(τ) = 1/(2 τ² M) Σ_k z_k²,    z_k = θ_{k+2m} − 2 θ_{k+m} + θ_k,

over all M differences of second order inside stretches without a hole; those of several stretches count together. IEEE Std
952, annex C.

M overlapping differences are not M independent ones. The estimate is distributed as σ² χ²(ν)/ν with ν = 2 E² / Var equivalent
degrees of freedom, which depend on the kind of noise. Greenhall & Riley, "Uncertainty of stability variances based on finite
differences" (35th PTTI, 2003) give them for a spectrum of the rate ∝ f^α by the generalised autocovariance s_z of z,

    ν = M s_z²(0) / [s_z²(0) + 2 Σ_{j=1}^{J−1} (1 − j/M) s_z²(j/m) + (1 − J/M) s_z²(J/m)],    J = min(M, 3m),

with s_z = 6 s_x(t) − 4 s_x(t ± 1) + s_x(t ± 2) (each sign once), s_x = m² [2 s_w(t) − s_w(t − 1/m) − s_w(t + 1/m)] and s_w(t) =
−|t|, t² ln|t|, |t|³, −t⁴ ln|t|, −|t|⁵ for α = 2, 1, 0, −1, −2. That is of angles averaged over a sample, which matters for the
first few factors only. For a large m the difference in s_x is taken as the derivative that it tends to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.special
from numpy.typing import NDArray

from gyrocal.errors import InputError

Array = NDArray[np.float64]
Counts = NDArray[np.intp]

ALPHAS = (2, 1, 0, -1, -2)  # angle white noise, angle flicker, angle random walk, bias instability, rate random walk
LARGE_AVERAGE_SAMPLES = (
    512  # samples in an average, from where on the difference in s_x is a derivative; its error is of the order of 1/m
)
FEWEST_STRETCH_SAMPLES = 8  # samples in the longest stretch


@dataclass(frozen=True)
class Deviation:
    """Overlapping Allan deviation."""

    sample_s: float  # length of a sample, s
    factors: Counts  # (t,) samples in an average, m
    variance: Array  # (t,) overlapping Allan variance, in the square of the rate's unit
    counts: Counts  # (t,) differences it rests on
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
        """Confidence limits of the deviation, (t,) each, from equivalent degrees of freedom (t,): ν σ̂²/χ²(ν)."""
        tail = 0.5 * (1 - confidence)
        low, high = scipy.special.chdtri(degrees, tail), scipy.special.chdtri(degrees, 1 - tail)
        return np.sqrt(degrees * self.variance / low), np.sqrt(degrees * self.variance / high)


def list_octaves(longest: int) -> Counts:
    """(t,) averaging factors 1, 2, 4 … of which a stretch of so many samples holds at least m differences."""
    return np.asarray(2 ** np.arange(int(np.floor(np.log2((longest + 1) / 3))) + 1), dtype=np.intp)


def overlapping_allan_deviation(
    parts: Sequence[Array], sample_s: float, factors: Sequence[int] | Counts | None = None
) -> Deviation:
    """Overlapping Allan deviation of some stretches of samples.

    An `InputError` if no stretch is long enough for a factor.

    Parameters
    ----------
    parts : (n,) each: rates of samples that follow one another without a hole
    sample_s : length of a sample, s
    factors : samples in an average; octaves by default
    """
    lengths = tuple(len(part) for part in parts if len(part) > 2)
    longest = max(lengths, default=0)
    if longest < FEWEST_STRETCH_SAMPLES:
        raise InputError(
            f"Allan deviation: the longest stretch has {longest} samples; at least {FEWEST_STRETCH_SAMPLES} are needed"
        )
    chosen = list_octaves(longest) if factors is None else np.asarray(factors, dtype=np.intp)
    if chosen.size == 0 or chosen.min() < 1 or 2 * chosen.max() > longest:
        raise InputError(f"Allan deviation: averaging factors must be from 1 to {longest // 2}, half the longest stretch")
    total, counts = np.zeros(chosen.size), np.zeros(chosen.size, dtype=np.intp)
    for part in parts:
        # Without its mean the sum stays small, and loses no digits.
        angle = np.append(0.0, np.cumsum(np.asarray(part, dtype=float) - np.mean(part)))
        for place, m in enumerate(chosen):
            if angle.size <= 2 * m:
                continue
            z = angle[2 * m :] - 2 * angle[m:-m] + angle[: -2 * m]
            total[place] += z @ z
            counts[place] += z.size
    return Deviation(sample_s, chosen, total / (2.0 * counts * chosen.astype(float) ** 2), counts, lengths)


def compute_edf(alpha: int, factor: int, samples: int) -> float:
    """Equivalent degrees of freedom of the overlapping Allan variance of one stretch.

    An `InputError` if there is no such exponent, or the stretch is too short.

    Parameters
    ----------
    alpha : exponent of the rate's spectrum, one of `ALPHAS`
    factor : samples in an average, m
    samples : in the stretch
    """
    if alpha not in ALPHAS:
        raise InputError(f"edf: alpha must be one of {', '.join(map(str, ALPHAS))}, not {alpha}")
    count = samples + 1 - 2 * factor
    if factor < 1 or count < 1:
        raise InputError(f"edf: {samples} samples are too few for averages over {factor}")
    last = min(count, 3 * factor)
    sz = _compute_sz(np.arange(last + 1) / factor, factor, alpha)
    j = np.arange(1, last)
    total = sz[0] ** 2 + 2 * np.sum((1 - j / count) * sz[1:last] ** 2) + (1 - last / count) * sz[last] ** 2
    return float(count * sz[0] ** 2 / total)


def compute_pooled_edf(alpha: int, factor: int, lengths: Sequence[int]) -> float:
    """Equivalent degrees of freedom of all stretches together, each weighted with its number of differences."""
    counts = {n: n + 1 - 2 * factor for n in lengths if n + 1 > 2 * factor}
    total = sum(counts[n] for n in lengths if n in counts)
    own = {n: count**2 / compute_edf(alpha, factor, n) for n, count in counts.items()}
    return float(total**2 / sum(own[n] for n in lengths if n in own))


def _compute_sz(t: Array, factor: int, alpha: int) -> Array:
    """s_z of second differences."""
    return np.asarray(
        6 * _compute_sx(t, factor, alpha)
        - 4 * (_compute_sx(t - 1, factor, alpha) + _compute_sx(t + 1, factor, alpha))
        + _compute_sx(t - 2, factor, alpha)
        + _compute_sx(t + 2, factor, alpha)
    )


def _compute_sx(t: Array, factor: int, alpha: int) -> Array:
    """s_x of sums; for α = 2 and 1 the derivative has no finite values, and the difference loses no digits."""
    if factor > LARGE_AVERAGE_SAMPLES and alpha < 1:
        return _compute_sw(t, alpha + 2)
    step = 1.0 / factor
    return np.asarray(factor**2 * (2 * _compute_sw(t, alpha) - _compute_sw(t - step, alpha) - _compute_sw(t + step, alpha)))


def _compute_sw(t: Array, alpha: int) -> Array:
    """s_w, a generalised autocovariance of noise whose spectrum is ∝ f^(α−4)."""
    size = np.abs(t)
    if alpha % 2:
        power = 3 - alpha
        sign = 1.0 if alpha == 1 else -1.0
        return np.asarray(sign * size**power * np.log(np.where(size > 0, size, 1.0)))
    return np.asarray({2: -1.0, 0: 1.0, -2: -1.0}[alpha] * size ** (3 - alpha))
