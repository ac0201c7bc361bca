"""The frame a pointing mode follows, with z to geocentric or to geodetic nadir; in closed form with its rate.

LVLH (see `simulator.truth.orbit`) has z to the Earth's centre. TRMM points z along the inward normal d of the ellipsoid (N
section V), and x as near to the velocity as that allows: y along d × v̂. On latitude λ and distance r the normal leans by
δ = φ − λ towards the equator, φ being the geodetic latitude,

    r cos λ tan φ − e² a sin φ / W − r sin λ = 0,    W = √(1 − e² sin²φ),

so that in LVLH axes, north in the meridian being (cos u sin i, −cos i, 0)/cos λ,

    d = (−sin δ cos u sin i/cos λ,  sin δ cos i/cos λ,  cos δ),    sin λ = sin i sin u.

The frame is LVLH turned by α about x, then by β about y, with

    tan α = −d_y/d_z,    sin β = d_x,

and its rate follows from α' and β'. At 35° and 350 km it leans by up to 0.18° in roll and 0.06° in pitch, and rolls by up to
0.0002 deg/s, which the geocentric frame does not.
"""

import numpy as np

from gyrocal.arrays import Array
from simulator.truth.orbit import EARTH_RADIUS, CircularOrbit, compute_lvlh_attitude, compute_lvlh_rate
from simulator.truth.rotation import build_turn_matrix, turn_frame

FLATTENING = 1 / 298.257223563  # WGS 84
SQUARED_ECCENTRICITY = FLATTENING * (2 - FLATTENING)
NADIR_ITERATIONS = 8  # of the iteration for φ, each of which takes e² off the error
SMALLEST_COSINE = 1e-9  # of the latitude: over a pole north has no direction, and the normal no lean
ROLL, PITCH = np.eye(3)[0], np.eye(3)[1]


def compute_pointing_attitude(orbit: CircularOrbit, t: Array) -> Array:
    """Compute the attitude of the frame of the orbit's nadir, inertial to it; (n,) s since the epoch → (n, 3, 3)."""
    A = compute_lvlh_attitude(orbit, t)
    if not orbit.geodetic:
        return A
    alpha, beta, _, _ = compute_nadir_tilt(orbit, t)
    return np.asarray(build_turn_matrix(PITCH, beta) @ build_turn_matrix(ROLL, alpha) @ A)


def compute_pointing_rate(orbit: CircularOrbit, t: Array) -> Array:
    """Compute the inertial rate of that frame in its own axes, rad/s; (n,) s since the epoch → (n, 3)."""
    omega = compute_lvlh_rate(orbit, t)
    if not orbit.geodetic:
        return omega
    alpha, beta, alpha_rate, beta_rate = compute_nadir_tilt(orbit, t)
    omega = turn_frame(ROLL, alpha, omega) + alpha_rate[:, None] * ROLL
    return np.asarray(turn_frame(PITCH, beta, omega) + beta_rate[:, None] * PITCH)


def compute_nadir_tilt(orbit: CircularOrbit, t: Array) -> tuple[Array, Array, Array, Array]:
    """Compute α and β of geodetic nadir, rad, and their rates, rad/s; each (n,)."""
    u = orbit.latitude_argument + orbit.mean_motion * t
    cu, su = np.cos(u), np.sin(u)
    ci, si = np.cos(orbit.inclination), np.sin(orbit.inclination)
    sl = si * su
    cl = np.maximum(np.sqrt(1 - sl**2), SMALLEST_COSINE)
    latitude, latitude_rate = np.arctan2(sl, cl), orbit.mean_motion * si * cu / cl
    geodetic, slope = _compute_geodetic_latitude(latitude, orbit.radius)
    delta, delta_rate = geodetic - latitude, (slope - 1) * latitude_rate
    sd, cd = np.sin(delta), np.cos(delta)
    # sin δ/cos λ and its rate are in both horizontal components.
    lean = sd / cl
    lean_rate = cd * delta_rate / cl + sd * sl / cl**2 * latitude_rate
    d_x, d_y, d_z = -lean * cu * si, lean * ci, cd
    rate_x = -si * (lean_rate * cu - lean * su * orbit.mean_motion)
    rate_y, rate_z = lean_rate * ci, -sd * delta_rate
    height = np.hypot(d_y, d_z)
    alpha_rate = (d_y * rate_z - rate_y * d_z) / height**2
    return np.arctan2(-d_y, d_z), np.arctan2(d_x, height), alpha_rate, rate_x / height


def _compute_geodetic_latitude(latitude: Array, radius: float) -> tuple[Array, Array]:
    """Compute φ of a geocentric latitude at a distance from the Earth's centre, rad, and dφ/dλ."""
    sl, cl = np.sin(latitude), np.maximum(np.cos(latitude), SMALLEST_COSINE)
    phi = latitude
    for _ in range(NADIR_ITERATIONS):
        W = np.sqrt(1 - SQUARED_ECCENTRICITY * np.sin(phi) ** 2)
        phi = np.arctan2(radius * sl + SQUARED_ECCENTRICITY * EARTH_RADIUS * np.sin(phi) / W, radius * cl)
    W = np.sqrt(1 - SQUARED_ECCENTRICITY * np.sin(phi) ** 2)
    tangent = np.tan(phi)
    down = radius * cl * (1 + tangent**2) - SQUARED_ECCENTRICITY * EARTH_RADIUS * np.cos(phi) / W**3
    return phi, radius * (sl * tangent + cl) / down
