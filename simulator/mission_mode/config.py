"""What a Mission Mode run is made of: the spacecraft as it is, the tables its computer works with, and the days they change.

Published by R: orbit, mass, four wheels in a pyramid, control at 2 Hz, the sensors' layout, R (3) with the penetration biases,
the heads' angles, (c, d) of R (6), R (9), the days of the uploads. Not published, and chosen here: inertia, wheels and
torquers, gains, disturbances, noises, the tilt of the sun sensors. What is published of the gyro before launch is in N Table 3.

Mounting of the sun sensors
    The ground's alignment, R (3), was solved without knowing of the β heads' angles. How the sensors were really mounted is not
    published, nor which way round the sensors' axes and the Euler angles are counted. A fit of M over the field of view takes
    up the turn e₃ of a β head, and of the other two for DSS-2 up to 0.03° about the boresight. Four truths:

    "solved" : M_true = M X(e₃) with M = I and R (3), so that the ground's fit finds R (3), and β is right once it is uploaded.
               At the yaw update DSS-2 differs from DSS-1 by 0.156° before the alignment is uploaded, by 0 after. The default.
    "added"  : R (3) is how DSS-2 is mounted, and the heads' angles come on top: 0.093° before, 0.249° after.
    "heads"  : the sensors are mounted as designed, the heads' angles are all there is: 0.249° before, 0.405° after.
    "alike"  : as "heads", with R's numbers for frames whose x is alike in both sensors, toward +Z, and Euler angles that turn
               the head and not the axes: 0.115° before, 0.041° after.

    In runs of a day they give yaw updates of 0.30, 0.20, 0.51 and 0.24° before any upload and 0.02, 0.51, 0.83 and 0.07° after
    the alignment; R has 0.24 and 0.10°. "alike" comes nearest and is not the default: its axes were tried until it did, and
    from its truth a fit finds 0.115° of yaw and nothing about y, not R (3) with 0.156°, and 0.114° about both other axes. Of
    the four only "solved" is what R (3) would be found from. In it and in "alike" yaw is counted so that DSS-1 is right, R's
    M = I for DSS-1.
Coefficients
    R (6) with the published (c, d) moves yaw by 0.005° (DSS-1) and 0.003° (DSS-2). What (6) is for, the least error of β where
    the Sun crosses the XY plane, is `crossing_compensation`; it is found from the sensors as they are, better than the ground
    could, and so is a bound on what (6) can do. Uploads take the published pair unless asked for the other.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simulator.mission_mode.wheels import EQUAL_ELEVATION
from simulator.sensors import sun as sun_sensor
from simulator.sensors.earth import Filter, TrueEarthSensor
from simulator.sensors.sun import TrueSunSensor
from simulator.truth.orbit import CircularOrbit

Array = NDArray[np.float64]
Mounting = Literal["solved", "added", "heads", "alike"]
Forward = Literal["+x", "-x"]

EPOCH = "1997-11-27T21:30:00+00:00"  # R: launched November 27, 1997; near the launch's hour
NODE_DEG = 46.0  # not published; chosen so that the Sun crosses the orbit plane on December 13, N's first yaw maneuver
DAY = 86400.0

R9_G = np.array([[1.000443, -1.013e-3, 6.75235e-4], [7.63599e-4, 1.00053, -2.1629e-3], [9.41394e-4, 1.6831e-3, 1.00088]])
R9_BIAS = np.deg2rad([-1.549155e-4, 1.978161e-4, 0.7820254e-4])
# N Table 3 before launch: misalignments -0.036, 0.006; 0.059, -0.033; 0.005, 0.030 deg.
PRELAUNCH_G = np.eye(3) + np.deg2rad([[0.0, -0.036, 0.006], [0.059, 0.0, -0.033], [0.005, 0.030, 0.0]])
PRELAUNCH_BIAS = np.deg2rad([-1.41e-4, 1.58e-4, 0.86e-4])
R3_M = 1e-3 * np.array([[999.996, -1.98736, -1.99437], [1.9928, 999.994, 2.7292], [1.98893, -2.73316, 999.994]])
PENETRATION_BIASES = np.deg2rad([-0.1574, 0.04635, -0.09414, -0.05382])
INERTIA = np.array([[8500.0, 40.0, -120.0], [40.0, 6000.0, 60.0], [-120.0, 60.0, 9500.0]])  # kg m², not published
R6 = ((1.000047, 8.5e-5), (0.999977, 5.3e-5))  # (c, d) of DSS-1 and DSS-2


@dataclass(frozen=True)
class Spacecraft:
    """Body, wheels, torquers and what disturbs them; none of it published but the mass, 3523 kg.

    Attributes
    ----------
    inertia : (3, 3) kg m²
    elevation : of the wheels' pyramid, rad
    torque_limit, momentum_limit : of a wheel, N m and N m s
    dipole_limit : of a torquer, A m²
    residual_dipole : (3,) of the body, A m²
    drag : mean force of the air, against the velocity, N
    drag_swing : its day-night part; the force is drag (1 + swing × cosine of the Sun's zenith angle)
    pressure_arm : (3,) from the centre of mass to that of pressure, m
    gravity_gradient : whether it acts
    """

    inertia: Array = field(
        default_factory=lambda: np.array([[8500.0, 40.0, -120.0], [40.0, 6000.0, 60.0], [-120.0, 60.0, 9500.0]])
    )
    elevation: float = EQUAL_ELEVATION
    torque_limit: float = 0.3
    momentum_limit: float = 50.0
    dipole_limit: float = 200.0
    residual_dipole: Array = field(default_factory=lambda: np.array([2.0, -3.0, 2.0]))
    drag: float = 0.01
    drag_swing: float = 0.4
    pressure_arm: Array = field(default_factory=lambda: np.array([0.1, 0.05, 0.2]))
    gravity_gradient: bool = True


@dataclass(frozen=True)
class TrueGyro:
    """The gyro as it is: ω_raw = G⁻¹ (ω − b) + noise, R (7).

    Attributes
    ----------
    G : (3, 3)
    bias : (3,) b at the start, rad/s
    arw : angle random walk, rad/√s
    rrw : random walk of b, rad/s/√s
    """

    G: Array = field(default_factory=lambda: R9_G)
    bias: Array = field(default_factory=lambda: R9_BIAS)
    arw: float = float(np.deg2rad(2.6e-4))
    rrw: float = 0.0


@dataclass(frozen=True)
class OnBoardTables:
    """What the ground uploads.

    Attributes
    ----------
    G : (3, 3) of the gyro
    bias : (3,) of the gyro, rad/s; that of yaw is solved for on board from there on. None leaves the present one.
    misalignments : (2, 3, 3) M of DSS-1 and DSS-2, R (1)
    coefficients_alpha, coefficients_beta : (2, 9) of R (5)
    penetration_biases : (4,) rad
    s_filter : of the Earth sensor
    """

    G: Array = field(default_factory=lambda: PRELAUNCH_G)
    bias: Array | None = field(default_factory=lambda: PRELAUNCH_BIAS)
    misalignments: Array = field(default_factory=lambda: np.stack([np.eye(3), np.eye(3)]))
    coefficients_alpha: Array = field(default_factory=lambda: np.stack([sun_sensor.ALPHA, sun_sensor.ALPHA]))
    coefficients_beta: Array = field(default_factory=lambda: np.stack([sun_sensor.BETA, sun_sensor.BETA]))
    penetration_biases: Array = field(default_factory=lambda: np.zeros(4))
    s_filter: Filter = "restarted"


@dataclass(frozen=True)
class Controller:
    """The control law at 2 Hz, about each axis; gains are not published.

    Attributes
    ----------
    cycle_s : length of a control cycle, s
    bandwidth : natural frequency ω of each axis, (3,) rad/s: gains I ω², 2 ζ I ω
    damping : ζ
    integral_s : time constant of the integral part, s: gain I ω² / integral_s
    integral_limit : largest integral of an error, rad s
    inertia : (3,) what the gains and the feed-forward are formed with, kg m²
    unloading : k of the cross-product law, 1/s
    geodetic_rate : whether the rate commanded is that of the geodetic frame, or of geocentric LVLH
    gyro_slews : whether roll and pitch are propagated by gyro during a yaw maneuver, or taken from the Earth sensor
    """

    cycle_s: float = 0.5
    bandwidth: Array = field(default_factory=lambda: np.full(3, 0.05))
    damping: float = 0.8
    integral_s: float = 300.0
    integral_limit: float = 1.0
    inertia: Array = field(default_factory=lambda: np.array([8500.0, 6000.0, 9500.0]))
    unloading: float = 2e-3
    geodetic_rate: bool = True
    gyro_slews: bool = True


@dataclass(frozen=True)
class YawManeuver:
    """A turn by 180° about nadir.

    Attributes
    ----------
    start_s : s since the epoch
    duration_s : s
    ramp_fraction : share of the duration that each ramp of the rate takes; the profile is that of `maneuvers.Slew`
    """

    start_s: float
    duration_s: float = 1000.0
    ramp_fraction: float = 0.2


@dataclass(frozen=True)
class MissionConfig:
    """A run.

    Attributes
    ----------
    epoch : ISO 8601, UTC
    orbit : with node and argument of latitude at the epoch
    spacecraft, gyro, sun_sensors, earth_sensor : as they are; the Earth sensor's filter is that of the tables
    magnetometer_sigma : 1-sigma of an axis, T
    controller : the control law
    tables : on board at the start
    uploads : (s since the epoch, tables), ascending
    forward : the body axis along the velocity at the start, "+x" or "-x"
    maneuvers : yaw maneuvers, ascending, each of which swaps it
    substeps : steps of integration in a control cycle
    """

    epoch: str = EPOCH
    orbit: CircularOrbit = field(
        default_factory=lambda: CircularOrbit(350e3, float(np.deg2rad(35.0)), float(np.deg2rad(NODE_DEG)), j2=True)
    )
    spacecraft: Spacecraft = field(default_factory=Spacecraft)
    gyro: TrueGyro = field(default_factory=TrueGyro)
    sun_sensors: tuple[TrueSunSensor, TrueSunSensor] = field(default_factory=lambda: mounted())
    earth_sensor: TrueEarthSensor = field(default_factory=lambda: TrueEarthSensor(biases=PENETRATION_BIASES))
    magnetometer_sigma: float = 3e-7
    controller: Controller = field(default_factory=Controller)
    tables: OnBoardTables = field(default_factory=OnBoardTables)
    uploads: tuple[tuple[float, OnBoardTables], ...] = ()
    forward: Forward = "-x"
    maneuvers: tuple[YawManeuver, ...] = ()
    substeps: int = 1


def mounted(mounting: Mounting = "solved") -> tuple[TrueSunSensor, TrueSunSensor]:
    """TRMM's sun sensors with the flight's heads; see the module's text for what mounting means."""
    heads = sun_sensor.HEAD_DSS1, sun_sensor.HEAD_DSS2
    turns = [np.eye(3), np.eye(3)]
    if mounting == "alike":
        # To first order the other sense of the angles is their negative, and x and y reversed is e₁ and e₃ negative.
        heads = -heads[0], heads[1] * np.array([1.0, -1.0, 1.0])
        turns = [_about_x(heads[0][2]), _about_x(-heads[0][2])]
    elif mounting == "solved":
        turns = [M @ _about_x(head[2]) for M, head in zip((np.eye(3), R3_M), heads, strict=True)]
    elif mounting == "added":
        turns[1] = R3_M
    return sun_sensor.trmm_sun_sensors(misalignments=(turns[0], turns[1]), heads=heads)


def _about_x(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])


def compensated(coefficients: Array, c: float, d: float) -> Array:
    """R (6): b₁ → c b₁ + d, and b₂, b₃, b₆ times c, of b (9,)."""
    out = np.array(coefficients, dtype=float)
    out[[0, 1, 2, 5]] *= c
    out[0] += d
    return out


def crossing_compensation(sensor: TrueSunSensor, on_board: Array, nominal: Array) -> tuple[float, float]:
    """(c, d) of R (6) for the least error of β at the yaw update.

    Least squares over tan β with the Sun in the body's XY plane, 0° to 58.4° from the XZ plane, and α read as it is.

    Parameters
    ----------
    sensor : as it is
    on_board : (3, 3) M on board
    nominal : (3, 3) N
    """
    side = np.sign(nominal[0, 2])
    angle = np.deg2rad(np.linspace(0.0, 58.4, 50))
    body = np.stack([side * np.cos(angle), -np.sin(angle), np.zeros_like(angle)], axis=-1)
    seen = np.array([sun_sensor.head_tangents(x, y, z, sensor.head) for x, y, z in body @ sensor.alignment])
    wanted = body @ nominal @ on_board
    slope, offset = np.polyfit(seen[:, 1], wanted[:, 1] / wanted[:, 2], 1)
    return float(slope), float(offset)


def alignment_upload(before: OnBoardTables, mounting: Mounting = "solved") -> OnBoardTables:
    """R's first upload, December 11: R (3) for DSS-2 and the penetration biases."""
    turn = np.diag([-1.0, -1.0, 1.0]) if mounting == "alike" else np.eye(3)
    return replace(
        before,
        bias=None,
        misalignments=np.stack([np.eye(3), turn @ R3_M @ turn]),
        penetration_biases=PENETRATION_BIASES,
    )


def filter_upload(before: OnBoardTables) -> OnBoardTables:
    """S filter turned off, the remedy R describes."""
    return replace(before, bias=None, s_filter="off")


def coefficient_upload(before: OnBoardTables, sensors: tuple[TrueSunSensor, TrueSunSensor] | None = None) -> OnBoardTables:
    """R's second upload, February 27 and 28: the gyro's R (9), and b coefficients by R (6) with the published (c, d).

    Parameters
    ----------
    before : tables they change
    sensors : as they are, to take (c, d) from `crossing_compensation` instead
    """
    factors = R6
    if sensors is not None:
        pairs = zip(sensors, before.misalignments, sun_sensor.trmm_alignments(), strict=True)
        first, second = (crossing_compensation(*pair) for pair in pairs)
        factors = first, second
    beta = np.stack([compensated(b, *cd) for b, cd in zip(before.coefficients_beta, factors, strict=True)])
    return replace(before, G=R9_G, bias=R9_BIAS, coefficients_beta=beta)


def period_tables(mounting: Mounting = "solved", published: bool = True) -> dict[str, OnBoardTables]:
    """Tables of R Table 3's periods: precalibration, calibration1, postcalibration; the S filter is off in the last two.

    Parameters
    ----------
    mounting : of the sensors the tables are for
    published : whether (c, d) are R's, or those of `crossing_compensation`
    """
    first = OnBoardTables()
    second = replace(filter_upload(alignment_upload(first, mounting)), bias=PRELAUNCH_BIAS)
    third = coefficient_upload(second, None if published else mounted(mounting))
    return {"precalibration": first, "calibration1": second, "postcalibration": third}
