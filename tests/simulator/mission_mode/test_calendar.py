import numpy as np
import pandas as pd

from simulator.mission_mode.calendar import compute_sun_angle, find_plane_crossings
from simulator.mission_mode.config import MissionConfig
from simulator.mission_mode.flight import build_flight_schedule
from simulator.truth.orbit import CircularOrbit
from simulator.truth.sun import DAY

CONFIG = MissionConfig()


def days(moments):
    return pd.DatetimeIndex(pd.Timestamp(CONFIG.epoch) + pd.to_timedelta(moments, unit="s"))


def test_yaw_maneuvers_of_the_flight():
    """The node is set by December 13 (N Table 1). January 14 (N) and March 21 (R) follow, six maneuvers until then."""
    moments = days(find_plane_crossings(CONFIG.epoch, CONFIG.orbit, 120.0))
    assert len(moments) == 6
    flight = pd.DatetimeIndex(["1997-12-13T13:20Z", "1998-01-14T20:57Z", "1998-03-21T12:00Z"])
    gaps = np.abs((moments[[1, 2, 5]] - flight) / pd.Timedelta(days=1))
    assert gaps.max() < 0.6
    weeks = np.diff(moments) / pd.Timedelta(days=7)
    assert 1.5 < weeks.min() < weeks.max() < 5.0  # R: every few weeks
    # Negative control: another node meets none of the later days.
    other = CircularOrbit(350e3, np.deg2rad(35.0), node=np.deg2rad(152.0), j2=True)
    assert np.abs(days(find_plane_crossings(CONFIG.epoch, other, 120.0)) - flight[2]).min() > pd.Timedelta(days=5)


def test_the_sun_stays_on_its_side():
    """R: between 0° and 58.4° from the XZ plane, toward −Y; without maneuvers (negative control) it does not."""
    config = build_flight_schedule(CONFIG, 400.0)
    t = np.arange(0.0, 400 * DAY, 1800.0)
    swaps = np.searchsorted([m.start_s + 0.5 * m.duration_s for m in config.maneuvers], t)
    sign = np.where((swaps + (config.forward == "-x")) % 2 == 0, 1.0, -1.0)
    beta = np.rad2deg(compute_sun_angle(config.epoch, config.orbit, t))
    # A crossing lies within half a step of its maneuver's middle as far as the linear search goes.
    assert (sign * beta).min() > -0.05
    assert 55.0 < np.abs(beta).max() < 58.45
    assert beta.min() < -50
