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

    With e₃ taken out by M afterwards what remains is of second order, below 0.001° for the published angles. Left in, it
    adds −e₃ to d, and −e₃ tan² β that (6) cannot follow. At α = 0 (boresight in the plane of the yaw update) nothing is
    left to compensate: c − 1 = −6e-6 and d = −4e-6 for DSS-2.

The published (c, d)
    `PUBLISHED` does not follow from `HEADS`. By (ii) d/(c − 1) = e₂/e₁ whatever α is: −0.18 (DSS-1) and +0.30 (DSS-2), but
    +1.81 and −2.30 are published, of the other sign in both and 8 to 10 times as large. Nor did a search find a rule, over
    5376 of them: the angles in any order and sign; e₃ left in, taken out, put into b₉, or taken out with an orthogonal M
    fitted over the field of view; seven ranges of β; DSS-2 in the same position or mirrored. With the best α, one for both
    sensors, the best rule misses by 46e-6; random numbers of the published size are met to 40e-6 in the median. With tan α
    a straight line in tan β the best misses by 9e-6, random numbers by 6e-6. The numbers are rounded to 0.5e-6. A factor
    of 10, as of a misprinted exponent, fares no better. What else R's calculation held is not in R; with more free
    numbers any four could be had.
    The published (c, d) move β by 0.005° (DSS-1) and 0.003° (DSS-2) at most, a tenth of the 0.06° by which R's yaw update fell
    when they went up. Head angles can matter that much: at tan α = 0.36, (ii) of DSS-2 is c = 1.0013, d = 0.00038, which
    moves β by 0.02° at the boresight and by 0.05° at 38°.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError

Array = NDArray[np.float64]

SCALED = [0, 1, 2, 5]  # b₁, b₂, b₃, b₆


@dataclass(frozen=True)
class Compensation:
    """(c, d) of R (6).

    Attributes
    ----------
    c, d : of R (6)
    """

    c: float
    d: float

    def coefficients(self, b: Array) -> Array:
        """b' (9,) of R (6) from b (9,) of R (5)."""
        if np.shape(b) != (9,):
            raise InputError(f"R (5) has nine coefficients, not {np.shape(b)}")
        out = np.array(b, dtype=float)
        out[SCALED] *= self.c
        out[0] += self.d
        return out

    def change(self, beta: Array) -> Array:
        """How far it moves angles β (n,) rad, atan(c tan β + d) − β."""
        return np.asarray(np.arctan(self.c * np.tan(beta) + self.d) - beta)


# R: alignment records of the β heads, 2-3-1 Euler angles in rad, and the (c, d) said to follow from them.
HEADS = {"DSS-1": np.deg2rad([0.044, -0.008, 0.067]), "DSS-2": np.deg2rad([0.206, 0.061, 0.182])}
PUBLISHED = {"DSS-1": Compensation(1.000047, 0.000085), "DSS-2": Compensation(0.999977, 0.000053)}


def seen_beta(alpha: Array, beta: Array, head: Array) -> Array:
    """β' that a turned head shows of the Sun at (α, β), (i); arrays that broadcast, rad.

    Parameters
    ----------
    head : (3,) 2-3-1 Euler angles of the β head, rad
    """
    return np.asarray(head[2] + np.arctan2(*_pq(np.tan(alpha), np.tan(beta), head)))


def _pq(a: Array, b: Array, head: Array) -> tuple[Array, Array]:
    (c1, c2), (s1, s2) = np.cos(head[:2]), np.sin(head[:2])
    return c2 * b - s2 * (a * c1 - s1), a * s1 + c1


def at_alpha(head: Array, alpha: float) -> Compensation:
    """(c, d) that are exact at one α, (ii), once e₃ is taken out of β'.

    Parameters
    ----------
    head : (3,) 2-3-1 Euler angles of the β head, rad
    alpha : rad, of the Sun at the yaw update
    """
    a, (c1, c2), (s1, s2) = np.tan(alpha), np.cos(head[:2]), np.sin(head[:2])
    return Compensation(float((c1 + a * s1) / c2), float(s2 / c2 * (a * c1 - s1)))


def least_squares(head: Array, alpha: Array, beta: Array, offset: float = 0.0, absorbed: float | None = None) -> Compensation:
    """(c, d) with the least square error of β over a set of Sun positions, such as those of the yaw updates.

    β is atan(c tan(β' − b₉) + d) + b₉ − absorbed; its error is taken to first order, cos² β times that of the tangent.

    Parameters
    ----------
    head : (3,) 2-3-1 Euler angles of the β head, rad
    alpha, beta : (n,) true angles of the Sun, rad
    offset : b₉ of R (5), rad
    absorbed : part of the head's angle that the sensor's misalignment takes out, a turn about x, rad; e₃ by default

    Raises
    ------
    InputError
        Fewer than two different β.
    """
    alpha, beta = np.broadcast_arrays(np.asarray(alpha, dtype=float), np.asarray(beta, dtype=float))
    if beta.ndim != 1 or beta.size < 2 or np.ptp(beta) < 1e-9:
        raise InputError("(c, d) need at least two different β")
    wanted = beta + (head[2] if absorbed is None else absorbed) - offset
    bracket, weight = np.tan(seen_beta(alpha, beta, head) - offset), np.cos(wanted) ** 2
    # Solved for (c − 1, d), which are small.
    H = np.column_stack([bracket, np.ones_like(bracket)]) * weight[:, None]
    change, d = np.linalg.lstsq(H, (np.tan(wanted) - bracket) * weight, rcond=None)[0]
    return Compensation(float(1 + change), float(d))
