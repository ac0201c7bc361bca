"""The frame that Mission Mode is commanded to: z to geodetic nadir, x along the velocity or turned from it about nadir.

R's nadir is what the Earth sensor defines, the bisector of the CO₂ horizon, "approximately 0.01° from the geodetic frame". The
frame on board is the geodetic one, formed from the ephemeris:

    z = d, the inward normal of WGS 84 through the spacecraft;   y = d × v̂ / |d × v̂|;   x = y × z

and the commanded frame is that turned by the yaw κ about z. On the position r = (ρ cos λ, ρ sin λ, z) the normal has the
latitude φ with

    tan φ = (z/ρ) / (1 − e² N/(N + h)),    N = a/√(1 − e² sin²φ),    N + h = ρ/cos φ

which converges like (e²)^k from tan φ = z/ρ.

Against geocentric LVLH the frame leans by 2 f cos i sin i sin u in roll and f sin²i sin 2u in pitch, to first order in the
flattening f: 0.18° and 0.06° at 35° inclination. A roll that swings with the orbit turns into yaw as the orbit goes round, so
a yaw gyro compared with the rate of geocentric LVLH is wrong by n times that roll, 0.18° of yaw in a quarter of an orbit.
The rate on board is therefore that of the geodetic frame: the rotation from one control cycle's frame to the next one's.
"""

import math

import numpy as np

from gyrocal.arrays import Array
from gyrocal.jit_cache import compile_cached
from simulator.sensors.horizon import FLATTENING
from simulator.truth.orbit import EARTH_RADIUS, CircularOrbit

SQUARED_ECCENTRICITY = FLATTENING * (2 - FLATTENING)
LATITUDE_ITERATIONS = 3  # of the iteration for the latitude; leaves less than 1e-9 rad at any latitude from 350 km


@compile_cached
def compute_lvlh_axes(u: float, node: float, cos_i: float, sin_i: float, out: Array) -> None:
    """Write LVLH axes, see `simulator.truth.orbit`, to the rows of out (3, 3), at an argument of latitude and a node, rad."""
    cu, su, cn, sn = math.cos(u), math.sin(u), math.cos(node), math.sin(node)
    out[0, 0], out[0, 1], out[0, 2] = -su * cn - cu * cos_i * sn, -su * sn + cu * cos_i * cn, cu * sin_i
    out[1, 0], out[1, 1], out[1, 2] = -sin_i * sn, sin_i * cn, -cos_i
    out[2, 0], out[2, 1], out[2, 2] = -cu * cn + su * cos_i * sn, -cu * sn - su * cos_i * cn, -su * sin_i


@compile_cached
def compute_geodetic_axes(lvlh: Array, radius: float, out: Array) -> None:
    """Write the geodetic frame to the rows of out (3, 3), from LVLH axes (3, 3) and the distance from the Earth's centre, m."""
    x, y, z = -radius * lvlh[2, 0], -radius * lvlh[2, 1], -radius * lvlh[2, 2]
    rho = math.sqrt(x * x + y * y)
    slope = z / rho
    tangent = slope
    for _ in range(LATITUDE_ITERATIONS):
        square = tangent * tangent
        N = EARTH_RADIUS / math.sqrt(1.0 - SQUARED_ECCENTRICITY * square / (1.0 + square))
        tangent = slope / (1.0 - SQUARED_ECCENTRICITY * N / (rho * math.sqrt(1.0 + square)))
    cosine = 1.0 / math.sqrt(1.0 + tangent * tangent)
    d_x, d_y, d_z = -cosine * x / rho, -cosine * y / rho, -cosine * tangent
    v_x, v_y, v_z = lvlh[0, 0], lvlh[0, 1], lvlh[0, 2]
    y_x, y_y, y_z = d_y * v_z - d_z * v_y, d_z * v_x - d_x * v_z, d_x * v_y - d_y * v_x
    scale = 1.0 / math.sqrt(y_x * y_x + y_y * y_y + y_z * y_z)
    y_x, y_y, y_z = scale * y_x, scale * y_y, scale * y_z
    out[0, 0], out[0, 1], out[0, 2] = y_y * d_z - y_z * d_y, y_z * d_x - y_x * d_z, y_x * d_y - y_y * d_x
    out[1, 0], out[1, 1], out[1, 2] = y_x, y_y, y_z
    out[2, 0], out[2, 1], out[2, 2] = d_x, d_y, d_z


@compile_cached
def turn_about_z(frame: Array, yaw: float) -> None:
    """Turn the rows of a frame (3, 3) by a yaw about its own z, rad, in place."""
    cosine, sine = math.cos(yaw), math.sin(yaw)
    for j in range(3):
        x, y = frame[0, j], frame[1, j]
        frame[0, j], frame[1, j] = cosine * x + sine * y, cosine * y - sine * x


@compile_cached
def compute_rotation_between(before: Array, after: Array, out: Array) -> None:
    """Write the small vector φ with after = exp(−[φ×]) before, rad, to out (3,); relative error |φ|⁴/15.

    With M = after beforeᵀ, the vector ½ (M₂₃ − M₃₂, M₃₁ − M₁₃, M₁₂ − M₂₁) is φ sin|φ|/|φ|.
    """
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        total = 0.0
        for m in range(3):
            total += after[j, m] * before[k, m] - after[k, m] * before[j, m]
        out[i] = 0.5 * total
    # asin(s)/s = 1 + s²/6 + …
    scale = 1.0 + (out[0] * out[0] + out[1] * out[1] + out[2] * out[2]) / 6.0
    for i in range(3):
        out[i] *= scale


def compute_commanded_attitude(
    orbit: CircularOrbit, t: Array, yaw: Array | float = 0.0, node_error: float = 0.0, inclination_error: float = 0.0
) -> Array:
    """Compute the commanded frame, inertial to commanded, (n, 3, 3), at times (n,), s since the orbit's epoch.

    The yaw κ from the velocity, (n,) or one, and the errors of the ephemeris that the frame is formed of are in rad.
    """
    times = np.atleast_1d(np.asarray(t, dtype=float))
    yaws = np.broadcast_to(np.asarray(yaw, dtype=float), times.shape)
    out, lvlh = np.empty((len(times), 3, 3)), np.empty((3, 3))
    inclination = orbit.inclination + inclination_error
    cos_i, sin_i = math.cos(inclination), math.sin(inclination)
    for k, time in enumerate(times):
        u, node = orbit.latitude_argument + orbit.mean_motion * time, orbit.node + node_error + orbit.nodal_rate * time
        compute_lvlh_axes(u, node, cos_i, sin_i, lvlh)
        compute_geodetic_axes(lvlh, orbit.radius, out[k])
        turn_about_z(out[k], yaws[k])
    return out
