"""The Earth's magnetic field as a tilted dipole.

Field
    The terms of degree one of the International Geomagnetic Reference Field for 1995.0, g₁⁰ = −29692 nT, g₁¹ = −1784 nT,
    h₁¹ = 5306 nT at the reference radius a = 6371.2 km. With d = (g₁¹, h₁¹, g₁⁰) in Earth-fixed axes the potential is
    V = a (a/r)² d·r̂, so that

        B = −∇V = (a/r)³ (3 (d·r̂) r̂ − d)

    The moment is 4π a³ |d| / μ₀ and the northern pole of the dipole's axis lies along −d. The higher degrees, up to a third of
    the field at 350 km over the South Atlantic, are left out: unloading of wheels needs a field of the right size and turning.
Rotation of the Earth
    Greenwich mean sidereal time, θ = 280.46061837° + 360.98564736629° (JD − 2451545.0), Meeus, Astronomical Algorithms, (12.4)
    without its terms in T².
"""

import math

import numpy as np

from gyrocal.arrays import Array
from gyrocal.jit_cache import compile_cached

DIPOLE = np.array([-1784e-9, 5306e-9, -29692e-9])  # d of IGRF 1995.0, T, Earth-fixed
REFERENCE_RADIUS = 6371.2e3  # m
J2000 = 2451545.0  # Julian date
EARTH_RATE = math.radians(360.98564736629) / 86400.0  # rad/s


def compute_sidereal_angle(julian_date: float) -> float:
    """Compute the right ascension of Greenwich, rad, at a Julian date (UT)."""
    return math.radians((280.46061837 + 360.98564736629 * (julian_date - J2000)) % 360.0)


@compile_cached
def compute_dipole_field(x: float, y: float, z: float, angle: float, dipole: Array) -> tuple[float, float, float]:
    """Compute the inertial field, T, of an Earth-fixed dipole (3,), T, at an inertial position, m; angle of Greenwich, rad."""
    cosine, sine = math.cos(angle), math.sin(angle)
    d_x, d_y, d_z = cosine * dipole[0] - sine * dipole[1], sine * dipole[0] + cosine * dipole[1], dipole[2]
    square = x * x + y * y + z * z
    strength = REFERENCE_RADIUS**3 / (square * math.sqrt(square))
    along = 3.0 * (d_x * x + d_y * y + d_z * z) / square
    return strength * (along * x - d_x), strength * (along * y - d_y), strength * (along * z - d_z)
