"""R's story from end to end, nothing of its outcome put in: align near the boresight, fly far from it, mend with R (6).

The sun sensors are mounted as designed, with the heads' angles of the alignment records and nothing else; the Earth sensor
has no biases. Then what the flight did is done with simulated telemetry alone:

1. early orbits before December 11, with the first tables, whose sun angles are 8 to 12°;
2. the alignment: R's first algorithm (`gyrocal.sensors.alignment.align_together`), DSS-1 held, M of DSS-2 and penetration
   biases found;
3. its upload; orbits of the second period with sun angles of up to 58°, the size of their yaw updates;
4. (c, d) of R (6), fitted for each sensor to the readings of those orbits with the Sun within 4° of the XY plane, against
   the ground's batch attitudes, which share the sensors' errors;
5. its upload, with the gyro's R (9); orbits with the same Sun again.

R (3) and R (6) are compared with what is found. Where they differ, the flight's sensors were not mounted as designed. The
gyro's calibration is R (9), which the reproduction of N calibrates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gyrocal.sensors.alignment import align_together
from gyrocal.sensors.head_compensation import PUBLISHED_COMPENSATION
from simulator.mission_mode.calendar import compute_sun_angle
from simulator.mission_mode.config import DAY, PRELAUNCH_BIAS, R9_BIAS, R9_G, MissionConfig, OnBoardTables, apply_compensation
from simulator.mission_mode.flight import MissionRun, simulate_mission
from simulator.mission_mode.mounting import R3_M, build_mounted_sensors
from simulator.sensors.sun import SIMULATED_BETA_COEFFICIENTS, build_trmm_alignments, compute_head_tangents
from simulator.streams import generator
from studies.robertson.calendar import FIRST_DAYS, convert_to_mission_day, shift_mission_start
from studies.robertson.ground import collect_ground_data, solve_ground_attitude

Array = NDArray[np.float64]

EARLY_DEG = (8.0, 12.0)  # sun angles of the alignment
EARLY_ORBITS = 3
LATE_DEG = (5.0, 20.0, 35.0, 45.0, 57.0)  # of the second period
SETTLING, SETTLED_UPDATES = 2.0, 3
NEAR_PLANE_DEG = 4.0
READING_SPACING_S = 30.0  # of the readings that (c, d) are fitted to


@dataclass(frozen=True)
class HistoryResult:
    """What came out."""

    misalignment: Array  # (3,) rotation vector of M of DSS-2 that was found, deg; biases (4,) of the Earth sensor, deg
    biases: Array
    factors: tuple[tuple[float, float], tuple[float, float]]  # (c, d) of both sensors
    updates: pd.DataFrame  # a row a sun angle: mean size of the updates with the first tables, the alignment, and (c, d)

    def compare_published(self) -> pd.DataFrame:
        """Compare the estimates with R's."""
        published = np.rad2deg(Rotation.from_matrix(find_nearest_rotation(R3_M)).as_rotvec())
        rows = [
            {"what": f"m_{axis} of DSS-2 (deg)", "found": found, "R": one}
            for axis, found, one in zip("xyz", self.misalignment, published, strict=True)
        ]
        for (name, one), (c, d) in zip(PUBLISHED_COMPENSATION.items(), self.factors, strict=True):
            rows.append({"what": f"(c − 1) of {name} (1e-6)", "found": (c - 1) * 1e6, "R": (one.c - 1) * 1e6})
            rows.append({"what": f"d of {name} (1e-6)", "found": d * 1e6, "R": one.d * 1e6})
        return pd.DataFrame(rows)


def simulate_full_history(entropy: int = 1998) -> HistoryResult:
    """All five steps."""
    base = MissionConfig(mounting="heads", sun_sensors=build_mounted_sensors("heads"))
    base = replace(base, earth_sensor=replace(base.earth_sensor, biases=np.zeros(4)))
    first = OnBoardTables()
    turn, biases = _average_alignment(base, first, entropy)
    second = replace(
        first, misalignments=np.stack([np.eye(3), turn]), penetration_biases=biases, s_filter="off", bias=PRELAUNCH_BIAS
    )
    days = [_find_day_by_sun(base, angle, FIRST_DAYS["calibration1"]) for angle in LATE_DEG]
    flown = [_simulate_day(base, second, day, entropy + k) for k, day in enumerate(days)]
    factors = _fit_compensation_factors(base, second, flown, entropy)
    beta = np.stack([apply_compensation(b, *cd) for b, cd in zip(second.coefficients_beta, factors, strict=True)])
    third = replace(second, G=R9_G, bias=R9_BIAS, coefficients_beta=beta)
    rows = []
    for k, day in enumerate(days):
        config, run = flown[k]
        rows.append(
            {
                "sun_angle_deg": float(run.updates["sun_angle_deg"].mean()),
                "forward": config.forward,
                "first_tables_deg": _average_update_size(_simulate_day(base, first, day, entropy + k)[1]),
                "aligned_deg": _average_update_size(run),
                "coefficients_deg": _average_update_size(_simulate_day(base, third, day, entropy + k)[1]),
            }
        )
    return HistoryResult(np.rad2deg(Rotation.from_matrix(turn).as_rotvec()), np.rad2deg(biases), factors, pd.DataFrame(rows))


def _average_alignment(base: MissionConfig, tables: OnBoardTables, entropy: int) -> tuple[Array, Array]:
    """M (3, 3) of DSS-2 and penetration biases (4,), means of the early orbits'."""
    turns, biases = estimate_orbit_alignments(base, tables, entropy)
    return np.asarray(Rotation.from_rotvec(turns.mean(axis=0)).as_matrix()), np.asarray(biases.mean(axis=0))


def estimate_orbit_alignments(base: MissionConfig, tables: OnBoardTables, entropy: int) -> tuple[Array, Array]:
    """Estimate from each early orbit alone the rotation vectors (n, 3) of M of DSS-2 and the biases (n, 4), rad."""
    turns, biases = [], []
    for k, angle in enumerate(np.linspace(*EARLY_DEG, EARLY_ORBITS)):
        config, run = _simulate_day(
            base, tables, _find_day_by_sun(base, angle, FIRST_DAYS["precalibration"]), entropy + 100 + k
        )
        data = collect_ground_data(
            config, _select_last_orbit(config, run), tables, generator(entropy, k, "end_to_end_alignment")
        )
        found = align_together(data.series, data.gyro, data.onboard[0], "DSS-1", epoch_s=data.t_s[0])
        turns.append(Rotation.from_matrix(found.misalignment["DSS-2"]).as_rotvec())
        biases.append(found.penetration_biases["ESA"])
    return np.array(turns), np.array(biases)


def _fit_compensation_factors(
    base: MissionConfig, tables: OnBoardTables, flown: Sequence[tuple[MissionConfig, MissionRun]], entropy: int
) -> tuple[tuple[float, float], tuple[float, float]]:
    """(c, d) by a straight line from the bracket of R (5) that was read to the one that the ground's attitude wants."""
    read: tuple[list[Array], list[Array]] = ([], [])
    wanted: tuple[list[Array], list[Array]] = ([], [])
    noise = generator(entropy, 0, "end_to_end_coefficients")
    for config, run in flown:
        rows = _select_last_orbit(config, run)
        ground = solve_ground_attitude(config, rows, tables, generator(entropy, 1, "end_to_end_ground"), READING_SPACING_S)
        data = collect_ground_data(config, rows, tables, generator(entropy, 1, "end_to_end_ground"), READING_SPACING_S)
        body, seen = (np.einsum("nij,nj->ni", A, data.sun) for A in (ground.attitudes, data.true))
        near = np.abs(np.rad2deg(np.arcsin(body[:, 2]))) < NEAR_PLANE_DEG
        for k, (N, sensor) in enumerate(zip(build_trmm_alignments(*base.boresights), config.sun_sensors, strict=True)):
            s = seen @ sensor.alignment
            chosen = near & (s[:, 2] > 0.3)
            beta = np.arctan([compute_head_tangents(x, y, z, sensor.head)[1] for x, y, z in s[chosen]])
            beta += sensor.noise * noise.standard_normal(len(beta))
            v = body[chosen] @ (N @ tables.misalignments[k])
            read[k].append(np.tan(beta - SIMULATED_BETA_COEFFICIENTS[8]))
            wanted[k].append(np.tan(np.arctan2(v[:, 1], v[:, 2]) - SIMULATED_BETA_COEFFICIENTS[8]))
    lines = [np.polyfit(np.concatenate(read[k]), np.concatenate(wanted[k]), 1) for k in range(2)]
    return (float(lines[0][0]), float(lines[0][1])), (float(lines[1][0]), float(lines[1][1]))


def _simulate_day(base: MissionConfig, tables: OnBoardTables, day: float, seed: int) -> tuple[MissionConfig, MissionRun]:
    config = replace(shift_mission_start(base, day), tables=tables)
    span = (SETTLING + 1.0) * config.orbit.period
    return config, simulate_mission(config, seconds=span, seed=seed, telemetry_every=1)


def _select_last_orbit(config: MissionConfig, run: MissionRun) -> pd.DataFrame:
    return run.telemetry[run.telemetry["t_s"] >= SETTLING * config.orbit.period]


def _average_update_size(run: MissionRun) -> float:
    return float(run.updates["update_deg"].abs()[SETTLED_UPDATES:].mean())


def _find_day_by_sun(base: MissionConfig, angle_deg: float, period: tuple[str, str]) -> float:
    """Day of a period whose sun angle is nearest to one."""
    start, stop = (convert_to_mission_day(moment, base) for moment in period)
    days = np.arange(start + 0.5, stop - 0.5, 0.05)
    angle = np.abs(np.rad2deg(compute_sun_angle(base.epoch, base.orbit, days * DAY)))
    return float(days[np.argmin(np.abs(angle - angle_deg))])


def find_nearest_rotation(M: Array) -> Array:
    """The rotation nearest to a published matrix, which is rounded."""
    U, _, V = np.linalg.svd(M)
    return np.asarray(U @ V)
