"""Mounting of the sun sensors: their boresights, and the mounting that a ground's alignment would read as R (3).

Boresights
    "The bore-sight orientations were chosen so as to maximize the time during which DSS data was available." Twice 96° of an
    orbit can be seen, unless the Earth hides it: below the local horizontal down to the dip acos(R/r), 18.6° at 350 km. A
    boresight in the body's XY plane wastes what lies below; raised toward zenith by half the field less the dip,

        48° − 18.6° = 29.4°,

    the lower edge of the field is the limb itself, and more would give up at the limb without gaining at the zenith, where
    the Sun is past the limb for as long. The tilt toward −Y hardly matters (`studies.robertson.geometry`) and stays a guess.
    The yaw update, with the Sun in the XY plane, is then at α = +29.4° (DSS-1) and −29.4° (DSS-2), and the β heads' angles
    act through tan α = ±0.56.
Mounting
    The ground's alignment, R (3), was solved without knowing of the β heads' angles. How the sensors were really mounted is not
    published. Two truths:

    "solved" : the mounting from which the ground's fit finds M = I for DSS-1 and R (3) for DSS-2. The fit is over a rotation of
               all sensors and M of DSS-2 (R's second algorithm, with penetration biases that leave roll and pitch free), of
               the Sun's path through both fields at the sun angles that December had before the first upload, 8 to 12°. It
               puts the zero of the heads' error there, and the error at the update grows with the sun angle's distance
               from them. The default.
    "heads"  : the sensors are mounted as designed, the heads' angles are all there is.
"""

from functools import lru_cache
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array
from simulator.sensors import sun as sun_sensor
from simulator.sensors.sun import TrueSunSensor
from simulator.truth.orbit import EARTH_RADIUS

Mounting = Literal["solved", "heads"]

ALTITUDE = 350e3  # m
DIP = float(np.arccos(EARTH_RADIUS / (EARTH_RADIUS + ALTITUDE)))  # rad, of the limb below the local horizontal
ELEVATION = DIP - sun_sensor.SIMULATED_HALF_FOV  # rad, toward +Z, nadir: raised toward zenith
BORESIGHTS = (float(sun_sensor.SIMULATED_BORESIGHT_TILT), float(ELEVATION))
R3_M = 1e-3 * np.array([[999.996, -1.98736, -1.99437], [1.9928, 999.994, 2.7292], [1.98893, -2.73316, 999.994]])
ALIGNED_AT = (8.0, 10.0, 12.0)  # deg, sun angles of the ground's alignment
PATH_STEP = 2.0  # deg of the Sun's path
MOUNTING_NEWTON_STEPS = 4  # steps; the first leaves 1e-5 of the angles


def build_mounted_sensors(
    mounting: Mounting = "solved", boresights: tuple[float, float] = BORESIGHTS
) -> tuple[TrueSunSensor, TrueSunSensor]:
    """Build TRMM's sun sensors with the flight's heads, at nominal tilt toward −Y and elevation toward nadir, rad."""
    turns = solve_turns(boresights) if mounting == "solved" else (np.eye(3), np.eye(3))
    return sun_sensor.build_trmm_sensors(boresights[0], turns, (sun_sensor.HEAD_DSS1, sun_sensor.HEAD_DSS2), boresights[1])


@lru_cache(maxsize=8)
def solve_turns(boresights: tuple[float, float]) -> tuple[Array, Array]:
    """Solve for M of both sensors as they sit, (3, 3) each, for which `fit_on_ground` finds no common rotation and R (3)."""
    U, _, V = np.linalg.svd(R3_M)
    target = np.concatenate([np.zeros(3), Rotation.from_matrix(U @ V).as_rotvec()])
    turns = np.zeros(6)
    for _ in range(MOUNTING_NEWTON_STEPS):
        tangents = fit_on_ground(turns, boresights)
        step = 1e-5
        J = np.stack([(fit_on_ground(turns + step * axis, boresights) - tangents) / step for axis in np.eye(6)], axis=1)
        turns = turns - np.linalg.solve(J, tangents - target)
    return _build_rotation(turns[:3]), _build_rotation(turns[3:])


def fit_on_ground(turns: Array, boresights: tuple[float, float]) -> Array:
    """Fit sensors with the flight's heads as if the heads were orthogonal.

    Of M of DSS-1 and DSS-2 as they sit, rotation vectors (6,), from data at some sun angles: the common rotation of the body
    and the rotation vector of DSS-2's M, (6,) rad.
    """
    sun = compute_sun_path(ALIGNED_AT)
    measurements, heads = [], (sun_sensor.HEAD_DSS1, sun_sensor.HEAD_DSS2)
    for N, turn, head in zip(sun_sensor.build_trmm_alignments(*boresights), turns.reshape(2, 3), heads, strict=True):
        s = sun @ (N @ _build_rotation(turn))
        head_tangents = [sun_sensor.compute_head_tangents(x, y, z, head) if z > 0.05 else (np.inf, np.inf) for x, y, z in s]
        tangents = np.array(head_tangents)
        view = (np.abs(tangents) <= np.tan(sun_sensor.SIMULATED_HALF_FOV)).all(axis=1)
        measurements.append((sun[view], N, np.arctan(tangents[view])))

    def compute_error(x: Array) -> Array:
        parts = []
        for (path, N, angles), turn in zip(measurements, (np.zeros(3), x[3:]), strict=True):
            s = path @ _build_rotation(x[:3]).T @ N @ _build_rotation(turn)
            parts.append(np.arctan2(s[:, :2], s[:, 2:]) - angles)
        return np.concatenate(parts).ravel()

    x = np.zeros(6)
    for _ in range(MOUNTING_NEWTON_STEPS):
        e, step = compute_error(x), 1e-6
        J = np.stack([(compute_error(x + step * axis) - e) / step for axis in np.eye(6)], axis=1)
        x = x - np.linalg.lstsq(J, e, rcond=None)[0]
    return x


def compute_sun_path(angles_deg: tuple[float, ...]) -> Array:
    """Compute the Sun's directions (n, 3) in the body, `PATH_STEP` of an orbit apart, outside eclipse, at some sun angles."""
    height = np.deg2rad(np.arange(0.0, 360.0, PATH_STEP))
    parts = []
    for angle in np.deg2rad(angles_deg):
        c = np.cos(angle)
        sun = np.stack([c * np.cos(height), np.full_like(height, -np.sin(angle)), -c * np.sin(height)], axis=-1)
        parts.append(sun[sun[:, 2] < np.sin(DIP)])
    return np.concatenate(parts)


def _build_rotation(vector: Array | list[float]) -> Array:
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())
