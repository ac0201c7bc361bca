"""R Tables 1 and 3 from the months: accuracy, yaw updates and bias scatter of each period, requirements, orientation, dates.

Attitude accuracy is the on-board attitude's RMS error over an orbit, averaged over a period's full orbits in normal pointing;
the yaw update the mean of its size; the bias scatter the standard deviation of the bias that an attitude solution over an
orbit would find, ω − G ω_raw with the G on board. Each is formed for each seed; the tables give the seeds' mean and range.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from simulator.mission_mode.config import DAY, MissionConfig
from simulator.mission_mode.flight import MissionRun, build_flight_schedule
from studies.robertson import published_tables
from studies.robertson.calendar import FIRST_DAYS, PERIODS, convert_to_mission_day
from studies.robertson.published_tables import ROTATION_NAMES

Array = NDArray[np.float64]

GYRO_AXES = {"x": "roll", "y": "pitch", "z": "yaw"}


def select_period(table: pd.DataFrame, period: str) -> pd.DataFrame:
    """Rows of a table with t_s that are in one of R Table 3's periods."""
    start, stop = (convert_to_mission_day(moment, MissionConfig()) * DAY for moment in FIRST_DAYS[period])
    return table[table["t_s"].between(start, stop, inclusive="left")]


def select_full_orbits(orbits: pd.DataFrame) -> pd.DataFrame:
    """Orbits in normal pointing throughout; R's differences are each "over at least a full orbit"."""
    return orbits[(orbits["samples"] > 0) & (orbits["lost"] == 0)]


def compute_attitude_accuracy(run: MissionRun, period: str, axis: str) -> float:
    """Mean over the period's orbits of the RMS on-board attitude error, deg."""
    return float(select_full_orbits(select_period(run.orbits, period))[f"rms_knowledge_{axis}_deg"].mean())


def compute_mean_update(run: MissionRun, period: str) -> float:
    """Mean size of the period's yaw updates, deg."""
    return float(select_period(run.updates, period)["update_deg"].abs().mean())


def compute_bias_scatter(run: MissionRun, period: str, axis: str) -> float:
    """Standard deviation over the period's orbits of the bias seen about a body axis, deg/h."""
    return float(select_full_orbits(select_period(run.orbits, period))[f"apparent_bias_{GYRO_AXES[axis]}_deg_h"].std())


def build_performance_table(runs: Sequence[MissionRun]) -> pd.DataFrame:
    """R Table 3, a row a number: the flight's, the seeds' mean, their lowest and highest, and simulated minus flown."""
    rows = []
    for period in PERIODS:
        of = {
            ("attitude_accuracy_deg", axis): [compute_attitude_accuracy(run, period, axis) for run in runs]
            for axis in ROTATION_NAMES
        }
        of["yaw_update_deg", "yaw"] = [compute_mean_update(run, period) for run in runs]
        if period != "precalibration":
            of |= {
                ("gyro_bias_std_deg_h", axis): [compute_bias_scatter(run, period, axis) for run in runs] for axis in GYRO_AXES
            }
        for (parameter, axis), values in of.items():
            flight = published_tables.read_published_performance(parameter, axis, period)
            rows.append((parameter, axis, period, flight, float(np.mean(values)), min(values), max(values)))
    names = ["parameter", "axis", "period", "flight", "simulated", "lowest", "highest"]
    table = pd.DataFrame(rows, columns=names)
    return table.assign(
        simulated_minus_flight=table["simulated"] - table["flight"], simulated_over_flight=table["simulated"] / table["flight"]
    )


def build_requirements_table(runs: Sequence[MissionRun]) -> pd.DataFrame:
    """R Table 1 in each period and axis: three times the RMS over all orbits in normal pointing."""
    rows = []
    columns = {"knowledge": "rms_knowledge", "pointing": "rms_error", "stability": "jitter"}
    for period in PERIODS:
        orbits = pd.concat([select_period(run.orbits, period) for run in runs])
        orbits = orbits[orbits["samples"] > 0]
        for name, column in columns.items():
            limit = published_tables.read_requirement(name)
            for axis in ROTATION_NAMES:
                values, weights = orbits[f"{column}_{axis}_deg"].to_numpy(), orbits["samples"].to_numpy()
                together = _find_largest(values) if name == "stability" else 3 * _compute_weighted_rms(values, weights)
                rows.append(
                    {
                        "period": period,
                        "requirement": name,
                        "axis": axis,
                        "limit_deg": limit,
                        "simulated_deg": together,
                        # Stability says nothing without a source of jitter; NaN where nothing was flown is not met either.
                        "met": None if name == "stability" else bool(together < limit),
                    }
                )
    return pd.DataFrame(rows)


def _compute_weighted_rms(values: Array, weights: Array) -> float:
    return float(np.sqrt(weights @ values**2 / weights.sum())) if len(values) else np.nan


def _find_largest(values: Array) -> float:
    return float(values.max()) if len(values) else np.nan


def compare_orientations(runs: Sequence[MissionRun]) -> pd.DataFrame:
    """Yaw accuracy and updates of each period, flying +x and −x forward."""
    rows = []
    for period in PERIODS:
        orbits = pd.concat([select_full_orbits(select_period(run.orbits, period)) for run in runs])
        updates = pd.concat([select_period(run.updates, period) for run in runs])
        for forward in ("+x", "-x"):
            rows.append(
                {
                    "period": period,
                    "forward": forward,
                    "orbits": int((orbits["forward"] == forward).sum()),
                    "yaw_accuracy_deg": orbits.loc[orbits["forward"] == forward, "rms_knowledge_yaw_deg"].mean(),
                    "yaw_update_deg": updates.loc[updates["forward"] == forward, "update_deg"].abs().mean(),
                }
            )
    return pd.DataFrame(rows)


def compare_maneuver_dates(days: float) -> pd.DataFrame:
    """When the simulated spacecraft turns, and how far that is from the maneuvers whose dates are published."""
    base = MissionConfig()
    schedule = build_flight_schedule(base, days)
    published = published_tables.read_maneuver_dates()
    rows = []
    forward = schedule.forward
    for maneuver in schedule.maneuvers:
        moment = pd.Timestamp(base.epoch) + pd.Timedelta(seconds=maneuver.start_s + 0.5 * maneuver.duration_s)
        forward = "-x" if forward == "+x" else "+x"
        apart = (moment - published["date_utc"]).dt.total_seconds() / DAY
        nearest = int(apart.abs().argmin())
        near = abs(apart[nearest]) < 5.0
        rows.append(
            {
                "simulated_utc": f"{moment:%Y-%m-%d %H:%M}",
                "forward_after": forward,
                "flight": published["source"][nearest] if near else "",
                "flight_utc": f"{published['date_utc'][nearest]:%Y-%m-%d}" if near else "",
                "simulated_minus_flight_days": float(apart[nearest]) if near else np.nan,
            }
        )
    return pd.DataFrame(rows, columns=["simulated_utc", "forward_after", "flight", "flight_utc", "simulated_minus_flight_days"])
