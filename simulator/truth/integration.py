"""Integration of the true attitude from an analytic body rate, by a sixth-order Magnus method.

A' = −[ω×]A has over a step of length h the solution A(t + h) = exp(−[σ×]) A(t). With ω₁, ω₂, ω₃ at the three Gauss points
½ − √15/10, ½, ½ + √15/10 of the step, let

    α₁ = h ω₂,    α₂ = (√15/3) h (ω₃ − ω₁),    α₃ = (10/3) h (ω₃ − 2ω₂ + ω₁)

be the rate's moments. Blanes, Casas, Oteo and Ros, "The Magnus expansion and some of its applications", Physics Reports
470 (2009), section 5.4, give the exponent for Y' = B Y; with B = −[ω×] every commutator [[a×], [b×]] = [(a × b)×] takes one
sign, so that

    σ = α₁ + α₃/12 + (1/240) (20α₁ + α₃ − c₁) × (α₂ + c₂)
    c₁ = −α₁ × α₂,    c₂ = (1/60) α₁ × (2α₃ + c₁)

α₁ + α₃/12 = h (5ω₁ + 8ω₂ + 5ω₃)/18 is Gauss–Legendre quadrature of the rate itself, exact for polynomials of degree five:
over a gyro sample it gives the mean rate that the sample shows.

The rate is smooth except at the knots of a maneuver (start of a ramp, end of a coast); a step must not span a knot, and the
caller's grid contains them. The rotations are accumulated as quaternions: as an active rotation q is Aᵀ, so
q(t + h) = q(t) ∘ q(σ).
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np

from gyrocal.arrays import Array
from gyrocal.jit_cache import compile_cached
from simulator.truth.rotation import compute_cross

Rate = Callable[[Array], Array]

NODES = np.array([0.5 - sqrt(15) / 10, 0.5, 0.5 + sqrt(15) / 10])


@dataclass(frozen=True)
class Trajectory:
    """An integrated attitude."""

    t: Array  # (n + 1,) the grid, s
    quaternions: Array  # (n + 1, 4) attitude at the grid points, inertial to body, scalar last
    angles: Array  # (n, 3) integral of the body rate over each step, rad


def integrate(rate: Rate, t: Array, start: Array, substeps: int = 1) -> Trajectory:
    """Integrate the attitude along a grid of times.

    Parameters
    ----------
    rate : body rate ω(t), (n,) s → (n, 3) rad/s, smooth between the grid points
    t : (n + 1,) strictly increasing grid, s
    start : (4,) attitude quaternion at t[0]
    substeps : Magnus steps in each step of the grid
    """
    step = np.repeat(np.diff(t) / substeps, substeps)
    begin = np.repeat(t[:-1], substeps) + step * np.tile(np.arange(substeps), t.size - 1)
    times = begin[:, None] + step[:, None] * NODES
    sigma, angles = compute_magnus_exponent(rate(times.ravel()).reshape(-1, 3, 3), step)
    quaternions = accumulate(np.asarray(start, dtype=float), sigma)
    return Trajectory(t, quaternions[::substeps], angles.reshape(-1, substeps, 3).sum(axis=1))


def compute_magnus_exponent(omega: Array, h: Array) -> tuple[Array, Array]:
    """Compute the Magnus exponent σ and the integral of the rate, both (n, 3) rad, of n steps.

    Parameters
    ----------
    omega : (n, 3, 3) rates at the three Gauss points of each step: [step, point, axis], rad/s
    h : (n,) step lengths, s
    """
    w1, w2, w3 = omega[:, 0], omega[:, 1], omega[:, 2]
    width = h[:, None]
    a1 = width * w2
    a2 = (sqrt(15) / 3) * width * (w3 - w1)
    a3 = (10 / 3) * width * (w3 - 2 * w2 + w1)
    c1 = -compute_cross(a1, a2)
    c2 = compute_cross(a1, 2 * a3 + c1) / 60
    angle = a1 + a3 / 12
    return angle + compute_cross(20 * a1 + a3 - c1, a2 + c2) / 240, angle


@compile_cached
def accumulate(start: Array, sigma: Array) -> Array:
    """Accumulate rotation vectors (n, 3), rad, from a start (4,): attitudes (n + 1, 4), A_k = exp(−[σ_k×]) A_{k−1}."""
    out = np.empty((sigma.shape[0] + 1, 4))
    x, y, z, w = start
    out[0] = start
    for k in range(sigma.shape[0]):
        sx, sy, sz = sigma[k]
        half = 0.5 * np.sqrt(sx * sx + sy * sy + sz * sz)
        scale = 0.5 * np.sin(half) / half if half > 0 else 0.5
        a, b, c, d = scale * sx, scale * sy, scale * sz, np.cos(half)
        x, y, z, w = (
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
            w * d - x * a - y * b - z * c,
        )
        scale = 1.0 / np.sqrt(x * x + y * y + z * z + w * w)
        x, y, z, w = x * scale, y * scale, z * scale, w * scale
        out[k + 1, 0], out[k + 1, 1], out[k + 1, 2], out[k + 1, 3] = x, y, z, w
    return out
