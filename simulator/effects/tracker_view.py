"""What several star trackers see at each reference: how the body turns, how far the boresight has moved, and how fast it flies.

The velocity on the orbit is that of a circular one whose node and argument of latitude at the epoch are stated; its period
is the stated one, and the node stays where it is. That of the Earth about the Sun is the derivative of the Sun's direction,
times an astronomical unit: v = −AU ds/dt. What that leaves out of it, the change of the distance, is 0.5 km/s or 0.3".
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from gyrocal.recording import Recording
from gyrocal.recording.trackers import stack_sensor_axes
from simulator.arrays import Array
from simulator.effects.base import Stream, Trackers
from simulator.truth.orbit import EARTH_RADIUS, MU, CircularOrbit, compute_lvlh_attitude
from simulator.truth.sun import DAY, compute_julian_date, compute_sun_vector

LIGHT = 299792458.0  # m/s
ASTRONOMICAL_UNIT = 1.495978707e11  # m
HALF_DAY = 0.5


def build_trackers(
    recording: Recording, rows: NDArray[np.intp], interval: NDArray[np.intp], stream: Stream, housekeeping: Mapping[str, Array]
) -> Trackers:
    """The trackers at some references.

    Parameters
    ----------
    rows, interval : (m,) those references, of several sensors, and which of the stream's intervals each belongs to
    stream : the body's rates
    housekeeping : columns at those references
    """
    attitudes = recording.attitudes
    assert attitudes.sensor is not None
    t_s, sensor, axes = attitudes.t_s[rows], attitudes.sensor[rows], stack_sensor_axes(attitudes)[rows]
    rates, path = np.zeros((rows.size, 3)), np.zeros(rows.size)
    for number, part in enumerate(stream.intervals):
        own = np.flatnonzero(interval == number)
        if not own.size or part.stop <= part.start:
            continue
        at, turning, dt = stream.t_s[part], stream.rates[part], stream.duration_s[part]
        rates[own] = np.column_stack([np.interp(t_s[own], at, turning[:, k]) for k in range(3)])
        for one in np.unique(sensor[own]):
            mine = own[sensor[own] == one]
            boresight = axes[mine[0]][2]
            across = turning - np.outer(turning @ boresight, boresight)
            moved = np.cumsum(np.linalg.norm(across, axis=1) * dt)
            path[mine] = np.interp(t_s[mine], at + 0.5 * dt, moved)
    names = tuple(one.name for one in attitudes.sensors)
    return Trackers(
        names,
        sensor,
        axes,
        rates,
        path,
        compute_orbital_velocity(recording, t_s),
        compute_annual_velocity(recording, t_s),
        housekeeping,
    )


def compute_orbital_velocity(recording: Recording, t_s: Array) -> Array:
    """(m, 3) velocity on the orbit in units of that of light; NaN where it is not stated where on it the epoch is."""
    orbit = recording.orbit
    if orbit is None or orbit.raan_deg is None or orbit.argument_of_latitude_deg is None:
        return np.full((t_s.size, 3), np.nan)
    rate = 2 * np.pi / orbit.period_s
    radius = float(np.cbrt(MU / rate**2))
    angles = np.deg2rad([orbit.inclination_deg, orbit.raan_deg, orbit.argument_of_latitude_deg])
    flown = CircularOrbit(radius - EARTH_RADIUS, *angles)
    return np.asarray(rate * radius / LIGHT * compute_lvlh_attitude(flown, t_s)[:, 0])


def compute_annual_velocity(recording: Recording, t_s: Array) -> Array:
    """(m, 3) velocity of the Earth about the Sun in units of that of light."""
    days = compute_julian_date(recording.epoch) + t_s / DAY
    moved = compute_sun_vector(days + HALF_DAY) - compute_sun_vector(days - HALF_DAY)
    return np.asarray(-ASTRONOMICAL_UNIT / LIGHT / (2 * HALF_DAY * DAY) * moved)
