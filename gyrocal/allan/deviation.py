"""Overlapping Allan deviation of a rate, and how far it scatters.

With θ_k the angle that samples of length τ₀ add up to, and averages over τ = m τ₀,

    σ²(τ) = 1/(2 τ² M) Σ_k z_k²,    z_k = θ_{k+2m} − 2 θ_{k+m} + θ_k,

over all M differences of second order inside stretches without a hole; those of several stretches count together. IEEE Std
952, annex C.

M overlapping differences are not M independent ones. The estimate is distributed as σ² χ²(ν)/ν with ν = 2 E² / Var equivalent
degrees of freedom, which depend on the kinds of noise: `gyrocal.allan.covariance` gives the variance.
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
