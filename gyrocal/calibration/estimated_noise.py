"""Degrees of freedom of a noise level that was estimated from the recording itself.

A recording may state noise levels that an import estimated (`sigma_estimated`, `arw_estimated`). With an independent variance
estimate of ν degrees of freedom, σ̂² ~ σ² χ²(ν)/ν, the ratio χ²/dof has the distribution F(dof, ν).

* Turns between references: with the variance g = ARW² · spacing of the gyro in a turn, and q = g/σ², a turn has the variance
  v = g + 2σ². A median absolute deviation of n turns about each of three axes has the efficiency 0.367 of the standard
  deviation (Huber, Robust Statistics, 1981, section 5.1), so that v̂ has ν_v = 3 · 0.367 n. Turns in a row have a correlation of
  −1/2 at most, and ν_v is then smaller by up to 1 + 2 · 0.106, from the bivariate normal distribution.
* Angle random walk: an overlapping Allan deviation over m samples in rests of the length T has
  ν_g = 1.5 T/τ · 4m²/(4m² + 5) for each axis (Riley, Handbook of Frequency Stability Analysis, NIST SP 1065, 2008, table 5).

Turns in a row share references. Their spectrum at the frequency f is proportional to q + 2 − 2 cos 2πf. The gyro's part in it
has the mean share a = √(q/(q + 4)). To first order a relative error of ĝ changes χ²/dof by a times as much, one of σ̂² by 1 − a
times. An import estimates σ̂² = (v̂ − ĝ)/2. The weight of v̂ is therefore w = (1 − a)(1 + q/2), from 0.83 to 1, and that of ĝ is
1 − w. If σ is stated, that of ĝ is a. The turns are those of χ², and χ²/dof is the efficient estimate of their variance. Its
covariance with any other unbiased estimate is therefore its variance 2/dof (Hausman, Econometrica 46, 1978). Hence
1/ν = w²/ν_v − 2w/dof + (1 − w)²/ν_g (Welch and Satterthwaite), or a²/ν_g if σ is stated. A stated level has an infinite ν.
"""

from __future__ import annotations

import numpy as np
import scipy.special

from gyrocal.recording import Recording, find_reference_rows

MAD_EFFICIENCY = 0.367
MOST_REFERENCE_PAIRS = 600  # turns that an import takes the sigma of references from
NEIGHBOUR_VARIANCE = 1.2  # of a median absolute deviation of turns in a row over that of turns apart
ALLAN_S = 0.1  # averaging time at which an import reads the angle random walk, s


def count_noise_degrees(recording: Recording, dof: float) -> float:
    """Degrees of freedom of the stated noise beside a χ² of its references; infinite if nothing of it was estimated."""
    gyro, attitudes = recording.gyro, recording.attitudes
    rows = [find_reference_rows(attitudes.t_s, interval) for interval in recording.intervals]
    pairs = sum(max(part.size - 1, 0) for part in rows)
    if not (gyro.arw_estimated or attitudes.sigma_estimated) or not pairs or dof <= 0:
        return float("inf")
    spacing_s = float(np.median(np.concatenate([np.diff(attitudes.t_s[part]) for part in rows])))
    q = gyro.arw**2 * spacing_s / float(np.mean(np.square(attitudes.sigma)))
    gyro_weight, inverse = np.sqrt(q / (q + 4)), 0.0
    if attitudes.sigma_estimated:
        step = -(-pairs // MOST_REFERENCE_PAIRS)
        degrees = 3 * MAD_EFFICIENCY * (pairs / step if step > 1 else pairs / NEIGHBOUR_VARIANCE)
        weight = (1 - gyro_weight) * (1 + q / 2)
        gyro_weight, inverse = 1 - weight, weight**2 / degrees - 2 * weight / dof
    if gyro.arw_estimated:
        m = max(round(ALLAN_S / gyro.sample_s), 1)
        degrees = 1.5 * _measure_rests(recording) / (m * gyro.sample_s) * 4 * m**2 / (4 * m**2 + 5)
        inverse += gyro_weight**2 / (3 * degrees)
    return float(1 / inverse) if inverse > 0 else float("inf")


def _measure_rests(recording: Recording) -> float:
    """Length of the rests, s; that of all samples without rests, since then the whole motion gives the noise."""
    from gyrocal.importing.motion import compute_speed, find_rests  # late: only for a recording that an import made

    gyro, attitudes = recording.gyro, recording.attitudes
    speed = compute_speed(attitudes.t_s, attitudes.quaternions, gyro.t_s)
    rests = find_rests(gyro.rates @ gyro.apriori_G.T, gyro.sample_s, speed)
    return gyro.sample_s * (sum(stop - first for first, stop in rests) or gyro.t_s.size)


def compute_chi2_p(chi2: float, dof: float, noise_degrees: float) -> float:
    """Probability of a larger χ² under noise of the stated level, which may be an estimate."""
    if np.isinf(noise_degrees):
        return float(scipy.special.chdtrc(dof, chi2))
    return float(scipy.special.fdtrc(dof, noise_degrees, chi2 / dof))


def compute_smaller_chi2_p(chi2: float, dof: float, noise_degrees: float) -> float:
    """Probability of a smaller χ², exact in its tail."""
    if np.isinf(noise_degrees):
        return float(scipy.special.chdtr(dof, chi2))
    return float(scipy.special.fdtr(dof, noise_degrees, chi2 / dof))
