"""The gap as one number, before and after the effects are in the scenario, and how far it shrinks.

**Misfit.** m = χ²/dof of the calibration, whitened by the noise as stated. With the whitened residuals on the complement of
what the calibration takes up, r ~ N(μ, I) if only rates' and references' white noise are at work, E m = 1 + |μ|²/dof.

**Response.** An effect that is a function of the motion, and not of the noise, has a response that is known: what it adds to
rates and references in a noise-free flight of the scenario, with less without. A recording is measured *under a scenario*
with the response of its effects taken out at the sizes a that the scenario states, and then calibrated as any other. Whatever
is random (processes, noise, all that acts on noisy samples) cannot be taken out and stays, in the recording as in the
flights.

**Gap.** g_s = m_s(R) − E m_s(R'), where R' are flights of the scenario s, measured under it as the recording R is: zero on
average if the scenario is right. g_0 is that of M0 on the recording's own plan. The shrinkage is ρ = 1 − g_s/g_0.

**Sizes that were fitted to R itself.** Then the response that is taken out of R is nearest to R and not to the truth: with W
the whitened, projected columns of the k amplitudes, m_s(R) is lower by |W(â − a)|²/dof, k/dof on average. Every flight is
treated alike: its amplitudes a* are drawn from the posterior N(â, C), it is flown, its own amplitudes are fitted to it by
least squares, and *their* response is taken out. r is then on the complement of W too, and its distribution depends neither
on a nor on â (it is pivotal): percentiles of R among the flights are uniform if the scenario is right, and E m_s(R') = (dof −
k)/dof. What the sizes are off by is what a new recording would show; its expectation under the posterior, tr(W C Wᵀ)/dof, is
added to g_s, so that g_s is the gap that the scenario leaves *on a new recording*. That is AIC's correction, with the
posterior's covariance in place of the inverse of WᵀW. Where the sizes are from elsewhere, flights are drawn from the
posterior and measured at the stated sizes, as R is: a size that is uncertain makes the distribution wider, and no gap. The
size of random effects cannot be fitted to each flight in this way. Their flights are drawn from the posterior and statistics
that show the size stand nearer the middle than a uniform percentile would: conservative, as any posterior predictive check
(Bayarri and Berger, JASA 95 (2000) 1127).

**Interval.** The flights show how (m_0, m_s) scatter together about their expectations. e_0 = m_0 − (floor_0 + |W a*|²/dof),
with what the drawn amplitudes a* make of m_0 taken out, since it is the scatter of a recording about *its* truth that is
wanted; without columns the size's own uncertainty stays in. e_s = m_s − E m_s. With V the covariance of (e_0, e_s), times 1 +
1/n for n flights, and κ = g_s/g_0, the truth satisfies g_s − κ g_0 ~ N(0, V_ss − 2 κ V_0s + κ² V_00), so that the interval is
the κ with

    (g_s − κ g_0)² ≤ z² (V_ss − 2 κ V_0s + κ² V_00),    z = 1.645

(E. C. Fieller, J. R. Stat. Soc. B 16 (1954) 175). Where g_0 itself is not clear of zero it is unbounded: without a gap there
is nothing to shrink.
"""

from dataclasses import dataclass

import numpy as np

from gyrocal.arrays import Array

Z90 = 1.6448536269514722  # two-sided 90 %


@dataclass(frozen=True)
class Gap:
    """The gap before and after, in units of the mean square that stated noise gives."""

    before: float  # g_0, with its 90 % interval
    before_90: tuple[float, float]
    after: float  # g_s, with its interval
    after_90: tuple[float, float]
    shrinkage: float  # 1 − after/before
    shrinkage_90: tuple[float, float]  # its interval; infinite where there is no gap before


def compute_gap(recorded: tuple[float, float], floors: tuple[float, float], errors: Array, shift: float = 0.0) -> Gap:
    """Compute the gap of a recording.

    Parameters
    ----------
    recorded : its m_0 and m_s
    floors : E m_0 of flights of M0, E m_s of flights of the scenario
    errors : (n, 2) e_0 and e_s of the scenario's flights
    shift : expected increase of m_s from the errors of fitted sizes
    """
    before, after = recorded[0] - floors[0], recorded[1] - floors[1] + shift
    V = np.atleast_2d(np.cov(errors, rowvar=False)) * (1 + 1 / len(errors))
    half_width = Z90 * np.sqrt(np.diag(V))
    low, high = compute_fieller_interval(after, before, V[::-1, ::-1])
    return Gap(
        before=before,
        before_90=(float(before - half_width[0]), float(before + half_width[0])),
        after=after,
        after_90=(float(after - half_width[1]), float(after + half_width[1])),
        shrinkage=1 - after / before if before != 0 else float("nan"),
        shrinkage_90=(1 - high, 1 - low),
    )


def compute_fieller_interval(a: float, b: float, V: Array) -> tuple[float, float]:
    """Compute the interval of a/b for estimates (a, b) with covariance V (2, 2); infinite if b may be zero.

    The κ with (a − κ b)² ≤ z² (V_aa − 2 κ V_ab + κ² V_bb) are those between the roots of
    (b² − z² V_bb) κ² − 2 (a b − z² V_ab) κ + (a² − z² V_aa).
    """
    A = b**2 - Z90**2 * V[1, 1]
    B = a * b - Z90**2 * V[0, 1]
    C = a**2 - Z90**2 * V[0, 0]
    if not A > 0:
        return float("-inf"), float("inf")
    root = np.sqrt(max(B**2 - A * C, 0.0))
    return float((B - root) / A), float((B + root) / A)
