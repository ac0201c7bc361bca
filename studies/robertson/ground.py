"""R's own statistics: the on-board attitude against the ground's batch over an orbit of the flown telemetry, and its alignment.

R Table 3 and Figures 9, 11 and 13 are on board minus ground, and the ground has no truth: "the ground solution is obtained by
gyro propagation of the epoch attitude from a batch least-squares computation using a full orbit's sensor data", with both sun
sensors, the Earth sensor and the gyro. Here the same batch, `gyrocal.estimation.batch` with plain weights, is formed of what a
flight of the Mission Mode loop sent down: raw rates and penetration angles of the loop itself, so that the Earth sensor's
noise is the one that the computer on board used; counts of the sun sensors are made of the true attitude, with noise of their
own, whenever the Sun is in view and not eclipsed. Sun and position are those of the truth.

The ground works with tables of its own: its G, alignment, penetration biases and coefficients. Before December 11 those may
have been the tables on board or the ones found later; R does not say, and both are formed.

    on board minus ground: exp([k×]) = A_onboard A_groundᵀ to first order about the body axes;   A_onboard = exp(−[ε̂×]) C

The batch's bias is the b' of R (8) and holds what the sensors' errors do to it: a yaw reference that is turned by ψ in the body
is taken for a bias of ∓n ψ about x at ∓1 RPO.

R (3), the sun sensors' alignment, is found again from simulated telemetry of the early orbits, as the ground did it in flight.
The sun sensors are mounted as designed, with the heads' angles of the alignment records and nothing else; the Earth sensor has
no biases. R's first algorithm (`gyrocal.estimation.alignment.align_together`) holds DSS-1 and finds M of DSS-2 and the
penetration biases from orbits before December 11, whose sun angles are 8 to 12°.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array
from gyrocal.attitude import residual, rotation_matrix
from gyrocal.estimation.alignment import AlignmentResult, align_together
from gyrocal.estimation.arc import build_gyro_arc
from gyrocal.estimation.batch import batch
from gyrocal.recording import GyroStream
from gyrocal.sensors.earth import EarthModel, EarthSensor
from gyrocal.sensors.series import SensorSeries
from gyrocal.sensors.sun import SunSensor
from simulator.mission_mode.calendar import compute_sun_angle
from simulator.mission_mode.config import DAY, MissionConfig, OnBoardTables
from simulator.mission_mode.flight import simulate_mission
from simulator.mission_mode.mounting import R3_M, build_mounted_sensors
from simulator.mission_mode.target_frame import compute_commanded_attitude
from simulator.sensors.horizon import compute_orbit_position
from simulator.sensors.sun import build_trmm_alignments, observe
from simulator.streams import generator
from simulator.truth.sun import compute_julian_date, compute_sun_vector, is_eclipsed
from studies.robertson.calendar import FIRST_DAYS, convert_to_mission_day, shift_mission_start
from studies.robertson.published_tables import ROTATION_NAMES

MEASUREMENT_SPACING_S = 30.0  # from a measurement of the batch to the next
QUADRANTS = 4
DEG_H_PER_RAD_S = float(np.rad2deg(3600.0))  # of rad/s


class GroundSolution(NamedTuple):
    """A batch over a stretch of telemetry, compared with the attitude on board and the true one."""

    onboard_minus_ground: Array  # onboard_minus_ground, ground_minus_true, onboard_minus_true: (n, 3) roll, pitch, yaw, rad
    ground_minus_true: Array
    onboard_minus_true: Array
    bias: Array  # (3,) estimated by the batch, rad/s

    def row(self) -> dict[str, float]:
        """Return the RMS of each difference, deg, and the bias, deg/h."""
        out: dict[str, float] = {}
        for name, angles in zip(self._fields[:3], self[:3], strict=True):
            rms = np.rad2deg(np.sqrt(np.mean(angles**2, axis=0)))
            out |= {f"{name}_{axis}_deg": float(value) for axis, value in zip(ROTATION_NAMES, rms, strict=True)}
        return out | {
            f"bias_{axis}_deg_h": float(value) * DEG_H_PER_RAD_S for axis, value in zip("xyz", self.bias, strict=True)
        }


class GroundData(NamedTuple):
    """Data of a stretch of telemetry on the ground, and the true attitudes."""

    series: list[SensorSeries]  # series, gyro: for the batch
    gyro: GyroStream
    t_s: Array  # (n,) times of the measurements, s
    true: Array  # true, onboard: (n, 3, 3) attitudes
    onboard: Array


def collect_ground_data(
    config: MissionConfig, telemetry: pd.DataFrame, tables: OnBoardTables, rng: np.random.Generator
) -> GroundData:
    """Collect the ground's data of a stretch of telemetry; parameters and errors as of `solve_ground_attitude`."""
    t, cycle = telemetry["t_s"].to_numpy(dtype=float), config.controller.cycle_s
    if len(t) < 2 or not np.allclose(np.diff(t), cycle):
        raise ValueError("the ground's batch needs telemetry of every cycle")
    gyro = GyroStream(
        t[:-1], np.deg2rad(_select_columns(telemetry, "raw_{}_deg_s", "xyz")[1:]), cycle, config.gyro.arw, tables.G
    )
    rows = telemetry.iloc[:: max(1, round(MEASUREMENT_SPACING_S / cycle))]
    times = rows["t_s"].to_numpy(dtype=float)
    yaw = 0.0 if config.forward == "+x" else np.pi
    C = compute_commanded_attitude(config.orbit, times, yaw, config.ephemeris.node, config.ephemeris.inclination)
    true, onboard = (
        rotation_matrix(-np.deg2rad(_select_columns(rows, f"{kind}_{{}}_deg", ROTATION_NAMES))) @ C
        for kind in ("error", "estimate")
    )
    sun = compute_sun_vector(compute_julian_date(config.epoch) + times / DAY)
    return GroundData(_build_sensor_series(config, rows, times, true, sun, tables, rng), gyro, times, true, onboard)


def solve_ground_attitude(
    config: MissionConfig, telemetry: pd.DataFrame, tables: OnBoardTables, rng: np.random.Generator
) -> GroundSolution:
    """Solve the ground's batch over telemetry of every cycle, without a yaw maneuver in it.

    Raises `ValueError` if the telemetry skips cycles.

    Parameters
    ----------
    config : that was flown
    telemetry : of consecutive cycles, with the raw columns
    tables : the ground's; a bias in them is not used, since the batch solves for it
    rng : of the sun sensors' noise
    """
    data = collect_ground_data(config, telemetry, tables, rng)
    solution = batch(data.series, data.gyro, data.onboard[0], epoch_s=data.t_s[0], weighting="plain")
    # Propagated here: if the batch returned attitudes it would also compute all their covariances, which takes half its time.
    arc = build_gyro_arc(data.gyro, data.t_s, tables.G)
    attitudes = arc.propagate_nodes(solution.bias)[0][arc.find_nodes(data.t_s)] @ solution.attitude
    differences = residual(data.onboard, attitudes), residual(attitudes, data.true), residual(data.onboard, data.true)
    return GroundSolution(*differences, solution.bias)


def _select_columns(table: pd.DataFrame, pattern: str, names: Iterable[str]) -> Array:
    """Select the columns of a pattern filled with names, (rows, names)."""
    return table[[pattern.format(name) for name in names]].to_numpy(dtype=float)


def _build_sensor_series(
    config: MissionConfig, rows: pd.DataFrame, t: Array, A: Array, sun: Array, tables: OnBoardTables, rng: np.random.Generator
) -> list[SensorSeries]:
    """Build the Earth sensor's series as flown and the sun sensors' at the true attitudes A, read by the ground's tables."""
    position = compute_orbit_position(config.orbit, t)
    lit = ~is_eclipsed(position, sun)
    horizon = config.earth_sensor.horizon
    earth = EarthSensor(tables.penetration_biases, horizon.co2_height, horizon.altitude, config.earth_sensor.sigma)
    has_all_quadrants = (rows["quadrants"] == QUADRANTS).to_numpy()
    sigma = np.where(has_all_quadrants, earth.sigma, np.inf)[:, None] * np.ones(QUADRANTS)
    angles = np.deg2rad(_select_columns(rows, "angle_{}_deg", map(str, range(1, QUADRANTS + 1))))
    series = [SensorSeries(EarthModel(earth, position), t, angles, sigma)]
    for k, sensor in enumerate(config.sun_sensors):
        counts, visible = observe(rng, sensor, A, sun)
        ground_sensor = SunSensor(
            sensor.name,
            build_trmm_alignments(*config.boresights)[k],
            tables.misalignments[k],
            tables.coefficients_alpha[k],
            tables.coefficients_beta[k],
        )
        if (visible & lit).any():
            series.append(ground_sensor.series(t, counts, sun, visible & lit))
    return series


EARLY_DEG = (8.0, 12.0)  # sun angles of the alignment
EARLY_ORBITS = 3
SETTLING = 2.0  # orbits before the one that is used


def compare_alignment(entropy: int = 1998) -> pd.DataFrame:
    """Compare the rotation vector of DSS-2's M, mean over the early orbits, with R (3); deg."""
    base = MissionConfig(mounting="heads", sun_sensors=build_mounted_sensors("heads"))
    base = replace(base, earth_sensor=replace(base.earth_sensor, biases=np.zeros(4)))
    aligned = [align_one_orbit(base, angle, entropy, k) for k, angle in enumerate(np.linspace(*EARLY_DEG, EARLY_ORBITS))]
    vectors = [Rotation.from_matrix(result.misalignment["DSS-2"]).as_rotvec(degrees=True) for result in aligned]
    estimated = np.mean(vectors, axis=0)
    U, _, V = np.linalg.svd(R3_M)  # the printed matrix is rounded: the rotation nearest to it
    published = Rotation.from_matrix(U @ V).as_rotvec(degrees=True)
    return pd.DataFrame({"what": [f"m_{axis} of DSS-2 (deg)" for axis in "xyz"], "found": estimated, "R": published})


def align_one_orbit(base: MissionConfig, sun_angle_deg: float, entropy: int, number: int) -> AlignmentResult:
    """Align both sun sensors and the Earth sensor on one early orbit with the tables of launch."""
    tables = OnBoardTables()
    day = find_day_by_sun(base, sun_angle_deg, FIRST_DAYS["precalibration"])
    config = replace(shift_mission_start(base, day), tables=tables)
    span = config.orbit.period
    run = simulate_mission(config, seconds=(SETTLING + 1.0) * span, seed=entropy + 100 + number, telemetry_every=1)
    rows = run.telemetry[run.telemetry["t_s"] >= SETTLING * span]
    data = collect_ground_data(config, rows, tables, generator(entropy, number, "end_to_end_alignment"))
    return align_together(data.series, data.gyro, data.onboard[0], "DSS-1", epoch_s=data.t_s[0])


def find_day_by_sun(base: MissionConfig, angle_deg: float, period: tuple[str, str]) -> float:
    """Find the day of a period whose sun angle is nearest to an angle."""
    start, stop = (convert_to_mission_day(moment, base) for moment in period)
    days = np.arange(start + 0.5, stop - 0.5, 0.05)
    angle = np.abs(np.rad2deg(compute_sun_angle(base.epoch, base.orbit, days * DAY)))
    return float(days[np.argmin(np.abs(angle - angle_deg))])
