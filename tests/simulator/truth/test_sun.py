"""The Sun against ERFA's ephemeris, dates against ERFA's calendar, the shadow against its geometry."""

from datetime import UTC, datetime

import erfa
import numpy as np
import pytest

from simulator.truth.orbit import EARTH_RADIUS
from simulator.truth.sun import DAY, J2000, compute_julian_date, compute_sun_vector, is_eclipsed

STATED = 0.01  # deg, the formula's published precision
LIGHT_TIME = 499.004784 / DAY  # days for one astronomical unit


def erfa_sun(date):
    """Apparent Sun, mean equator and equinox of date: Earth's heliocentric position, aberration, bias and precession."""
    heliocentric, barycentric = erfa.epv00(J2000, date - J2000)
    direction = -heliocentric["p"]
    distance = np.linalg.norm(direction, axis=-1)
    natural = direction / distance[:, None]
    v = barycentric["v"] * LIGHT_TIME  # in units of the speed of light
    proper = np.array([erfa.ab(*row) for row in zip(natural, v, distance, np.sqrt(1 - (v**2).sum(-1)), strict=True)])
    _, _, bias_precession = erfa.bp06(J2000, date - J2000)
    return np.einsum("nij,nj->ni", bias_precession, proper)


def separation(u, v):
    return np.rad2deg(np.arctan2(np.linalg.norm(np.cross(u, v), axis=-1), (u * v).sum(-1)))


def test_the_sun_is_erfas_to_the_stated_precision():
    date = np.arange(compute_julian_date("1950-01-01"), compute_julian_date("2050-01-01"), 11.37)
    error = separation(compute_sun_vector(date), erfa_sun(date))
    # Stated to two decimals; 0.0108 deg at worst over the century, 0.0033 deg RMS.
    assert error.max() < 1.1 * STATED
    assert np.sqrt((error**2).mean()) < 0.004
    assert np.abs(np.linalg.norm(compute_sun_vector(date), axis=1) - 1).max() < 1e-15


@pytest.mark.parametrize("moment", ["1997-11-27T21:27:00", "1998-02-27T00:00:00.25", "2000-01-01T12:00:00", "2016-02-29"])
def test_julian_dates_are_erfas(moment):
    parsed = datetime.fromisoformat(moment)
    first, second = erfa.cal2jd(parsed.year, parsed.month, parsed.day)
    seconds = 3600 * parsed.hour + 60 * parsed.minute + parsed.second + 1e-6 * parsed.microsecond
    for value in (moment, parsed, parsed.replace(tzinfo=UTC), moment + "+00:00"):
        assert compute_julian_date(value) == pytest.approx(first + second + seconds / DAY, abs=1e-9)


def test_the_shadow_of_a_circular_orbit_lasts_as_geometry_says():
    """With the Sun at an angle b to the orbit plane, cos(half arc) = sqrt(1 − (R/a)²) / cos b."""
    a = EARTH_RADIUS + 350e3
    u = np.linspace(0, 2 * np.pi, 360_001)[:-1]
    position = a * np.stack([np.cos(u), np.sin(u), np.zeros_like(u)], axis=-1)
    for b in np.deg2rad([0.0, 30.0, -58.4, 75.0]):
        sun = np.array([np.cos(b), 0.0, np.sin(b)])
        cosine = np.sqrt(1 - (EARTH_RADIUS / a) ** 2) / np.cos(b)
        expected = np.arccos(cosine) / np.pi if cosine < 1 else 0.0
        dark = is_eclipsed(position, sun)
        assert dark.mean() == pytest.approx(expected, abs=1e-5)
        assert not dark[position[:, 0] > 0].any()
