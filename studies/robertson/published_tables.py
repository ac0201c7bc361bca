"""The flight's values that the mission study is compared with: R Tables 1–3, and the published dates of yaw maneuvers.

R Table 3's scatter of the gyro bias is given for two periods, "the second and third of those used for the other parameters",
although its layout puts the first of them under precalibration. R dates the maneuver of March 21 to the day.
"""

from functools import cache

import pandas as pd

from studies.natanson import flight

ROTATION_NAMES = ("roll", "pitch", "yaw")


@cache  # a query each, and the ladder's intervals have tens of thousands
def read_published_performance(parameter: str, axis: str, period: str) -> float:
    """Read a number of R Table 3; NaN where R has none."""
    rows = flight.read_published_table("mission_performance").query("parameter == @parameter and axis == @axis")
    return float(rows[period].iloc[0])


def read_published_slew_error(axis: str, phase: str) -> float:
    """Read a number of R Table 2, deg; phase "precalibration" or "postcalibration"."""
    rows = flight.read_published_table("yaw_maneuver_error").query("axis == @axis")
    return float(rows[f"{phase}_deg"].iloc[0])


def read_requirement(name: str) -> float:
    """Read a limit of R Table 1, deg: "knowledge", "pointing" (both 3-sigma), "stability" (over 1 s)."""
    rows = flight.read_published_table("mission_requirements").query("requirement == @name")
    return float(rows["limit_deg"].iloc[0])


def read_maneuver_dates() -> pd.DataFrame:
    """Read the yaw maneuvers whose dates are published."""
    table = flight.read_published_table("yaw_maneuver_dates").copy()
    table["date_utc"] = pd.to_datetime(table["date_utc"])
    return table
