"""Periods of R Table 3, missions that begin on a later day, and the yaw maneuvers of N's intervals 2 and 6 as flights."""

from dataclasses import replace

import pandas as pd

from simulator.mission_mode.calendar import compute_sun_angle
from simulator.mission_mode.config import DAY, MissionConfig, OnBoardTables, YawManeuver
from simulator.mission_mode.flight import build_flight_schedule

PERIODS = ("precalibration", "calibration1", "postcalibration")
FIRST_DAYS = {  # start and stop of R Table 3's periods, UTC; each but the second ends where the next one starts
    "precalibration": ("1997-11-27T21:30:00+00:00", "1997-12-11T12:00:00+00:00"),
    "calibration1": ("1997-12-11T12:00:00+00:00", "1998-02-27T12:00:00+00:00"),
    "postcalibration": ("1998-03-01T00:00:00+00:00", "1998-05-01T00:00:00+00:00"),
}
YAW_MANEUVER_TIMES = {"+x to -x": "1997-12-13T13:20:00+00:00", "-x to +x": "1998-01-14T20:57:00+00:00"}  # N Table 1, UTC
ORBITS_TO_SLEW = 4.5  # before the maneuver, for yaw updates to settle


def shift_mission_start(config: MissionConfig, days: float) -> MissionConfig:
    """Start the mission so many days later, without maneuvers and uploads, and with the Sun on −Y."""
    t = days * DAY
    orbit = replace(
        config.orbit,
        node=config.orbit.node + config.orbit.nodal_rate * t,
        latitude_argument=config.orbit.latitude_argument + config.orbit.mean_motion * t,
    )
    epoch = (pd.Timestamp(config.epoch) + pd.Timedelta(days=days)).isoformat()
    is_plus_x = float(compute_sun_angle(config.epoch, config.orbit, t)) > 0
    return replace(config, epoch=epoch, orbit=orbit, forward="+x" if is_plus_x else "-x", maneuvers=(), uploads=())


def convert_to_mission_day(moment: str, config: MissionConfig) -> float:
    """Convert a moment in UTC to days from the config's epoch."""
    return float((pd.Timestamp(moment) - pd.Timestamp(config.epoch)).total_seconds() / DAY)


def build_slew_config(config: MissionConfig, tables: OnBoardTables, maneuver: str) -> MissionConfig:
    """Build a run with the planned maneuver nearest to one of `YAW_MANEUVER_TIMES`, with these tables throughout."""
    planned = build_flight_schedule(config, 60.0).maneuvers
    flown_day = convert_to_mission_day(YAW_MANEUVER_TIMES[maneuver], config)
    start_s = min((planned_maneuver.start_s for planned_maneuver in planned), key=lambda start: abs(start / DAY - flown_day))
    lead_s = ORBITS_TO_SLEW * config.orbit.period
    return replace(shift_mission_start(config, (start_s - lead_s) / DAY), tables=tables, maneuvers=(YawManeuver(lead_s),))
