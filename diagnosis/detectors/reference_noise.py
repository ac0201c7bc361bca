"""Whether the references' white noise is what is stated, from second differences of the residuals of a series.

Second differences of three references at even spacing Δt leave nothing of slow errors, whatever their cause. Under M0 their
variance about body axis i is 6 σ_i² + 2 d_i Δt, d_i the noise density of gyro i as the samples show it; neighbouring ones
correlate by (−4/6, 1/6), so that the variance of the mean square of n of them is (2/n)(1 + 2 (16 + 1)/36) of its square.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from diagnosis.model.recording import RecordingModel
from diagnosis.settings import DEFAULT, DiagnosisSettings

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CORRELATED = 1 + 2 * 17 / 36
TRIM = 3.0  # robust sigmas beyond which a difference does not count
TRIMMED = 0.9733  # variance of a normal variable cut there
FEWEST = 40  # second differences of an axis, below which nothing is said
UNSEEN = 10.0  # relative error of an axis of which nothing is seen
TRIMMING = 1.1  # times the variance of a mean square whose limit was estimated


@dataclass(frozen=True)
class ReferenceNoise:
    """Actual over stated noise of the references.

    Attributes
    ----------
    factor, sigma : (3,) by body axis; NaN where there are too few
    p_value : that all three are one
    axis : the one axis that departs, or None for all
    correlation, correlation_p : largest correlation between two axes, and the p-value of there being none
    event_p : p-value below which the noise is not as stated
    constancy, constancy_p : largest ratio of the power in one interval, or in motion, to the rest, and the p-value of one
    """

    factor: Array
    sigma: Array
    p_value: float
    axis: int | None
    correlation: float = 0.0
    correlation_p: float = 1.0
    constancy: float = 1.0
    constancy_p: float = 1.0
    event_p: float = DEFAULT.sample_event

    @property
    def departs(self) -> bool:
        """Whether the noise is not as stated."""
        return self.p_value < self.event_p

    @property
    def factors(self) -> Array:
        """(3,) what to multiply the stated sigma with."""
        if not self.departs:
            return np.ones(3)
        if self.axis is None:
            weight = 1 / self.sigma**2
            return np.full(3, float(np.sum(self.factor * weight) / np.sum(weight)))
        out = np.ones(3)
        out[self.axis] = self.factor[self.axis]
        return out


def reference_noise(
    model: RecordingModel, density: Array, dead: Array, settings: DiagnosisSettings = DEFAULT
) -> ReferenceNoise | None:
    """Test of the references' noise; None without a series of references.

    Parameters
    ----------
    model : linearised about the calibration
    density : (3,) noise density of the gyros, rad²/s
    dead : (n, 3) samples in which a gyro may show nothing; what it then misses would pass for noise about its axis
    settings : thresholds
    """
    missed = np.concatenate([np.zeros((1, 3), dtype=np.intp), np.cumsum(dead, axis=0)])
    t_s = model.references.t_s
    sigma = model.recording.attitudes.sigma[model.reference_rows]
    gyro_s = model.recording.gyro.t_s
    before, after = t_s[1:-1] - t_s[:-2], t_s[2:] - t_s[1:-1]
    owner = model.interval_of_reference
    usual = np.array(
        [np.median(np.diff(t_s[owner == k])) if np.sum(owner == k) > 1 else np.inf for k in range(len(model.blocks))]
    )
    even = (owner[2:] == owner[:-2]) & (np.abs(before - after) <= 0.01 * before) & (before <= 2.5 * usual[owner[1:-1]])
    first, last = np.searchsorted(gyro_s, t_s[:-2]), np.searchsorted(gyro_s, t_s[2:])
    k = 1 + np.flatnonzero(even)
    hidden = (missed[last] > missed[first])[k - 1]
    # ζ of neighbours differ by the references' errors; turned back to the body axes of the middle one.
    zeta = model.residuals
    A = model.at_reference[k].transpose(0, 2, 1)
    differences = np.einsum("mij,mj->mi", A, zeta[k + 1] - 2 * zeta[k] + zeta[k - 1])
    # The body turns between references; where it turns far, axes mix and σ differs between them.
    variances = sum(
        weight * np.einsum("mij,mj->mi", (A @ model.at_reference[k + shift]) ** 2, sigma[k + shift] ** 2)
        for weight, shift in ((1, -1), (4, 0), (1, 1))
    )
    walks = 2 * density * before[k - 1, None]
    enough = np.sum(~hidden, axis=0) >= FEWEST
    if not enough.any() or not np.all(variances > 0):
        return None
    second, stated, walk = differences, np.asarray(variances), walks
    z = second / np.sqrt(stated + walk)
    # Single large differences, as beside a slew with wrong time tags, are not noise.
    limit = (
        TRIM * np.array([np.median(np.abs(z[~hidden[:, axis], axis])) if enough[axis] else 0.0 for axis in range(3)]) / 0.6745
    )
    kept = (np.abs(z) < limit) & ~hidden & enough
    sums = np.sum(np.where(kept, second**2, 0.0), axis=0) / TRIMMED
    expected_sigma, expected_walk = np.sum(np.where(kept, stated, 0.0), axis=0), np.sum(np.where(kept, walk, 0.0), axis=0)
    relative = np.sqrt(2 * CORRELATED * TRIMMING / np.maximum(np.sum(~hidden, axis=0), 1))
    # An axis with too few differences is taken as stated, with no certainty.
    expected_sigma = np.where(enough, expected_sigma, 1.0)
    factor = np.where(enough, np.sqrt(np.maximum((sums - expected_walk) / expected_sigma, 1e-4)), 1.0)
    error = np.where(enough, 0.5 * relative * (sums / expected_sigma) / factor, UNSEEN)
    # A sum of squares has a long upper tail; its cube root is normal (Wilson & Hilferty, 1931).
    spread = relative**2 / 9
    total = np.where(enough, sums / (expected_sigma + expected_walk), 1.0 - 3 * spread)
    z = np.where(enough, (np.cbrt(total) - (1 - spread)) / np.sqrt(spread), 0.0)
    chi2 = float(np.sum(z**2))
    p_all = float(scipy.stats.chi2.sf(chi2, enough.sum()))
    odd = int(np.argmax(np.abs(z)))
    others = float(chi2 - z[odd] ** 2)
    axis = odd if enough.sum() > 1 and scipy.stats.chi2.sf(others, enough.sum() - 1) > 0.01 and z[odd] ** 2 > 12 else None
    scaled = np.where(kept, second / np.sqrt(stated + walk), 0.0)
    rates = np.linalg.norm(model.rates[np.clip(np.searchsorted(model.t_s, t_s[k]), 0, model.t_s.size - 1)], axis=1)
    moving = rates > 0.5 * (np.quantile(rates, 0.02) + np.quantile(rates, 0.98))
    groups = [moving, *(owner[k] == number for number in np.unique(owner[k]))]
    return ReferenceNoise(
        factor,
        error,
        max(p_all, 1e-300),
        axis,
        *_correlation(scaled, kept),
        *_constancy(scaled, kept, groups),
        settings.sample_event,
    )


def _correlation(z: Array, kept: Mask) -> tuple[float, float]:
    """Largest correlation coefficient between two axes, and the p-value of all three being zero."""
    found = []
    for i, j in ((0, 1), (0, 2), (1, 2)):
        both = kept[:, i] & kept[:, j]
        if both.sum() < FEWEST:
            continue
        a, b = z[both, i], z[both, j]
        coefficient = float(np.mean(a * b) / np.sqrt(np.mean(a**2) * np.mean(b**2)))
        p = 2 * float(scipy.stats.norm.sf(abs(coefficient) / np.sqrt(CORRELATED / both.sum())))
        found.append((min(1.0, 3 * p), coefficient))
    p, coefficient = min(found, default=(1.0, 0.0))
    return coefficient, max(p, 1e-300)


def _constancy(z: Array, kept: Mask, groups: list[Mask]) -> tuple[float, float]:
    """Largest ratio of the power of one group to that of the rest, and the p-value of all being one."""
    best = (1.0, 1.0)
    for axis in range(3):
        for group in groups:
            own, rest = z[kept[:, axis] & group, axis], z[kept[:, axis] & ~group, axis]
            if min(own.size, rest.size) < FEWEST:
                continue
            ratio = float(np.mean(own**2) / np.mean(rest**2))
            sigma = float(np.sqrt(2 * CORRELATED * TRIMMING * (1 / own.size + 1 / rest.size)))
            p = min(1.0, 6 * len(groups) * float(scipy.stats.norm.sf(abs(np.log(ratio)) / sigma)))
            if p < best[0]:
                best = (max(p, 1e-300), ratio)
    return best[1], best[0]
