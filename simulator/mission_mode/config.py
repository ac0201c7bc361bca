"""Configuration of a Mission Mode run: the spacecraft as it is, its computer's tables, and the days on which they change.

Published by R: orbit, mass, four wheels in a pyramid, control at 2 Hz, the sensors' layout, R (3) with the penetration biases,
the heads' angles, (c, d) of R (6), R (9), the days of the uploads. Not published, and chosen here: inertia, wheels and
torquers, gains, disturbances, noises, the tilt of the sun sensors. What is published of the gyro before launch is in N Table 3.

How the sun sensors are mounted is in `simulator.mission_mode.mounting`.

Coefficients
    R (6) with the published (c, d) moves yaw by 0.005° (DSS-1) and 0.003° (DSS-2). What (6) is for, the least error of β where
    the Sun crosses the XY plane, is `fit_crossing_compensation`; it is found from the sensors as they are, better than the
    ground could, and so is a bound on what (6) can do. With the boresights raised it gives DSS-1 (1.00046, 0.000078), R's
    1.000047 and 0.000085 with a zero slipped in c. Uploads take the computed pair unless asked for the published one.
"""

from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from gyrocal.arrays import Array
from simulator.mission_mode.mounting import BORESIGHTS, R3_M, Mounting, build_mounted_sensors
from simulator.mission_mode.onboard_attitude import compute_head_angle
from simulator.mission_mode.wheels import EQUAL_ELEVATION
from simulator.sensors import sun as sun_sensor
from simulator.sensors.earth import Filter, TrueEarthSensor
from simulator.sensors.sun import TrueSunSensor
from simulator.truth.orbit import CircularOrbit

Forward = Literal["+x", "-x"]

MISSION_EPOCH = "1997-11-27T21:30:00+00:00"  # R: launched November 27, 1997; near the launch's hour
NODE_DEG = 46.0  # not published; chosen so that the Sun crosses the orbit plane on December 13, N's first yaw maneuver
DAY = 86400.0

R9_G = np.array([[1.000443, -1.013e-3, 6.75235e-4], [7.63599e-4, 1.00053, -2.1629e-3], [9.41394e-4, 1.6831e-3, 1.00088]])
R9_BIAS = np.deg2rad([-1.549155e-4, 1.978161e-4, 0.7820254e-4])
# N Table 3 before launch: misalignments -0.036, 0.006; 0.059, -0.033; 0.005, 0.030 deg.
PRELAUNCH_G = np.eye(3) + np.deg2rad([[0.0, -0.036, 0.006], [0.059, 0.0, -0.033], [0.005, 0.030, 0.0]])
PRELAUNCH_BIAS = np.deg2rad([-1.41e-4, 1.58e-4, 0.86e-4])
PENETRATION_BIASES = np.deg2rad([-0.1574, 0.04635, -0.09414, -0.05382])
INERTIA = np.array([[8500.0, 40.0, -120.0], [40.0, 6000.0, 60.0], [-120.0, 60.0, 9500.0]])  # kg m², not published
R6 = ((1.000047, 8.5e-5), (0.999977, 5.3e-5))  # (c, d) of DSS-1 and DSS-2


class Spacecraft(NamedTuple):
    """Body, wheels, torquers and what disturbs them; none of it published but the mass, 3523 kg."""

    inertia: Array = INERTIA  # (3, 3) kg m²
    elevation: float = EQUAL_ELEVATION  # of the wheels' pyramid, rad
    torque_limit: float = 0.3  # of a wheel, N m
    momentum_limit: float = 50.0  # of a wheel, N m s
    dipole_limit: float = 200.0  # of a torquer, A m²
    residual_dipole: Array = np.array([2.0, -3.0, 2.0])  # (3,) of the body, A m²
    drag: float = 0.01  # mean force of the air, against the velocity, N
    drag_swing: float = 0.4  # its day-night part; the force is drag (1 + swing × cosine of the Sun's zenith angle)
    pressure_arm: Array = np.array([0.1, 0.05, 0.2])  # (3,) from the centre of mass to that of pressure, m


@dataclass(frozen=True)
class TrueGyro:
    """The gyro as it is: ω_raw = G⁻¹ (ω − b) + noise, R (7)."""

    G: Array = field(default_factory=lambda: R9_G)  # (3, 3)
    bias: Array = field(default_factory=lambda: R9_BIAS)  # (3,) b at the start, rad/s
    arw: float = float(np.deg2rad(2.6e-4))  # angle random walk, rad/√s
    rrw: float | Array = 0.0  # random walk of b, rad/s/√s, one for all axes or (3,)


@dataclass(frozen=True)
class OnBoardTables:
    """Tables that the ground uploads."""

    G: Array = field(default_factory=lambda: PRELAUNCH_G)  # (3, 3) of the gyro
    # (3,) of the gyro, rad/s; that of yaw is solved for on board from there on. None leaves the present one.
    bias: Array | None = field(default_factory=lambda: PRELAUNCH_BIAS)
    # (2, 3, 3) M of DSS-1 and DSS-2, R (1)
    misalignments: Array = field(default_factory=lambda: np.stack([np.eye(3), np.eye(3)]))
    # (2, 9) of R (5)
    coefficients_alpha: Array = field(
        default_factory=lambda: np.stack([sun_sensor.SIMULATED_ALPHA_COEFFICIENTS, sun_sensor.SIMULATED_ALPHA_COEFFICIENTS])
    )
    coefficients_beta: Array = field(
        default_factory=lambda: np.stack([sun_sensor.SIMULATED_BETA_COEFFICIENTS, sun_sensor.SIMULATED_BETA_COEFFICIENTS])
    )
    penetration_biases: Array = field(default_factory=lambda: np.zeros(4))  # (4,) rad
    s_filter: Filter = "restarted"  # of the Earth sensor


@dataclass(frozen=True)
class Controller:
    """The control law at 2 Hz, about each axis; gains are not published."""

    cycle_s: float = 0.5  # length of a control cycle, s
    # natural frequency ω of each axis, (3,) rad/s: gains I ω², 2 ζ I ω
    bandwidth: Array = field(default_factory=lambda: np.full(3, 0.05))
    damping: float = 0.8  # ζ
    integral_s: float = 300.0  # time constant of the integral part, s: gain I ω² / integral_s
    integral_limit: float = 1.0  # largest integral of an error, rad s
    bias_gain: float = 1.0  # share of the yaw bias by a yaw update that is applied; 1 as R words it
    # (3,) what the gains and the feed-forward are formed with, kg m²
    inertia: Array = field(default_factory=lambda: np.array([8500.0, 6000.0, 9500.0]))
    unloading: float = 2e-3  # k of the cross-product law, 1/s


@dataclass(frozen=True)
class YawManeuver:
    """A turn by 180° about nadir."""

    start_s: float  # s since the epoch
    duration_s: float = 1000.0  # s
    # share of the duration that each ramp of the rate takes; the profile is that of `maneuvers.Slew`
    ramp_fraction: float = 0.2


@dataclass(frozen=True)
class HorizonError:
    """Errors of the Earth sensor's angles by the radiance of the CO₂ horizon."""

    sigma: float = 0.0  # of a first-order Markov process in each quadrant, rad
    time_constant_s: float = 250.0
    # how much lower the limb stands per sine of its latitude on January 15, rad; with a cosine through the year. The winter
    # hemisphere's stratosphere is colder and its horizon lower
    season: float = 0.0


@dataclass(frozen=True)
class EphemerisError:
    """On-board ephemeris less truth, in node and inclination, rad: R (δi sin u − δΩ sin i cos u) across the track."""

    node: float = 0.0
    inclination: float = 0.0


@dataclass(frozen=True)
class MissionConfig:
    """A run."""

    epoch: str = MISSION_EPOCH  # ISO 8601, UTC
    # with node and argument of latitude at the epoch
    orbit: CircularOrbit = field(
        default_factory=lambda: CircularOrbit(350e3, float(np.deg2rad(35.0)), float(np.deg2rad(NODE_DEG)), j2=True)
    )
    # as they are; the Earth sensor's filter is that of the tables
    spacecraft: Spacecraft = field(default_factory=Spacecraft)
    gyro: TrueGyro = field(default_factory=TrueGyro)
    sun_sensors: tuple[TrueSunSensor, TrueSunSensor] = field(default_factory=lambda: build_mounted_sensors())
    earth_sensor: TrueEarthSensor = field(default_factory=lambda: TrueEarthSensor(biases=PENETRATION_BIASES))
    # tilt and elevation of the sun sensors' nominal boresights that the computer holds, rad
    boresights: tuple[float, float] = BORESIGHTS
    mounting: Mounting = "solved"  # how the sun sensors sit, which the axes of the alignment's upload go with
    printed_coefficients: bool = False  # whether the second upload has (c, d) of R (6) as printed, or as computed
    # whether the S filter is turned off with the first upload, or with the second; R does not date it
    filter_off_first: bool = True
    # errors that the nominal spacecraft does not have
    horizon: HorizonError = field(default_factory=HorizonError)
    ephemeris: EphemerisError = field(default_factory=EphemerisError)
    magnetometer_sigma: float = 3e-7  # 1-sigma of an axis, T
    controller: Controller = field(default_factory=Controller)  # the control law
    tables: OnBoardTables = field(default_factory=OnBoardTables)  # on board at the start
    uploads: tuple[tuple[float, OnBoardTables], ...] = ()  # (s since the epoch, tables), ascending
    forward: Forward = "-x"  # the body axis along the velocity at the start, "+x" or "-x"
    maneuvers: tuple[YawManeuver, ...] = ()  # yaw maneuvers, ascending, each of which swaps it


def apply_compensation(coefficients: Array, c: float, d: float) -> Array:
    """Apply R (6): b₁ → c b₁ + d, and b₂, b₃, b₆ times c, of b (9,)."""
    out = np.array(coefficients, dtype=float)
    out[[0, 1, 2, 5]] *= c
    out[0] += d
    return out


CROSSING_ANGLES_DEG = (0.0, 58.4)  # of the Sun from the XZ plane, at the yaw updates of a year


def fit_crossing_compensation(
    sensor: TrueSunSensor,
    on_board: Array,
    nominal: Array,
    coefficients: Array = sun_sensor.SIMULATED_BETA_COEFFICIENTS,
) -> tuple[float, float]:
    """Fit (c, d) of R (6) for the least error of β at the yaw update.

    Least squares over the bracket of R (5) with the Sun in the body's XY plane, and α read as it is, of a sensor as it is, M
    (3, 3) on board, N (3, 3), and b (9,) on board before.
    """
    side = np.sign(nominal[0, 2])
    angle = np.deg2rad(np.linspace(*CROSSING_ANGLES_DEG, 50))
    body = np.stack([side * np.cos(angle), -np.sin(angle), np.zeros_like(angle)], axis=-1)
    tangents = [sun_sensor.compute_head_tangents(x, y, z, sensor.head) for x, y, z in body @ sensor.alignment]
    counts = [
        sun_sensor.compute_counts(*direction, sensor.coefficients_alpha, sensor.coefficients_beta)[1] for direction in tangents
    ]
    bracket = np.tan(np.array([compute_head_angle(count, coefficients) for count in counts]) - coefficients[8])
    expected = body @ nominal @ on_board
    slope, offset = np.polyfit(bracket, np.tan(np.arctan(expected[:, 1] / expected[:, 2]) - coefficients[8]), 1)
    return float(slope), float(offset)


def build_uploads(config: MissionConfig) -> tuple[OnBoardTables, OnBoardTables]:
    """Build the tables of R's uploads, one of which turns the S filter off, the remedy that R describes.

    The first, of December 11, has R (3) for DSS-2 and the penetration biases. The second, of February 27 and 28, has the gyro's
    R (9), and b coefficients by R (6) with (c, d) as printed or by `fit_crossing_compensation` for the sensors of the config.
    """
    misalignments = np.stack([np.eye(3), R3_M])
    first = replace(config.tables, bias=None, misalignments=misalignments, penetration_biases=PENETRATION_BIASES)
    if config.filter_off_first:
        first = replace(first, s_filter="off")
    beta, nominal = first.coefficients_beta, sun_sensor.build_trmm_alignments(*config.boresights)
    sensors = zip(config.sun_sensors, misalignments, nominal, beta, strict=True)
    factors = list(R6) if config.printed_coefficients else [fit_crossing_compensation(*sensor) for sensor in sensors]
    changed = np.stack([apply_compensation(b, *cd) for b, cd in zip(beta, factors, strict=True)])
    second = replace(first, G=R9_G, bias=R9_BIAS, coefficients_beta=changed)
    return first, second if config.filter_off_first else replace(second, bias=None, s_filter="off")


def build_period_tables(config: MissionConfig | None = None) -> dict[str, OnBoardTables]:
    """Build tables of R Table 3's periods: precalibration, calibration1, postcalibration, each with a starting bias."""
    config = config or MissionConfig()
    first, second = build_uploads(config)
    third = replace(second, bias=R9_BIAS)
    return {"precalibration": config.tables, "calibration1": replace(first, bias=PRELAUNCH_BIAS), "postcalibration": third}
