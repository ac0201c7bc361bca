"""Inputs, state and outputs of the compiled loop of Mission Mode; see `simulator.mission_mode.loop`."""

import math
from typing import NamedTuple

from gyrocal.arrays import Array, Mask
from gyrocal.jit_cache import compile_cached
from simulator.mission_mode.config import Spacecraft
from simulator.mission_mode.wheels import WHEELS
from simulator.sensors.earth import Constants

ROTATION_NAMES = ("roll", "pitch", "yaw")
# Columns of the tables in their units; the loop writes radians and seconds.
TELEMETRY = (
    "t_s",
    *(f"error_{axis}_deg" for axis in ROTATION_NAMES),
    *(f"estimate_{axis}_deg" for axis in ROTATION_NAMES),
    "bias_yaw_deg_h",
    *(f"wheel_{i}_nms" for i in range(1, WHEELS + 1)),
    "quadrants",
    "normal",
    *(f"raw_{axis}_deg_s" for axis in "xyz"),
    *(f"angle_{i}_deg" for i in range(1, 5)),
)
UPDATES = ("t_s", "sensor", "update_deg", "bias_deg_h", "bias_solved", "measured_deg", "error_yaw_deg")
ORBIT_COLUMNS = 24
"""Of an orbit's row: cycles in normal pointing, and not; by axis Σ error², Σ knowledge², max |error|, max |knowledge|, largest
peak to peak over 1 s, Σ (ω − G ω_raw); the wheels' momentum |W h| and a wheel's at their largest, the largest moment of a
torquer; cycles with three quadrants."""

NEVER = -1e300
SUN_STEP = 600.0  # s; the Sun is interpolated linearly between, in error by less than 1e-8 rad


class Plant(NamedTuple):
    """The spacecraft and its surroundings; SI, radians."""

    dt: float
    body: Spacecraft
    inverse: Array  # of the inertia
    axes: Array
    distribution: Array
    gradient: float
    latitude_argument: float
    mean_motion: float
    node: float
    nodal_rate: float
    cos_i: float
    sin_i: float
    on_board: Array  # (3,) node's error, cos and sin of the inclination of the ephemeris on board
    radius: float
    sidereal: float
    sun: Array  # a row each SUN_STEP


class Sensors(NamedTuple):
    """Sensors as they are."""

    inverse_G: Array
    gyro_sigma: float
    walk_sigma: Array  # (3,)
    magnetometer_sigma: float
    earth: Constants
    earth_gain: float
    horizon_keep: float  # share of the horizon's error that is left after a cycle
    horizon_sigma: float  # rad
    horizon_season: float  # rad, of the limb's height with the sine of its latitude
    season_phase: float  # rad, at the epoch
    alignments: Array
    heads: Array
    a: Array
    b: Array
    half_fov: Array
    noise: Array


class Tables(NamedTuple):
    """Tables on board: gyro G, penetration biases, N M and coefficients of the sun sensors, gains."""

    G: Array
    penetration_biases: Array
    alignments: Array
    a: Array
    b: Array
    inertia: Array
    proportional: Array
    derivative: Array
    integral: Array
    integral_limit: float
    bias_gain: float
    unloading: float


class Slew(NamedTuple):
    """Yaw command: constant before start, by angle more after start + duration, s and rad; duration 0 for none."""

    yaw: float
    angle: float
    start: float
    duration: float
    ramp: float


class State(NamedTuple):
    """State that a cycle changes."""

    q: Array  # (4,) inertial to body
    omega: Array  # (3,) rad/s
    wheels: Array  # (4,) N m s
    true_bias: Array  # (3,) rad/s
    body_turn: Array  # (3,) rotation of the body over the cycle before, rad
    frame: Array  # (3, 3) commanded, of the cycle before
    frame_turn: Array  # (3,) rotation of that frame in the cycle before that, rad
    estimate: Array  # (3,) ε, rad
    probe: Array  # (3,) ε propagated by gyro alone since the slew's start, rad
    integral: Array  # (3,) rad s
    bias: Array  # (3,) on board, rad/s
    s_filter: Array  # (4,)
    quadrants: Mask  # (4,)
    horizon: Array  # (4,) error of the horizon in each quadrant, rad
    past: Array  # (n, 3) true errors of the n cycles before, a second's worth, the latest first, rad
    memory: Array  # (4,) Sun's height over the XY plane; time of the last update; 1 from a slew to the next update; cycles


@compile_cached
def compute_yaw_command(t: float, slew: Slew) -> float:
    """Compute the commanded yaw, rad; the rate's ramps are smoothsteps, as in `simulator.truth.maneuvers.Slew`."""
    if slew.duration <= 0.0 or t <= slew.start:
        return slew.yaw
    s = (t - slew.start) / slew.duration
    if s >= 1.0:
        return slew.yaw + slew.angle
    r = slew.ramp
    rise, fall = min(s / r, 1.0), min(max((s - 1.0 + r) / r, 0.0), 1.0)
    coast = max(s - r, 0.0)
    turned_share = r * rise**3 * (1.0 - 0.5 * rise) + coast - r * fall**3 * (1.0 - 0.5 * fall)
    return slew.yaw + slew.angle * turned_share / (1.0 - r)


@compile_cached
def count_orbit(
    row: Array, error: Array, apparent: Array, normal: bool, three: bool, momentum: Array, largest: float, state: State
) -> None:
    """Add a cycle to an orbit's row."""
    row[20] = max(row[20], math.sqrt(momentum[0] ** 2 + momentum[1] ** 2 + momentum[2] ** 2))
    for i in range(WHEELS):
        row[21] = max(row[21], abs(state.wheels[i]))
    row[22] = max(row[22], largest)
    if not normal:
        row[1] += 1.0
        return
    row[0] += 1.0
    row[23] += 1.0 if three else 0.0
    for i in range(3):
        knowledge = state.estimate[i] - error[i]
        row[2 + i] += error[i] * error[i]
        row[5 + i] += knowledge * knowledge
        row[8 + i] = max(row[8 + i], abs(error[i]))
        row[11 + i] = max(row[11 + i], abs(knowledge))
        row[17 + i] += apparent[i]
        if state.memory[3] >= len(state.past):
            low, high = error[i], error[i]
            for k in range(len(state.past)):
                low, high = min(low, state.past[k, i]), max(high, state.past[k, i])
            row[14 + i] = max(row[14 + i], high - low)
