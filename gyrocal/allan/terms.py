"""The noise terms of IEEE Std 952, annex C, by their generalised covariance.

Every statistic of second differences of the angle θ follows from a function κ(t) with Cov[Σ a_i θ(t_i), Σ b_j θ(t_j)] =
Σ a_i b_j κ(t_i − t_j) for all weights that annihilate a constant and a trend. Then E z² = 6 κ(0) − 8 κ(τ) + 2 κ(2τ), the Allan
variance is that over 2τ², and covariances of Allan variances follow too (`gyrocal.allan.deviation`).

| term                   | spectrum of the rate, two-sided  | κ(t)                              | Allan variance       |
|------------------------|----------------------------------|-----------------------------------|----------------------|
| angle white noise Q    | Q² τ₀ (2πf)²                     | Q² where t = 0                    | 3 Q²/τ²              |
| angle random walk N    | N²                               | −N² |t|/2                         | N²/τ                 |
| bias instability B     | B²/(2π f)                        | B² t² ln|t|/(2π)                  | 2 ln 2 B²/π          |
| rate random walk K     | K²/(2πf)²                        | K² |t|³/12                        | K² τ/3               |
| rate ramp R            | none: a trend                    | none                              | R² τ²/2              |
| sinusoid Ω, f₀         | a line                           | none                              | Ω² sin⁴(πf₀τ)/(πf₀τ)² |

Q is the standard deviation of the angle's white noise: that of a readout, or q/√12 of counts of size q, which the standard
calls quantization noise. All but the ramp and the sinusoid are linear in the square of their coefficient.
"""

import numpy as np

from gyrocal.arrays import Array

ANGLE_WHITE, RANDOM_WALK, FLICKER, RATE_WALK, RAMP = TERMS = (
    "angle white noise",
    "angle random walk",
    "bias instability",
    "rate random walk",
    "rate ramp",
)


def compute_term_covariance(term: str, t_s: Array) -> Array:
    """Compute κ(t) of a random term per square of its coefficient, without angle white noise's part at t = 0; as t_s."""
    t = np.abs(np.asarray(t_s, dtype=float))
    if term == ANGLE_WHITE:
        return np.zeros_like(t)
    if term == RANDOM_WALK:
        return np.asarray(-0.5 * t)
    if term == FLICKER:
        return np.asarray(t**2 * np.log(np.where(t > 0, t, 1.0)) / (2 * np.pi))
    if term == RATE_WALK:
        return np.asarray(t * t * t / 12)
    raise ValueError(f"{term} is not random")


def compute_allan_variance(term: str, tau_s: Array) -> Array:
    """Compute the Allan variance of a term per square of its coefficient, as tau_s."""
    tau = np.asarray(tau_s, dtype=float)
    if term == ANGLE_WHITE:
        return np.asarray(3 / tau**2)
    if term == RANDOM_WALK:
        return np.asarray(1 / tau)
    if term == FLICKER:
        return np.full_like(tau, 2 * np.log(2) / np.pi)
    if term == RATE_WALK:
        return np.asarray(tau / 3)
    if term == RAMP:
        return np.asarray(tau**2 / 2)
    raise ValueError(f"{term} is no term")


def compute_sinusoid_variance(amplitude: float, frequency_hz: float, tau_s: Array) -> Array:
    """Compute the Allan variance of a sinusoid, as tau_s."""
    angle = np.pi * frequency_hz * np.asarray(tau_s, dtype=float)
    return np.asarray((amplitude * np.sin(angle) ** 2 / angle) ** 2)
