"""R Table 3's periods, a mission begun on a later day, and the yaw maneuvers of N's intervals 2 and 6 as flights."""

from dataclasses import replace

import pandas as pd

from simulator.mission_mode.calendar import compute_sun_angle
from simulator.mission_mode.config import DAY, MissionConfig, OnBoardTables, YawManeuver
from simulator.mission_mode.flight import build_flight_schedule

PERIODS = ("precalibration", "calibration1", "postcalibration")
FIRST_DAYS = {  # UTC, of R Table 3's periods; each ends where the next one starts but for the last days of February
    "precalibration": ("1997-11-27T21:30:00+00:00", "1997-12-11T12:00:00+00:00"),
    "calibration1": ("1997-12-11T12:00:00+00:00", "1998-02-27T12:00:00+00:00"),
    "postcalibration": ("1998-03-01T00:00:00+00:00", "1998-05-01T00:00:00+00:00"),
}
YAW_MANEUVER_TIMES = {"+x to -x": "1997-12-13T13:20:00+00:00", "-x to +x": "1998-01-14T20:57:00+00:00"}  # N Table 1, UTC
ORBITS_TO_SLEW = 4.5  # before the maneuver, for yaw updates to settle


def shift_mission_start(config: MissionConfig, days: float) -> MissionConfig:
    """The config so many days later, without maneuvers and uploads, flying with the axis forward that keeps the Sun on −Y."""
    t = days * DAY
    orbit = replace(
        config.orbit,
        node=config.orbit.node + config.orbit.nodal_rate * t,
        latitude_argument=config.orbit.latitude_argument + config.orbit.mean_motion * t,
    )
    epoch = (pd.Timestamp(config.epoch) + pd.Timedelta(days=days)).isoformat()
    ahead = float(compute_sun_angle(config.epoch, config.orbit, t)) > 0
    return replace(config, epoch=epoch, orbit=orbit, forward="+x" if ahead else "-x", maneuvers=(), uploads=())


def convert_to_mission_day(moment: str, config: MissionConfig) -> float:
    """Days from the config's epoch to a moment, UTC."""
    return float((pd.Timestamp(moment) - pd.Timestamp(config.epoch)).total_seconds() / DAY)


def build_slew_config(config: MissionConfig, tables: OnBoardTables, maneuver: str) -> MissionConfig:
    """A run with the yaw maneuver nearest to one of `YAW_MANEUVER_TIMES`, with these tables throughout."""
    planned = build_flight_schedule(config, 60.0).maneuvers
    start = min(
        planned, key=lambda one: abs(one.start_s / DAY - convert_to_mission_day(YAW_MANEUVER_TIMES[maneuver], config))
    ).start_s
    lead = ORBITS_TO_SLEW * config.orbit.period
    return replace(shift_mission_start(config, (start - lead) / DAY), tables=tables, maneuvers=(YawManeuver(lead),))
