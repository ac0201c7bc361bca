"""The yaw maneuvers of N's intervals 2 and 6 as flights of the Mission Mode."""

from __future__ import annotations

from dataclasses import replace

from simulator.mission_mode.config import DAY, MissionConfig, OnBoardTables, YawManeuver
from simulator.mission_mode.flight import flight_schedule
from studies.robertson.calendar import day_of, moved

MANEUVERS = {"+x to -x": "1997-12-13T13:20:00+00:00", "-x to +x": "1998-01-14T20:57:00+00:00"}  # N Table 1, UTC
ORBITS_TO_SLEW = 4.5  # before the maneuver, for yaw updates to settle


def slew_flight(config: MissionConfig, tables: OnBoardTables, maneuver: str) -> MissionConfig:
    """A run with the yaw maneuver nearest to one of `MANEUVERS`, with these tables throughout."""
    planned = flight_schedule(config, 60.0).maneuvers
    start = min(planned, key=lambda one: abs(one.start_s / DAY - day_of(MANEUVERS[maneuver], config))).start_s
    lead = ORBITS_TO_SLEW * config.orbit.period
    return replace(moved(config, (start - lead) / DAY), tables=tables, maneuvers=(YawManeuver(lead),))
