"""Degrees of freedom of a noise level that was estimated from the recording itself.

A recording may state noise levels that an import estimated (`sigma_estimated`, `arw_estimated`). With an independent variance
estimate of ν degrees of freedom, σ̂² ~ σ² χ²(ν)/ν, the ratio χ²/dof has the distribution F(dof, ν).

A recording states the degrees of freedom of both levels, ν_σ and ν_g (`sigma_degrees`, `arw_degrees`). A level that is an
upper bound has none, and makes a χ² smaller only.

Turns in a row share references. With the variance g = ARW² · spacing of the gyro in a turn, and q = g/σ², their spectrum at the
frequency f is proportional to q + 2 − 2 cos 2πf. The gyro's part in it has the mean share a = √(q/(q + 4)). To first order a
relative error of ĝ changes χ²/dof by a times as much, one of σ̂² by 1 − a times. σ̂² comes from turns of the same recording, and
an efficient estimate of their variance has with any other unbiased one the covariance that is its own variance (Hausman,
Econometrica 46, 1978). Turns that are all in χ², whose variance is 2/dof, add 2/ν_σ − 4/dof to it. Where χ² has less turns than
σ̂² it has no more than its own variance. Hence 1/ν = (1 − a)² max(1/ν_σ − 2/dof, 0) + a²/ν_g (Welch and Satterthwaite).
"""

from __future__ import annotations

import numpy as np
import scipy.special

from gyrocal.recording import Recording, find_reference_rows


def count_noise_degrees(recording: Recording, dof: float) -> float:
    """Count the degrees of freedom of the stated noise beside a χ² of its references; infinite if it is no estimate."""
    gyro, attitudes = recording.gyro, recording.attitudes
    spacings = [np.diff(attitudes.t_s[find_reference_rows(attitudes.t_s, interval)]) for interval in recording.intervals]
    if dof <= 0 or not any(part.size for part in spacings):
        return float("inf")
    q = gyro.arw**2 * float(np.median(np.concatenate(spacings))) / float(np.mean(np.square(attitudes.sigma)))
    gyro_share = np.sqrt(q / (q + 4))
    inverse = gyro_share**2 / gyro.arw_degrees if gyro.arw_estimated and gyro.arw_degrees > 0 else 0.0
    if attitudes.sigma_estimated and attitudes.sigma_degrees > 0:
        inverse += (1 - gyro_share) ** 2 * max(1 / attitudes.sigma_degrees - 2 / dof, 0.0)
    return float(1 / inverse) if inverse > 0 else float("inf")


def compute_chi2_p(chi2: float, dof: float, noise_degrees: float) -> float:
    """Compute the probability of a larger χ² under noise of the stated level, which may be an estimate."""
    if np.isinf(noise_degrees):
        return float(scipy.special.chdtrc(dof, chi2))
    return float(scipy.special.fdtrc(dof, noise_degrees, chi2 / dof))


def compute_smaller_chi2_p(chi2: float, dof: float, noise_degrees: float) -> float:
    """Compute the probability of a smaller χ², exact in its tail."""
    if np.isinf(noise_degrees):
        return float(scipy.special.chdtr(dof, chi2))
    return float(scipy.special.fdtr(dof, noise_degrees, chi2 / dof))
