"""The calendar of yaw maneuvers, and the magnetic field with its sidereal time, against published dates and numbers."""

import numpy as np
import pandas as pd
import pytest

from simulator.mission_mode.calendar import find_plane_crossings
from simulator.mission_mode.config import MissionConfig
from simulator.mission_mode.magnetic_field import (
    DIPOLE,
    REFERENCE_RADIUS,
    compute_dipole_field,
    compute_sidereal_angle,
)
from simulator.truth.orbit import CircularOrbit

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


def field(position, angle=0.0):
    return np.array(compute_dipole_field(*position, angle, DIPOLE))


def test_published_geomagnetic_pole():
    """1995 centred dipole: 79.32° N, 71.42° W, as tabulated from the reference field by Woods Hole."""
    x, y, z = -DIPOLE / np.linalg.norm(DIPOLE)
    assert np.rad2deg(np.arcsin(z)) == pytest.approx(79.32, abs=0.005)
    assert np.rad2deg(np.arctan2(y, x)) == pytest.approx(-71.42, abs=0.005)


def test_along_the_axis_it_is_twice_that_across():
    """|B| = B₀ (a/r)³ sqrt(1 + 3 sin²λ) at the magnetic latitude λ; at the northern pole B points down."""
    axis = -DIPOLE / np.linalg.norm(DIPOLE)
    across = np.cross(axis, [1.0, 0.0, 0.0]) / np.linalg.norm(np.cross(axis, [1.0, 0.0, 0.0]))
    for latitude in (0.0, 0.4, np.pi / 2):
        r = 1.06 * REFERENCE_RADIUS * (np.cos(latitude) * across + np.sin(latitude) * axis)
        expected = np.linalg.norm(DIPOLE) / 1.06**3 * np.sqrt(1 + 3 * np.sin(latitude) ** 2)
        assert np.linalg.norm(field(r)) == pytest.approx(expected, rel=1e-12)
    assert field(REFERENCE_RADIUS * axis) @ axis < 0


def test_published_sidereal_time():
    """Meeus, example 12.a: 1987 April 10, 0h UT, 13h 10m 46.3668s; his T² term there is 6e-6°."""
    assert np.rad2deg(compute_sidereal_angle(2446895.5)) == pytest.approx(15 * (13 + 10 / 60 + 46.3668 / 3600), abs=1e-4)
