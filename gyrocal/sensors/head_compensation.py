"""Compensation of a sun sensor's head angles by new transfer-function coefficients, R (6).

Head geometry
    The β head is turned against the α head by a 2-3-1 Euler sequence (e₁, e₂, e₃). With a = tan α, b = tan β,
    p = cos e₂ b − sin e₂ (a cos e₁ − sin e₁) and q = a sin e₁ + cos e₁, it shows

        tan β' = (cos e₃ p + sin e₃ q) / (cos e₃ q − sin e₃ p),    hence    tan(β' − e₃) = p / q                     (i)

    so e₃ adds to β, whatever α. It is a turn of the sensor about its x axis, which the misalignment M of R (1) takes.
R (6)
    b₁' = c b₁ + d, b_i' = c b_i (i = 2, 3, 6) turns the bracket B = tan(β' − b₉) of R (5) into c B + d. b₉ stands outside; a
    small one changes (c, d) in second order only.
At one α
    (i) solved for b is linear in tan(β' − e₃), so (6) is exact for all β when e₃ is taken out first:

        tan β = c tan(β' − e₃) + d,    c = (cos e₁ + a sin e₁)/cos e₂,    d = tan e₂ (a cos e₁ − sin e₁)              (ii)
        c ≈ 1 + e₁ tan α,    d ≈ e₂ tan α

    With e₃ taken out by M afterwards what remains is of second order, below 0.001° for the published angles. At α = 0
    (boresight in the plane of the yaw update) nothing is left to compensate: c − 1 = −6e-6 and d = −4e-6 for DSS-2.

The published (c, d)
    `PUBLISHED_COMPENSATION` does not follow from `HEAD_ANGLES`. By (ii) d/(c − 1) = e₂/e₁ whatever α is: −0.18 (DSS-1) and
    +0.30 (DSS-2), but +1.81 and −2.30 are published, of the other sign in both and 8 to 10 times as large. They move β by
    0.005° (DSS-1) and 0.003° (DSS-2) at most, a tenth of the 0.06° by which R's yaw update fell when they went up. Head angles
    can matter that much: at tan α = 0.36, (ii) of DSS-2 is c = 1.0013, d = 0.00038, which moves β by 0.02° at the boresight and
    by 0.05° at 38°.
"""

from dataclasses import dataclass

import numpy as np

from gyrocal.arrays import Array


@dataclass(frozen=True)
class Compensation:
    """(c, d) of R (6)."""

    c: float
    d: float


# R: alignment records of the β heads, 2-3-1 Euler angles in rad, and the (c, d) said to follow from them.
HEAD_ANGLES = {"DSS-1": np.deg2rad([0.044, -0.008, 0.067]), "DSS-2": np.deg2rad([0.206, 0.061, 0.182])}
PUBLISHED_COMPENSATION = {"DSS-1": Compensation(1.000047, 0.000085), "DSS-2": Compensation(0.999977, 0.000053)}


def compute_compensation(head: Array, alpha: float) -> Compensation:
    """Compute the (c, d) that are exact at one α, (ii), once e₃ is taken out of β'.

    Parameters
    ----------
    head : (3,) 2-3-1 Euler angles of the β head, rad
    alpha : rad, of the Sun at the yaw update
    """
    a, (c1, c2), (s1, s2) = np.tan(alpha), np.cos(head[:2]), np.sin(head[:2])
    return Compensation(float((c1 + a * s1) / c2), float(s2 / c2 * (a * c1 - s1)))
