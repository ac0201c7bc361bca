"""Test whether the references' white noise is as stated, by second differences of the residuals of a series.

Second differences of three references at even spacing Δt leave nothing of slow errors, whatever their cause. Under M0 their
variance about body axis i is 6 σ_i² + 2 d_i Δt, d_i the noise density of gyro i as the samples show it; neighbouring ones
correlate by (−4/6, 1/6), so that the variance of the mean square of n of them is (2/n)(1 + 2 (16 + 1)/36) of its square.

A strong random error of the gyro's rate from one reference to the next makes them larger as well. Second differences of every
other reference tell which it is: the references' part is the same in them, and that of the angle turned is twice as large.

An error that follows a fast motion, such as late tags make, is as large from one reference to the next and no noise. Where the
differences depart from the stated noise, those of attitude errors that follow the motion are subtracted first by least squares:
errors proportional to the rates, to their sizes, squares or changes, and drifts. An excess that these explain is no noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.special

from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.arrays import Array, Indices, Mask

CORRELATED = 1 + 2 * 17 / 36  # variance of the mean square of second differences, beside that of independent ones
TRIM = 3.0  # robust sigmas beyond which a difference does not count
NORMAL = 0.6745  # median of the absolute value of a standard normal variable
ROBUST_ERROR = 1.17  # relative error of a robust sigma, times the root of the number of values
TRIMMED = 0.9733  # variance of a normal variable cut there
FEWEST = 40  # second differences, below which nothing is said
# Log odds of an excess of the references, below which it is one of the angle turned: of the two the first is on the list,
# and white noise of the gyros that is as large would show in the samples as a rule.
UNLIKELY = -3.0
OF_EACH = 4  # second differences for each error that is fitted to them, at least
# least factor that is stated: the smaller, the smaller its error
LEAST = 0.01
FAINTEST = 1e-9
ROUNDS = 3  # of a fit whose large residuals do not count
TRIMMING = 1.1  # times the variance of a mean square whose limit was estimated


@dataclass(frozen=True)
class ReferenceSeries:
    """References in the order of time beside the attitude propagated between them."""

    t_s: Array  # t_s, interval: (m,) times, and the number of the interval each belongs to
    interval: Indices
    sigma: Array  # (m, 3) stated, about the body axes, rad
    to_inertial: Array  # (m, 3, 3) Aᵀ of the propagated attitude
    residuals: Array  # (m, 3) reference minus propagated attitude, inertial, rad
    # (m, 3, 3) body components of independent errors of these sigmas; None of errors that are independent themselves
    error_axes: Array | None = None


@dataclass(frozen=True)
class ReferenceNoise:
    """Actual over stated noise of the references."""

    factor: Array  # factor, sigma: (3,) by body axis
    sigma: Array
    p_value: float  # that all three are one
    axis: int | None  # the one axis that departs, or None for all
    event_p: float = DEFAULT.sample_event  # p-value below which the noise is not as stated
    of_gyro: bool = False  # whether an excess is rather one of the angle turned in each spacing, and so the gyro's
    likeness: float = 1.0  # p-value of how it behaves, if it is white and normal

    @property
    def departs(self) -> bool:
        """Whether the noise is not as stated."""
        return self.p_value < self.event_p and not self.of_gyro

    @property
    def is_unusual(self) -> bool:
        """Whether the level is not that of the stated white noise, by errors of the references or of the angle turned."""
        return self.p_value < self.event_p

    @property
    def factors(self) -> Array:
        """Factors (3,) of the stated sigma; one unless the references' noise departs."""
        if not self.departs:
            return np.ones(3)
        if self.axis is None:
            weight = 1 / self.sigma**2
            return np.full(3, float(np.sum(self.factor * weight) / np.sum(weight)))
        out = np.ones(3)
        out[self.axis] = self.factor[self.axis]
        return out


@dataclass(frozen=True)
class Differences:
    """Second differences of the residuals, in the body axes of the middle reference."""

    values: Array  # (k, 3), rad
    stated: Array  # stated, walk: (k, 3) their variances from the references as stated and from the gyros' noise, rad²
    walk: Array


def estimate_reference_noise(
    series: ReferenceSeries, density: Array, settings: DiagnosisSettings = DEFAULT, motion: Array | None = None
) -> ReferenceNoise | None:
    """Test the references' noise beside noise of the gyros of densities (3,), rad²/s; None without a series of references.

    The part of the k attitude errors `motion` (m, 3, k), rad about inertial axes, that follow the motion is subtracted.
    """
    differences, wider = (_find_differences(series, density, motion, spacing) for spacing in (1, 2))
    if len(differences.values) < FEWEST or not np.all(differences.stated > 0):
        return None
    z = differences.values / np.sqrt(differences.stated + differences.walk)
    # Single large differences, as beside a slew with wrong time tags, are not noise.
    is_inlier = np.abs(z) < TRIM * np.median(np.abs(z), axis=0) / NORMAL
    factor, sigma, p, axis = _estimate_factors(differences, is_inlier)
    if p >= settings.sample_event:
        return ReferenceNoise(factor, sigma, p, axis, settings.sample_event)
    axes = np.arange(3) if axis is None else np.array([axis])
    of_gyro = False
    if np.any(factor > 1):  # log odds of an excess of the references against one of the angle turned, of two spacings
        chi2 = [_compare_spacings(differences, wider, int(k)) for k in axes]
        of_gyro = sum(0.5 * (of_angle - of_references) for of_references, of_angle in chi2) < UNLIKELY
    return ReferenceNoise(factor, sigma, p, axis, settings.sample_event, of_gyro, _test_white_normal(differences, wider, axes))


def _compare_spacings(differences: Differences, wider: Differences, axis: int) -> tuple[float, float]:
    """Compute the χ² with one degree of freedom that the excess is white errors of the references, and of the angle turned.

    An excess of either that explains the mean square of one spacing predicts that of the other. The logarithm of a mean square
    of n differences has the variance 2 (1 + 2 Σρ²)/n. With few differences both fit.
    """
    squares, stated, walks, counts = [], [], [], []
    for spaced in (differences, wider):
        values = spaced.values[:, axis]
        if values.size < FEWEST:
            return 0.0, 0.0
        is_inlier = np.abs(values) < TRIM * np.median(np.abs(values)) / NORMAL
        squares.append(float(np.mean(values[is_inlier] ** 2)) / TRIMMED)
        stated.append(float(np.mean(spaced.stated[:, axis])))
        walks.append(float(np.mean(spaced.walk[:, axis])))
        counts.append(values.size)
    of_references = walks[1] + max(squares[0] - walks[0], 0.0) * stated[1] / stated[0]
    of_angle = stated[1] + max(squares[0] - stated[0], 0.0) * walks[1] / walks[0]
    square_errors = np.log(squares[1] / np.array([of_references, of_angle])) ** 2
    first, second = square_errors / (2 * CORRELATED * float(np.sum(1 / np.array(counts))))
    return float(first), float(second)


def _test_white_normal(differences: Differences, wider: Differences, axes: Indices) -> float:
    """Compute the p-value of white and normal reference errors from the ratio of both spacings and the share of outliers.

    Every third difference is counted, since these share no reference. A robust sigma has the relative error 1.17/√n.
    """
    spacing_p = float(scipy.special.chdtrc(axes.size, sum(_compare_spacings(differences, wider, axis)[0] for axis in axes)))
    sigma = np.median(np.abs(differences.values), axis=0) / NORMAL
    limit = TRIM * (1 - ROBUST_ERROR / np.sqrt(len(differences.values)))  # sigmas
    is_outlier = np.abs(differences.values[::3, axes]) > limit * sigma[axes]
    expected_share = 2 * scipy.special.ndtr(-limit)
    count = is_outlier.sum()
    outlier_p = float(scipy.special.bdtrc(count - 1, is_outlier.size, expected_share)) if count else 1.0
    return min(1.0, 2 * min(spacing_p, outlier_p))


def _find_differences(series: ReferenceSeries, density: Array, motion: Array | None, spacing: int) -> Differences:
    """Compute the second differences of references `spacing` apart, without the part that follows a motion."""
    differences = _compute_second_differences(series, density, spacing)
    if motion is None:
        return differences
    errors = [replace(series, residuals=error) for error in np.moveaxis(motion, 2, 0)]
    return _remove_motion_errors(differences, [_compute_second_differences(single, density, spacing) for single in errors])


def _compute_second_differences(series: ReferenceSeries, density: Array, spacing: int) -> Differences:
    """Compute second differences of references `spacing` apart, evenly spaced in one interval without a gap."""
    t_s, owner = series.t_s, series.interval
    before_s, after_s = t_s[spacing:-spacing] - t_s[: -2 * spacing], t_s[2 * spacing :] - t_s[spacing:-spacing]
    spacings_s = [np.diff(t_s[owner == k]) for k in range(owner.max(initial=-1) + 1)]
    median_s = np.array([np.median(spacing_s) if spacing_s.size else np.inf for spacing_s in spacings_s])
    is_gapless = before_s <= 2.5 * spacing * median_s[owner[spacing:-spacing]]
    is_even = (owner[2 * spacing :] == owner[: -2 * spacing]) & (np.abs(before_s - after_s) <= 0.01 * before_s) & is_gapless
    k = spacing + np.flatnonzero(is_even)
    # ζ of neighbours differ by the references' errors; A rotates them to the body axes of the middle one.
    zeta = series.residuals
    A = series.to_inertial[k].transpose(0, 2, 1)
    # The body turns between references; where it turns far, axes mix and σ differs between them.
    turned = series.to_inertial if series.error_axes is None else series.to_inertial @ series.error_axes
    stated = sum(
        weight * np.einsum("mij,mj->mi", (A @ turned[k + shift]) ** 2, series.sigma[k + shift] ** 2)
        for weight, shift in ((1, -spacing), (4, 0), (1, spacing))
    )
    return Differences(
        values=np.einsum("mij,mj->mi", A, zeta[k + spacing] - 2 * zeta[k] + zeta[k - spacing]),
        stated=np.asarray(stated),
        walk=2 * density * before_s[k - spacing, None],
    )


def _remove_motion_errors(differences: Differences, motion: list[Differences]) -> Differences:
    """Subtract the fit of some errors' differences; the residuals are scaled up for the fitted degrees of freedom."""
    scale = np.sqrt(differences.stated + differences.walk)
    z = differences.values / scale
    X = np.stack([error.values / scale for error in motion], axis=-1)
    X = X / np.maximum(np.linalg.norm(X, axis=(0, 1)), 1e-300)
    residuals = z
    for _ in range(ROUNDS):
        is_inlier = np.abs(residuals) < TRIM * np.median(np.abs(residuals), axis=0) / NORMAL
        if is_inlier.sum() < OF_EACH * len(motion):
            return differences
        amplitudes, _, rank, _ = np.linalg.lstsq(X[is_inlier], z[is_inlier], rcond=1e-9)
        residuals = z - X @ amplitudes
    return replace(differences, values=residuals * scale * np.sqrt(is_inlier.sum() / (is_inlier.sum() - rank)))


def _estimate_factors(differences: Differences, is_inlier: Mask) -> tuple[Array, Array, float, int | None]:
    """Estimate actual over stated noise and its sigma, (3,) each, the p-value of all being one, and the axis that departs
    alone.

    One axis departs alone if the others are as stated, or fit that better than one common factor of all three.
    """
    sums = np.sum(np.where(is_inlier, differences.values**2, 0.0), axis=0) / TRIMMED
    stated = np.sum(np.where(is_inlier, differences.stated, 0.0), axis=0)
    walk = np.sum(np.where(is_inlier, differences.walk, 0.0), axis=0)
    relative = np.sqrt(2 * CORRELATED * TRIMMING / len(differences.values))
    # The gyros' noise may hide a small factor: no factor is stated below its own error.
    least = np.clip(relative * sums / stated, FAINTEST**2, LEAST**2)
    factor = np.sqrt(np.maximum((sums - walk) / stated, least))
    error = 0.5 * relative * (sums / stated) / factor
    # A sum of squares has a long upper tail; its cube root is normal (Wilson & Hilferty, 1931).
    spread = relative**2 / 9
    z = (np.cbrt(sums / (stated + walk)) - (1 - spread)) / np.sqrt(spread)
    chi2 = float(np.sum(z**2))
    outlying = int(np.argmax(np.abs(z)))
    other_chi2 = float(chi2 - z[outlying] ** 2)
    log, weight = np.log(factor), (factor / error) ** 2
    common_chi2 = float(np.sum(weight * (log - np.average(log, weights=weight)) ** 2))
    as_stated = scipy.special.chdtrc(2, other_chi2) > 0.01 or other_chi2 < common_chi2
    alone = as_stated and z[outlying] ** 2 > 12
    return factor, error, max(float(scipy.special.chdtrc(3, chi2)), 1e-300), outlying if alone else None
