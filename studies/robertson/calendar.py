"""R Table 3's periods, and a mission begun on a later day."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd

from simulator.mission_mode.calendar import sun_angle
from simulator.mission_mode.config import DAY, MissionConfig

PERIODS = ("precalibration", "calibration1", "postcalibration")
FIRST_DAYS = {  # UTC, of R Table 3's periods; each ends where the next one starts but for the last days of February
    "precalibration": ("1997-11-27T21:30:00+00:00", "1997-12-11T12:00:00+00:00"),
    "calibration1": ("1997-12-11T12:00:00+00:00", "1998-02-27T12:00:00+00:00"),
    "postcalibration": ("1998-03-01T00:00:00+00:00", "1998-05-01T00:00:00+00:00"),
}


def moved(config: MissionConfig, days: float) -> MissionConfig:
    """The config so many days later, without maneuvers and uploads, flying with the axis forward that keeps the Sun on −Y."""
    t = days * DAY
    orbit = replace(
        config.orbit,
        node=config.orbit.node + config.orbit.nodal_rate * t,
        latitude_argument=config.orbit.latitude_argument + config.orbit.mean_motion * t,
    )
    epoch = (pd.Timestamp(config.epoch) + pd.Timedelta(days=days)).isoformat()
    ahead = float(sun_angle(config.epoch, config.orbit, t)) > 0
    return replace(config, epoch=epoch, orbit=orbit, forward="+x" if ahead else "-x", maneuvers=(), uploads=())


def day_of(moment: str, config: MissionConfig) -> float:
    """Days from the config's epoch to a moment, UTC."""
    return float((pd.Timestamp(moment) - pd.Timestamp(config.epoch)).total_seconds() / DAY)
