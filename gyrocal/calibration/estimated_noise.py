"""Degrees of freedom of a noise level that was estimated from the recording itself.

A recording may state noise levels that an import estimated (`sigma_estimated`, `arw_estimated`). With a variance estimate of ν
degrees of freedom, σ̂² ~ σ² χ²(ν)/ν, the ratio χ²/dof has the distribution F(dof, ν) if the two are independent. That holds
where the estimate rests on few of the differences in χ². Where they depend on one another the ratio scatters less.

* References: a median absolute deviation of n turns about each of three axes has the efficiency 0.367 of the standard deviation
  (Huber, Robust Statistics, 1981, section 5.1), so that ν = 3 · 0.367 n.
* Angle random walk: the Allan deviation at `ALLAN_S` of rests of the length T has at least T/`ALLAN_S` degrees of freedom for
  each axis.

With a the gyro's share of the variance of a turn between two references, χ²/dof is the sum of both ratios with the weights a
and 1 − a. Its relative variance is 2/ν with 1/ν = a²/ν_gyro + (1 − a)²/ν_references (Welch and Satterthwaite). A stated level
has an infinite ν.
"""

from __future__ import annotations

import numpy as np
import scipy.special

from gyrocal.recording import Recording, find_reference_rows

MAD_EFFICIENCY = 0.367
MOST_REFERENCE_PAIRS = 600  # turns that an import takes the sigma of references from
ALLAN_S = 0.1  # averaging time at which an import reads the angle random walk, s


def count_noise_degrees(recording: Recording) -> float:
    """Degrees of freedom of the noise that the recording states; infinite if nothing of it was estimated."""
    gyro, attitudes = recording.gyro, recording.attitudes
    if not (gyro.arw_estimated or attitudes.sigma_estimated) or not attitudes.t_s.size:
        return float("inf")
    rows = [find_reference_rows(attitudes.t_s, interval) for interval in recording.intervals]
    pairs = sum(max(part.size - 1, 0) for part in rows)
    used = len(range(0, pairs, max(-(-pairs // MOST_REFERENCE_PAIRS), 1)))
    spacing_s = float(np.median(np.concatenate([np.diff(attitudes.t_s[part]) for part in rows])))
    turn = gyro.arw**2 * spacing_s
    share = turn / (turn + 2 * float(np.mean(np.square(attitudes.sigma))))
    inverse = 0.0
    if attitudes.sigma_estimated:
        inverse += (1 - share) ** 2 / max(3 * MAD_EFFICIENCY * used, 1.0)
    if gyro.arw_estimated:
        inverse += share**2 / max(3 * _measure_rests(recording) / ALLAN_S, 1.0)
    return float(1 / inverse) if inverse else float("inf")


def _measure_rests(recording: Recording) -> float:
    """Length of the rests, s; that of all samples without rests, since then the whole motion gives the noise."""
    from gyrocal.importing.rests import compute_speed, find_rests  # late: only for a recording that an import made

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
