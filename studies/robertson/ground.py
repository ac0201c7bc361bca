"""R's own statistics: the on-board attitude against the ground's batch over an orbit of the flown telemetry.

R Table 3 and Figures 9, 11 and 13 are on board minus ground, and the ground has no truth: "the ground solution is obtained by
gyro propagation of the epoch attitude from a batch least-squares computation using a full orbit's sensor data", with both sun
sensors, the Earth sensor and the gyro. Here the same batch, `gyrocal.estimation.batch` with plain weights, is formed of what a
flight of the Mission Mode loop sent down: raw rates and penetration angles of the loop itself, so that the Earth sensor's
noise is that which the computer on board used; counts of the sun sensors are made of the true attitude, with noise of their
own, whenever the Sun is in view and not eclipsed. Sun and position are those of the truth.

The ground works with tables of its own: its G, alignment, penetration biases and coefficients. Before December 11 those may
have been the tables on board or the ones found later; R does not say, and both are formed.

    on board minus ground: exp([k×]) = A_onboard A_groundᵀ to first order about the body axes;   A_onboard = exp(−[ε̂×]) C

The batch's bias is the b' of R (8) and holds what the sensors' errors do to it: a yaw reference that is turned by ψ in the body
is taken for a bias of ∓n ψ about x at ∓1 RPO.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gyrocal.attitude import residual, rotation_matrix
from gyrocal.estimation.arc import build_gyro_arc
from gyrocal.estimation.batch import batch
from gyrocal.recording import GyroStream
from gyrocal.sensors.earth import EarthModel, EarthSensor
from gyrocal.sensors.series import SensorSeries
from gyrocal.sensors.sun import SunSensor
from simulator.mission_mode.config import MissionConfig, OnBoardTables
from simulator.mission_mode.target_frame import compute_commanded_attitude
from simulator.sensors.horizon import compute_orbit_position
from simulator.sensors.sun import build_trmm_alignments, observe
from simulator.truth.sun import DAY, compute_julian_date, compute_sun_vector, is_eclipsed
from studies.robertson.published_tables import ROTATION_NAMES

Array = NDArray[np.float64]

MEASUREMENT_SPACING_S = 30.0  # from a measurement of the batch to the next
QUADRANTS = 4
DEG_H_PER_RAD_S = float(np.rad2deg(3600.0))  # of rad/s


@dataclass(frozen=True)
class GroundSolution:
    """A batch over a stretch of telemetry, beside the attitude on board and the true one."""

    onboard_minus_ground: Array  # onboard_minus_ground, ground_minus_true, onboard_minus_true: (n, 3) roll, pitch, yaw, rad
    ground_minus_true: Array
    onboard_minus_true: Array
    bias: Array  # (3,) that the batch found, rad/s
    attitudes: Array  # (n, 3, 3) the batch's

    def row(self) -> dict[str, float]:
        """RMS of each difference, deg, and the bias, deg/h."""
        out: dict[str, float] = {}
        for name in ("onboard_minus_ground", "ground_minus_true", "onboard_minus_true"):
            rms = np.rad2deg(np.sqrt(np.mean(getattr(self, name) ** 2, axis=0)))
            out |= {f"{name}_{axis}_deg": float(value) for axis, value in zip(ROTATION_NAMES, rms, strict=True)}
        return out | {
            f"bias_{axis}_deg_h": float(value) * DEG_H_PER_RAD_S for axis, value in zip("xyz", self.bias, strict=True)
        }


@dataclass(frozen=True)
class GroundData:
    """What the ground has of a stretch of telemetry, and the truth beside it."""

    series: list[SensorSeries]  # series, gyro: for the batch
    gyro: GyroStream
    t_s: Array  # (n,) times of the measurements, s
    true: Array  # true, onboard: (n, 3, 3) attitudes
    onboard: Array
    sun: Array  # (n, 3) inertial


def collect_ground_data(
    config: MissionConfig,
    telemetry: pd.DataFrame,
    tables: OnBoardTables,
    rng: np.random.Generator,
    every_s: float = MEASUREMENT_SPACING_S,
) -> GroundData:
    """The ground's data of a stretch of telemetry; parameters and errors as of `solve_ground_attitude`."""
    t, cycle = telemetry["t_s"].to_numpy(dtype=float), config.controller.cycle_s
    if len(t) < 2 or not np.allclose(np.diff(t), cycle):
        raise ValueError("the ground's batch needs telemetry of every cycle")
    gyro = GyroStream(
        t[:-1], np.deg2rad(_select_columns(telemetry, "raw_{}_deg_s", "xyz")[1:]), cycle, config.gyro.arw, tables.G
    )
    rows = telemetry.iloc[:: max(1, round(every_s / cycle))]
    at = rows["t_s"].to_numpy(dtype=float)
    yaw = 0.0 if config.forward == "+x" else np.pi
    C = compute_commanded_attitude(config.orbit, at, yaw, config.ephemeris.node, config.ephemeris.inclination)
    true, onboard = (
        rotation_matrix(-np.deg2rad(_select_columns(rows, f"{what}_{{}}_deg", ROTATION_NAMES))) @ C
        for what in ("error", "estimate")
    )
    sun = compute_sun_vector(compute_julian_date(config.epoch) + at / DAY)
    return GroundData(_build_sensor_series(config, rows, at, true, sun, tables, rng), gyro, at, true, onboard, sun)


def solve_ground_attitude(
    config: MissionConfig,
    telemetry: pd.DataFrame,
    tables: OnBoardTables,
    rng: np.random.Generator,
    every_s: float = MEASUREMENT_SPACING_S,
) -> GroundSolution:
    """The ground's batch over telemetry of every cycle, without a yaw maneuver in it.

    A `ValueError` if the telemetry skips cycles.

    Parameters
    ----------
    config : that was flown
    telemetry : of consecutive cycles, with the raw columns
    tables : the ground's; a bias in them is not used, since the batch solves for it
    rng : of the sun sensors' noise
    every_s : between the measurements used
    """
    data = collect_ground_data(config, telemetry, tables, rng, every_s)
    found = batch(data.series, data.gyro, data.onboard[0], epoch_s=data.t_s[0], weighting="plain")
    # Propagated here, since with the attitudes the batch would compute the covariance of all of them, for half of its time.
    path = build_gyro_arc(data.gyro, data.t_s, tables.G)
    attitudes = path.propagate_nodes(found.bias)[0][path.node(data.t_s)] @ found.attitude
    differences = residual(data.onboard, attitudes), residual(attitudes, data.true), residual(data.onboard, data.true)
    return GroundSolution(*differences, found.bias, attitudes)


def _select_columns(table: pd.DataFrame, pattern: str, names: Iterable[str]) -> Array:
    return table[[pattern.format(name) for name in names]].to_numpy(dtype=float)


def _build_sensor_series(
    config: MissionConfig,
    rows: pd.DataFrame,
    t: Array,
    A: Array,
    sun: Array,
    tables: OnBoardTables,
    rng: np.random.Generator,
) -> list[SensorSeries]:
    """The Earth sensor's angles as flown, and both sun sensors' at the true attitudes A, as the ground's tables read them."""
    position = compute_orbit_position(config.orbit, t)
    lit = ~is_eclipsed(position, sun)
    horizon = config.earth_sensor.horizon
    earth = EarthSensor(tables.penetration_biases, horizon.co2_height, horizon.altitude, config.earth_sensor.sigma)
    whole = (rows["quadrants"] == QUADRANTS).to_numpy()
    sigma = np.where(whole, earth.sigma, np.inf)[:, None] * np.ones(QUADRANTS)
    angles = np.deg2rad(_select_columns(rows, "angle_{}_deg", map(str, range(1, QUADRANTS + 1))))
    out = [SensorSeries(EarthModel(earth, position), t, angles, sigma)]
    for k, sensor in enumerate(config.sun_sensors):
        counts, visible = observe(rng, sensor, A, sun)
        read = SunSensor(
            sensor.name,
            build_trmm_alignments(*config.boresights)[k],
            tables.misalignments[k],
            tables.coefficients_alpha[k],
            tables.coefficients_beta[k],
        )
        if (visible & lit).any():
            out.append(read.series(t, counts, sun, visible & lit))
    return out
