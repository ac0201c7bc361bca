"""The Earth's CO₂ horizon seen from orbit, and the three nadirs.

Tangent line of sight
    The horizon is an ellipsoid about the pole with semi-axes a, c: those of WGS 84 with the height of the CO₂ layer added to
    both, which departs from a surface of constant height by less than a metre. With D = diag(1/a, 1/a, 1/c) it is |D x| = 1,
    and a line r + λ d touches it where the quadratic (in λ) |D r + λ D d|² = 1 has a double root. With p = D r, q = D d and
    k = p·p − 1 that is the cone

        (p·q)² − k q·q = 0

    In the half plane through body +z at azimuth ζ about +z, from +x toward +y, d = z cos η + s sin η with the inertial
    vectors z = Aᵀ e_z, s = Aᵀ (e_x cos ζ + e_y sin ζ), so that with u = D z, w = D s

        α cos²η + 2 β sin η cos η + γ sin²η = 0
        α = (p·u)² − k u·u,    β = (p·u)(p·w) − k u·w,    γ = (p·w)² − k w·w

    a quadratic in tan η. Of its roots, (−β ∓ √(β² − αγ))/γ, the limb at azimuth ζ is the upper sign; the other one is the limb
    behind, at ζ + 180°. As γ changes sign when η passes 90°,

        η = atan2(β + √(β² − αγ), −γ)

    which holds while the Earth's disk covers part of the scan plane within 90° of +z; without tangent β² < αγ. For a sphere
    and z to nadir β = 0 and η = asin(a/r).

Nadirs
    Geocentric: −r. Geodetic: the inward normal of WGS 84 through r. Its foot is x with r = x + λ ∇, x_i = r_i a_i²/(a_i² + λ),
    where λ is the root of Σ r_i² a_i²/(a_i² + λ)² = 1, a convex decreasing function, and the normal is r_i/(a_i² + λ).
    The third is the bisector of the horizon: where an Earth sensor of four quadrants, at the azimuths 45, 135, 225, 315 deg,
    shows neither roll nor pitch, Σ y_i sin ζ_i = Σ y_i cos ζ_i = 0 for the penetration angles y_i, the angles η_i beyond the
    nominal one. To first order in the flattening f it leans from geocentric nadir by f sin 2φ (R/r)(a/r) at latitude φ, where
    geodetic nadir leans by f sin 2φ (R/r), R being the equatorial radius: the bisector leans by 1 − a/r less, 5 % at 350 km.
"""

import math
from dataclasses import dataclass

import numpy as np

from gyrocal.arrays import Array
from gyrocal.jit_cache import compile_cached
from simulator.truth.orbit import EARTH_RADIUS, CircularOrbit, compute_lvlh_attitude

FLATTENING = 1 / 298.257223563  # WGS 84
POLAR_RADIUS = EARTH_RADIUS * (1 - FLATTENING)  # m
QUADRANTS = 4
AZIMUTHS = np.deg2rad([45.0, 135.0, 225.0, 315.0])
COSINES, SINES = np.sqrt(0.5) * np.array([1.0, -1.0, -1.0, 1.0]), np.sqrt(0.5) * np.array([1.0, 1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Horizon:
    """The ellipsoid whose limb an Earth sensor sees, and the altitude its zero is set for."""

    co2_height: float = 40e3  # height of the CO₂ layer's edge above WGS 84, m
    altitude: float = 350e3  # nominal altitude above the equatorial radius, m

    @property
    def semi_axes(self) -> tuple[float, float]:
        """Equatorial and polar semi-axis a, c, m."""
        return EARTH_RADIUS + self.co2_height, POLAR_RADIUS + self.co2_height

    @property
    def nominal(self) -> float:
        """Nominal angle of the horizon from nadir, rad: asin(a/r) of a sphere of radius a at the nominal altitude."""
        return math.asin((EARTH_RADIUS + self.co2_height) / (EARTH_RADIUS + self.altitude))


@compile_cached
def compute_limb_angle(A: Array, position: Array, cos_azimuth: float, sin_azimuth: float, a: float, c: float) -> float:
    """Compute the angle η from body +z, rad, at which the line of sight at an azimuth ζ, from +x to +y, touches the horizon.

    A (3, 3) is inertial to body, position (3,) inertial, m, and a, c the equatorial and polar semi-axis, m. NaN if no line of
    the scan plane touches the horizon.
    """
    p0, p1, p2 = position[0] / a, position[1] / a, position[2] / c
    u0, u1, u2 = A[2, 0] / a, A[2, 1] / a, A[2, 2] / c
    w0 = (cos_azimuth * A[0, 0] + sin_azimuth * A[1, 0]) / a
    w1 = (cos_azimuth * A[0, 1] + sin_azimuth * A[1, 1]) / a
    w2 = (cos_azimuth * A[0, 2] + sin_azimuth * A[1, 2]) / c
    k = p0 * p0 + p1 * p1 + p2 * p2 - 1.0
    pu = p0 * u0 + p1 * u1 + p2 * u2
    pw = p0 * w0 + p1 * w1 + p2 * w2
    alpha = pu * pu - k * (u0 * u0 + u1 * u1 + u2 * u2)
    beta = pu * pw - k * (u0 * w0 + u1 * w1 + u2 * w2)
    gamma = pw * pw - k * (w0 * w0 + w1 * w1 + w2 * w2)
    discriminant = beta * beta - alpha * gamma
    if discriminant < 0.0:
        return np.nan
    return math.atan2(beta + math.sqrt(discriminant), -gamma)


@compile_cached
def compute_penetration(A: Array, position: Array, quadrant: int, a: float, c: float, nominal: float) -> float:
    """Compute the true penetration angle of a quadrant 0..3, rad; NaN where the scan plane misses the Earth.

    a, c, nominal are the semi-axes, m, and the nominal angle, rad, of a `Horizon`; the attitude and position are the true ones.
    """
    return compute_limb_angle(A, position, COSINES[quadrant], SINES[quadrant], a, c) - nominal


@compile_cached
def is_hidden(position: Array, direction: Array, a: float, c: float) -> bool:
    """Tell whether a line of sight from a position (3,), m, along a direction (3,) meets the ellipsoid of semi-axes a, c, m."""
    p0, p1, p2 = position[0] / a, position[1] / a, position[2] / c
    q0, q1, q2 = direction[0] / a, direction[1] / a, direction[2] / c
    pq = p0 * q0 + p1 * q1 + p2 * q2
    return pq < 0.0 and pq * pq > (q0 * q0 + q1 * q1 + q2 * q2) * (p0 * p0 + p1 * p1 + p2 * p2 - 1.0)


def compute_orbit_position(orbit: CircularOrbit, t: Array) -> Array:
    """Compute the inertial position at times t (n,), s since the orbit's epoch; (n, 3), m."""
    return np.asarray(-orbit.radius * compute_lvlh_attitude(orbit, t)[..., 2, :])
