"""Attitude determination of Mission Mode's on-board computer, R Figures 4 and 5.

The estimate is the error ε of the body against the commanded frame C, small angles about the body axes: A = exp(−[ε×]) C. While
the frame turns by φ_c and the gyro says the body turned by φ, in one control cycle,

    ε ← exp(−[φ_c×]) ε + φ − φ_c                                                                                    (1)

which for −n about y is the coupling of roll and yaw by the orbit's rate, ε_x' = n ε_z, ε_z' = −n ε_x. Roll and pitch are then
replaced by the Earth sensor's. Yaw is (1) alone, with the Earth sensor's roll in it, until the Sun crosses the body's XY
plane, expected from the ephemeris. There the sun sensor's vector, formed by R (5), (4) and (1), is compared with the expected
one in the commanded frame: a body turned by ε_z sees the Sun's azimuth smaller by ε_z, and roll and pitch do not matter where
the Sun is in the plane. The difference Δ of measured and propagated yaw is the yaw update, and

    b_z ← b_z + Δ / (t − t_last)                                                                                    (2)

is the bias with which the gyro would have shown the yaw change between the two measurements: R's "new gyro bias, based on
spacecraft attitude motion assumed to be equal to the difference between the two DSS yaw measurements". If the two sensors
differ by d, so that measurements are in error by ±d/2 in turn, the first update is ∓d, and by (2) the gyro is given a drift d
from one update to the next. The sign of d turns, the drift has the wrong sense, and from the second one on updates are ±2d.
"""

import math

from gyrocal.arrays import Array
from gyrocal.jit_cache import compile_cached


@compile_cached
def propagate_error(error: Array, gyro_turn: Array, frame_turn: Array) -> None:
    """Propagate ε (3,) in place by (1), to second order in the frame's turn, with φ by the gyro and φ_c, all in rad."""
    x, y, z = error[0], error[1], error[2]
    a, b, c = frame_turn[0], frame_turn[1], frame_turn[2]
    f_x, f_y, f_z = b * z - c * y, c * x - a * z, a * y - b * x
    error[0] = x - f_x + 0.5 * (b * f_z - c * f_y) + gyro_turn[0] - a
    error[1] = y - f_y + 0.5 * (c * f_x - a * f_z) + gyro_turn[1] - b
    error[2] = z - f_z + 0.5 * (a * f_y - b * f_x) + gyro_turn[2] - c


@compile_cached
def compute_head_angle(count: float, k: Array) -> float:
    """Compute the angle of a head's count by R (5) with coefficients k (9,), rad."""
    bracket = k[0] + k[1] * count + k[2] * math.sin(k[3] * count + k[4]) + k[5] * math.sin(k[6] * count + k[7])
    return math.atan(bracket) + k[8]


@compile_cached
def compute_sun_azimuth(n_alpha: float, n_beta: float, a: Array, b: Array, alignment: Array) -> float:
    """Compute the Sun's azimuth about body z, x toward y, rad, by R (5), (4) and (1); coefficients (9,), alignment N M.

    (4)'s normalisation does not change it and is left out.
    """
    tan_alpha, tan_beta = math.tan(compute_head_angle(n_alpha, a)), math.tan(compute_head_angle(n_beta, b))
    x = alignment[0, 0] * tan_alpha + alignment[0, 1] * tan_beta + alignment[0, 2]
    y = alignment[1, 0] * tan_alpha + alignment[1, 1] * tan_beta + alignment[1, 2]
    return math.atan2(y, x)


@compile_cached
def wrap_angle(angle: float) -> float:
    """Wrap an angle to −π ≤ angle < π, rad."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
