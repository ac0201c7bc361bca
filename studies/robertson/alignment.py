"""R (3) again: the sun sensors' alignment from simulated telemetry of the early orbits, as the ground did it in flight.

The sun sensors are mounted as designed, with the heads' angles of the alignment records and nothing else; the Earth sensor
has no biases. R's first algorithm (`gyrocal.estimation.alignment.align_together`) holds DSS-1 and finds M of DSS-2 and the
penetration biases from orbits before December 11, whose sun angles are 8 to 12°.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gyrocal.estimation.alignment import AlignmentResult, align_together
from simulator.mission_mode.calendar import compute_sun_angle
from simulator.mission_mode.config import DAY, MissionConfig, OnBoardTables
from simulator.mission_mode.flight import simulate_mission
from simulator.mission_mode.mounting import R3_M, build_mounted_sensors
from simulator.streams import generator
from studies.robertson.calendar import FIRST_DAYS, convert_to_mission_day, shift_mission_start
from studies.robertson.ground import collect_ground_data

Array = NDArray[np.float64]

EARLY_DEG = (8.0, 12.0)  # sun angles of the alignment
EARLY_ORBITS = 3
SETTLING = 2.0  # orbits before the one that is used


def compare_alignment(entropy: int = 1998) -> pd.DataFrame:
    """Compare the rotation vector of DSS-2's M, mean over the early orbits, with R (3); deg."""
    base = MissionConfig(mounting="heads", sun_sensors=build_mounted_sensors("heads"))
    base = replace(base, earth_sensor=replace(base.earth_sensor, biases=np.zeros(4)))
    found = np.mean(
        [
            Rotation.from_matrix(align_one_orbit(base, angle, entropy, k).misalignment["DSS-2"]).as_rotvec(degrees=True)
            for k, angle in enumerate(np.linspace(*EARLY_DEG, EARLY_ORBITS))
        ],
        axis=0,
    )
    U, _, V = np.linalg.svd(R3_M)  # the printed matrix is rounded: the rotation nearest to it
    published = Rotation.from_matrix(U @ V).as_rotvec(degrees=True)
    return pd.DataFrame({"what": [f"m_{axis} of DSS-2 (deg)" for axis in "xyz"], "found": found, "R": published})


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
    """Day of a period whose sun angle is nearest to one."""
    start, stop = (convert_to_mission_day(moment, base) for moment in period)
    days = np.arange(start + 0.5, stop - 0.5, 0.05)
    angle = np.abs(np.rad2deg(compute_sun_angle(base.epoch, base.orbit, days * DAY)))
    return float(days[np.argmin(np.abs(angle - angle_deg))])
