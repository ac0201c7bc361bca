"""Raw tables of the attitude sensors in a recording: counts, penetration angles, and positions of spacecraft and Sun.

sun_sensor
    t_s, sensor (1, 2, …), count_alpha, count_beta; a row only where the Sun is in view
earth_sensor
    t_s, penetration_1_deg … penetration_4_deg, used_1 … used_4 (true or false)
ephemeris
    t_s, position_x_m, position_y_m, position_z_m from the Earth's centre, sun_x, sun_y, sun_z a unit vector; inertial

An orbit's period, altitude and inclination give neither the position of the spacecraft nor that of the Sun; the ephemeris does,
and has a row for every tag of the two others. A sun_sensor or earth_sensor table with none of these columns but t_s is of
another kind and is not read.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gyrocal.arrays import Array, Indices, Mask
from gyrocal.errors import InputError
from gyrocal.recording.checks import refuse_rows

if TYPE_CHECKING:
    import pandas as pd


SUN_COUNT_COLUMNS = ("count_alpha", "count_beta")
PENETRATIONS = tuple(f"penetration_{i}_deg" for i in range(1, 5))
USED = tuple(f"used_{i}" for i in range(1, 5))
POSITION = ("position_x_m", "position_y_m", "position_z_m")
SUN_DIRECTION_COLUMNS = ("sun_x", "sun_y", "sun_z")
OWN_COLUMNS = {  # of each table: a table with one of them is read as such
    "sun_sensor": ("sensor", *SUN_COUNT_COLUMNS),
    "earth_sensor": (*PENETRATIONS, *USED),
    "ephemeris": ("t_s", *POSITION, *SUN_DIRECTION_COLUMNS),
}
SAME_TIME_S = 1e-6
UNIT = 1e-5  # |s| − 1 of a direction written with six digits
NEAREST_M = 6.3e6  # smallest distance of an orbit from the Earth's centre


@dataclass(frozen=True)
class SunCounts:
    """Counts of sun sensors."""

    t_s: Array  # (n,) s since the epoch, not decreasing
    sensor: NDArray[np.int64]  # (n,) 1, 2, …
    counts: Array  # (n, 2) of the α and the β head

    def select_sensor(self, number: int) -> tuple[Array, Array]:
        """Return times (k,) and counts (k, 2) of one sensor."""
        rows = self.sensor == number
        return self.t_s[rows], self.counts[rows]


@dataclass(frozen=True)
class PenetrationAngles:
    """Angles of an Earth sensor's four quadrants."""

    t_s: Array  # (n,) s since the epoch, increasing
    angles: Array  # (n, 4) rad; of any value where not used
    used: Mask  # (n, 4)


@dataclass(frozen=True)
class Ephemeris:
    """Positions of the spacecraft and directions of the Sun."""

    t_s: Array  # (n,) s since the epoch, increasing
    position: Array  # (n, 3) from the Earth's centre, inertial, m
    sun: Array  # (n, 3) unit vectors, inertial

    def rows(self, t_s: Array) -> Indices:
        """Find the rows of times (k,) of the ephemeris."""
        return np.searchsorted(self.t_s, t_s - SAME_TIME_S)


@dataclass(frozen=True)
class SensorTables:
    """The raw tables of a recording's attitude sensors; None for an absent one.

    An `InputError` if a sensor has a tag that is absent in the ephemeris.
    """

    sun: SunCounts | None = None
    earth: PenetrationAngles | None = None
    ephemeris: Ephemeris | None = None

    def __post_init__(self) -> None:
        if self.ephemeris is None:
            return
        for name, table in (("sun_sensor", self.sun), ("earth_sensor", self.earth)):
            if table is None:
                continue
            rows = np.minimum(self.ephemeris.rows(table.t_s), len(self.ephemeris.t_s) - 1)
            absent = np.flatnonzero(np.abs(self.ephemeris.t_s[rows] - table.t_s) > SAME_TIME_S)
            if absent.size:
                raise InputError(f"ephemeris: no row at t_s = {table.t_s[absent[0]]} of {name} ({absent.size} such)")


def list_known_tables(frames: Mapping[str, pd.DataFrame]) -> tuple[str, ...]:
    """List the names of the tables that `read` reads."""
    return tuple(name for name, columns in OWN_COLUMNS.items() if name in frames and set(columns) & set(frames[name].columns))


def read(frames: Mapping[str, pd.DataFrame]) -> SensorTables | None:
    """Read the sensors' tables among those of a recording; None if there are none."""
    names = list_known_tables(frames)
    if not names:
        return None
    return SensorTables(
        _read_sun(frames["sun_sensor"]) if "sun_sensor" in names else None,
        _read_earth(frames["earth_sensor"]) if "earth_sensor" in names else None,
        _read_ephemeris(frames["ephemeris"]) if "ephemeris" in names else None,
    )


def build_sensor_frames(tables: SensorTables) -> dict[str, pd.DataFrame]:
    """Build the tables as on file."""
    import pandas as pd  # late: 65 MiB that a Monte Carlo worker does without

    out = {}
    if tables.sun is not None:
        sun = tables.sun
        counts = {name: sun.counts[:, k].astype(np.int64) for k, name in enumerate(SUN_COUNT_COLUMNS)}
        out["sun_sensor"] = pd.DataFrame({"t_s": sun.t_s, "sensor": sun.sensor, **counts})
    if tables.earth is not None:
        angles = np.rad2deg(tables.earth.angles)
        columns: dict[str, NDArray[np.generic]] = {"t_s": tables.earth.t_s}
        columns |= {name: angles[:, k] for k, name in enumerate(PENETRATIONS)}
        columns |= {name: tables.earth.used[:, k] for k, name in enumerate(USED)}
        out["earth_sensor"] = pd.DataFrame(columns)
    if tables.ephemeris is not None:
        values = np.column_stack([tables.ephemeris.t_s, tables.ephemeris.position, tables.ephemeris.sun])
        out["ephemeris"] = pd.DataFrame(values, columns=["t_s", *POSITION, *SUN_DIRECTION_COLUMNS])
    return out


def _read_sun(frame: pd.DataFrame) -> SunCounts:
    """Read the counts of the sun sensors; an `InputError` names the first bad row."""
    name = "sun_sensor"
    t_s, sensor = (_read_numbers(frame, name, (column,))[:, 0] for column in ("t_s", "sensor"))
    counts = _read_numbers(frame, name, SUN_COUNT_COLUMNS)
    for column, values in zip(("sensor", *SUN_COUNT_COLUMNS), (sensor, *counts.T), strict=True):
        refuse_rows(name, values != np.round(values), f"{column} is not a whole number")
    refuse_rows(name, (sensor < 1) | (sensor > 2), "sensors are numbered 1 and 2")
    refuse_rows(name, np.diff(t_s, prepend=-np.inf) < 0, "time goes backwards")
    for number in np.unique(sensor):
        rows = np.flatnonzero(sensor == number)
        is_repeated = np.zeros(t_s.size, dtype=bool)
        is_repeated[rows] = np.diff(t_s[rows], prepend=-np.inf) <= 0
        refuse_rows(name, is_repeated, f"sensor {number:g} has two rows of one time")
    return SunCounts(t_s, sensor.astype(np.int64), counts)


def _read_earth(frame: pd.DataFrame) -> PenetrationAngles:
    """Read the penetration angles of the Earth sensor; an `InputError` names the first bad row."""
    name = "earth_sensor"
    t_s = _read_numbers(frame, name, ("t_s",))[:, 0]
    used = _read_numbers(frame, name, USED)
    refuse_rows(name, ((used != 0) & (used != 1)).any(axis=1), "used_1 … used_4 must be true or false")
    flags = used == 1
    angles = np.deg2rad(_read_numbers(frame, name, PENETRATIONS, finite=False))
    refuse_rows(name, (flags & ~np.isfinite(angles)).any(axis=1), "a penetration angle that is used is not a finite number")
    refuse_rows(name, (flags & (np.abs(angles) > np.pi / 2)).any(axis=1), "a penetration angle is beyond 90 deg")
    refuse_rows(name, np.diff(t_s, prepend=-np.inf) <= 0, "time goes backwards or repeats")
    return PenetrationAngles(t_s, angles, flags)


def _read_ephemeris(frame: pd.DataFrame) -> Ephemeris:
    """Read positions and directions of the Sun; an `InputError` names the first bad row."""
    name = "ephemeris"
    t_s = _read_numbers(frame, name, ("t_s",))[:, 0]
    position, sun = _read_numbers(frame, name, POSITION), _read_numbers(frame, name, SUN_DIRECTION_COLUMNS)
    refuse_rows(name, np.diff(t_s, prepend=-np.inf) <= 0, "time goes backwards or repeats")
    below = np.linalg.norm(position, axis=1) < NEAREST_M
    refuse_rows(name, below, f"the position is within {NEAREST_M / 1e3:g} km of the Earth's centre; is the unit metres?")
    refuse_rows(name, np.abs(np.linalg.norm(sun, axis=1) - 1) > UNIT, "sun_x, sun_y, sun_z are not a unit vector")
    return Ephemeris(t_s, position, sun)


def _read_numbers(frame: pd.DataFrame, name: str, columns: tuple[str, ...], finite: bool = True) -> Array:
    """Read columns of a table as numbers (n, columns)."""
    missing = [column for column in columns if column not in frame.columns]
    if missing:
        raise InputError(f"{name}: column {', '.join(missing)} is missing; found {', '.join(map(str, frame.columns))}")
    try:
        values = frame[list(columns)].to_numpy(dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: {', '.join(columns)} must hold numbers") from None
    if finite:
        refuse_rows(name, ~np.isfinite(values).all(axis=1), f"{' or '.join(columns)} is not a finite number")
    return np.asarray(values)
