"""Gyro samples and attitudes of a user's tables, on one clock and in SI units, before the estimates."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gyrocal.arrays import Array
from gyrocal.errors import InputError
from gyrocal.importing import units
from gyrocal.importing.column_mapping import Mapping, convert_attitude, find_name, parse_spec
from gyrocal.importing.gyro_join import JoinedGyros
from gyrocal.importing.gyro_samples import MOST_LOST_SHARE, build_samples, read_gyro_rows
from gyrocal.importing.table_layout import NOT_A_NUMBER, find_layout, open_table
from gyrocal.importing.table_rows import read_labels, read_rows, sort_rows
from gyrocal.masking.lost_references import leave_out_lost_references
from gyrocal.recording.tables import read_csv_file

if TYPE_CHECKING:
    from gyrocal.importing.reference_join import SensorReferences


UNDATED = "2000-01-01T00:00:00"  # epoch of files without a date


@dataclass(frozen=True)
class Sensor:
    """Attitudes by one sensor."""

    name: str  # of the sensor; empty if there is only one
    t_s: Array  # (m,) s since the epoch
    q: Array  # (m, 4) A(q), inertial to the sensor's own axes, scalar last
    sigma: Array | None = None  # (m, 3) 1-sigma about the sensor's own axes, rad, of columns of the table
    angles: Array | None = None  # (m, 3) Euler angles as they are on file

    def select_rows(self, rows: NDArray[Any]) -> Sensor:
        """Select the attitudes of some rows."""
        sigma, angles = (None if column is None else column[rows] for column in (self.sigma, self.angles))
        return Sensor(self.name, self.t_s[rows], self.q[rows], sigma, angles)


@dataclass(frozen=True)
class Streams:
    """Gyro samples and attitudes of the tables."""

    t_s: Array  # (n,) starts of the gyro's samples, s since the epoch
    raw: Array  # (n, 3) rates of three gyros about their own axes, or about those of the body by more gyros, rad/s
    sample_s: float  # s between samples
    G: Array  # (3, 3) of the rates as the gyros' axes are stated, ω = G ω_raw + b
    sensors: tuple[Sensor, ...]  # the attitudes, the first sensor's axes being the body's
    # epoch, time_scale: as in a recording
    epoch: str
    time_scale: str
    assumed: tuple[str, ...]  # assumptions, a sentence each
    temperature: Array | None = None  # (m, 2) s since the epoch, and the gyro's °C
    gyros: JoinedGyros | None = None  # more gyros than three, whose rates are joined


@dataclass(frozen=True)
class BodyAttitudes:
    """Attitudes of the body by all sensors, for the motion of the body."""

    # t_s, q: (m,) s and (m, 4) inertial to body, scalar last
    t_s: Array
    q: Array
    sensors: tuple[SensorReferences, ...] = ()  # the attitudes of each of several sensors; empty for a single one


def read_csv(path: Path) -> pd.DataFrame:
    """Read a text table; its attribute `attrs` has notes on the layout that was found.

    An `InputError` if it cannot be read.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        layout = find_layout(path)
        with open_table(path) as file:
            frame = read_csv_file(
                file,
                sep=layout.separator,
                encoding=layout.encoding,
                decimal=layout.decimal,
                skipinitialspace=True,
                skiprows=layout.first_line,
                header=None,
                names=layout.names,
            )
        frame = _read_not_a_number(frame, layout.decimal)
    except InputError:
        raise
    except Exception as fault:  # pandas raises a zoo of types for a damaged file
        raise InputError(f"{path}: cannot be read as CSV: {' '.join(str(fault).split())}") from None
    if frame.empty:
        raise InputError(f"{path}: no rows")
    frame.attrs["notes"] = tuple(f"{path.name}: {text}" for text in layout.notes)
    frame.attrs["head"] = (layout.first_line, str(path))
    return frame


def _read_not_a_number(frame: pd.DataFrame, decimal: str) -> pd.DataFrame:
    """Replace words for not-a-number, in any spelling, in the columns of a table that otherwise hold numbers."""
    frame = frame.copy()
    for name in frame.columns:
        if pd.api.types.is_numeric_dtype(frame[name]):
            continue
        words = frame[name].astype(str).str.strip()
        is_missing = words.str.fullmatch(NOT_A_NUMBER.pattern, case=False) | frame[name].isna()
        plain = words.mask(is_missing)
        numbers = pd.to_numeric(plain.str.replace(decimal, "."), errors="coerce")
        if is_missing.any() and numbers.notna().sum() == plain.notna().sum():
            frame[name] = numbers
    return frame


def read_streams(gyro: pd.DataFrame, attitude: pd.DataFrame | None, mapping: Mapping) -> Streams:
    """Read both tables, or the gyro's alone, as the mapping says.

    An `InputError` if a column is missing or does not hold what the mapping says.
    """
    tables = () if attitude is None else (gyro, attitude)
    notes = list(dict.fromkeys(text for table in tables for text in table.attrs.get("notes", ())))
    rows = read_gyro_rows(gyro, mapping, notes)
    clock, offset = rows.clock, mapping.attitude_offset_s
    temperature = _read_temperature(gyro, mapping, int(clock.whole[0]))
    named, clocks = ([], []) if attitude is None else _read_attitudes(attitude, mapping, notes)
    if clocks and (mapping.common_start or mapping.align == "auto"):
        clock, clocks = _begin_together(clock, clocks, notes)
    clock, *clocks = _convert_to_one_scale([clock, *clocks], offset)
    epoch, origin = _choose_epoch([clock, *clocks], None if attitude is None else mapping.epoch)
    if attitude is not None and not clock.scale:
        notes.append("the time tags carry no date: the epoch is " + ("the given one" if mapping.epoch else epoch))
    if offset and attitude is not None:
        notes.append(f"{offset:.12g} s added to the time tags of the attitudes")
    sensors = []
    for (name, values), sensor_clock in zip(named, clocks, strict=True):
        times, values = sort_rows(sensor_clock.subtract(origin) + offset, values, f"attitude {name}".strip(), notes)
        sensors.append(_build_sensor(name, times, values, mapping))
    samples = build_samples(rows._replace(clock=clock), origin, mapping, gyro, notes)
    if temperature is not None:
        temperature[:, 0] += clock.whole[0] - origin
        temperature[:, 0] = samples.t_s[0] + mapping.time_factor * (temperature[:, 0] - samples.t_s[0])
    for k, sensor in enumerate(sensors):
        what = f"attitude {sensor.name}".strip()
        is_measured = leave_out_lost_references(sensor.t_s, sensor.q, samples.t_s, samples.rates, samples.sample_s, what, notes)
        sensors[k] = sensor.select_rows(is_measured)
    if attitude is not None:
        notes = _put_large_losses_first(notes, len(clock.whole), sum(len(sensor_clock.whole) for sensor_clock in clocks))
    t_s, rates, sample_s, G, joined = samples
    time_scale = clock.scale or "seconds of the file"
    return Streams(t_s, rates, sample_s, G, tuple(sensors), epoch, time_scale, tuple(notes), temperature, joined)


def _choose_epoch(clocks: list[units.Clock], stated: str | None) -> tuple[str, int]:
    """Choose the epoch of a recording; return it as a date, and as a whole second of the clocks."""
    scale = clocks[0].scale
    if not scale:
        return stated or UNDATED, 0
    try:
        first = min(int(clock.whole.min()) for clock in clocks)
        origin = first if stated is None else units.convert_to_second(units.parse_date(stated), scale)
    except ValueError as fault:
        raise InputError(f"epoch: {fault}") from None
    return units.convert_to_date(origin, scale).replace(tzinfo=None).isoformat() + ("Z" if scale == "UTC" else ""), origin


def _read_temperature(frame: pd.DataFrame, mapping: Mapping, start: int) -> Array | None:
    """Read the column of the gyro's temperature as (m, 2): s since a second of the gyro's clock, and °C."""
    if mapping.temperature is None:
        return None
    clock, values = read_rows(frame, [mapping.temperature], "temperature", "gyro", ("time", mapping.time), [])
    return np.column_stack([clock.subtract(start), values])


def _put_large_losses_first(notes: list[str], gyro_rows: int, attitude_rows: int) -> list[str]:
    """Order the notes: those of rows that are left out or filled come first if these are more than a percent."""
    first = []
    for text in notes:
        loss = re.match(r"(\d+) (gyro|attitude)\b.* (left out|filled)", text)
        rows = gyro_rows if loss and loss[2] == "gyro" else attitude_rows
        if loss and int(loss[1]) > MOST_LOST_SHARE * rows:
            first.append(f"{100 * int(loss[1]) / rows:.2g} % of the {loss[2]} rows: {text}")
    others = [text for text in notes if not any(headed.endswith(f": {text}") for headed in first)]
    return [*first, *others]


def _read_attitudes(
    frame: pd.DataFrame, mapping: Mapping, notes: list[str]
) -> tuple[list[tuple[str, Array]], list[units.Clock]]:
    """Read name and numbers (m, columns) of each attitude sensor, and its time tags."""
    kind = mapping.attitude
    names, _ = parse_spec(str(getattr(mapping, kind)), kind)
    if isinstance(mapping.sigma_deg, str):
        names = [*names, *_name_sigma_columns(mapping.sigma_deg)]
    parts = [("", frame)]
    if mapping.attitude_by is not None:
        labels = read_labels(frame, mapping.attitude_by, "attitude_by")
        parts = [(str(name), part) for name, part in frame.groupby(labels, sort=False)]
        if missing := int(labels.isna().sum()):
            notes.append(f"{missing} attitude row(s) without a sensor in {mapping.attitude_by} are left out")
    if mapping.sensor is not None:
        known = [name for name, _ in parts]
        choice = None if mapping.attitude_by is None else find_name(mapping.sensor, known, "sensor", "attitude sensor")
        if choice is None:
            listed = ", ".join(known) if mapping.attitude_by is not None else "attitude_by names their column"
            raise InputError(f"sensor: no attitude sensor {mapping.sensor}; {listed}")
        parts = [(name, part) for name, part in parts if name == choice[1]]
    named, clocks = [], []
    time = ("attitude_time", mapping.attitude_time or mapping.time)
    for name, part in parts:
        clock, values = read_rows(part, names, kind, "attitude", time, notes)
        named.append((name, values))
        clocks.append(clock)
    return named, clocks


def _name_sigma_columns(text: str) -> list[str]:
    """Split the entry sigma_deg into the names of one column or three."""
    names = [name.strip() for name in text.split(",")]
    if len(names) not in (1, 3) or not all(names):
        raise InputError(f"sigma_deg: {text!r} is not a number, three numbers, a column of the attitudes' table, or three")
    return names


def _build_sensor(name: str, t_s: Array, values: Array, mapping: Mapping) -> Sensor:
    """Build a sensor of the numbers of its rows: the attitude, then its sigma if the mapping names columns of it."""
    kind = mapping.attitude
    text = str(getattr(mapping, kind))
    sigma = None
    if isinstance(mapping.sigma_deg, str):
        count = len(_name_sigma_columns(mapping.sigma_deg))
        values, sigma_deg = values[:, :-count], values[:, -count:]
        if not (sigma_deg > 0).all():
            raise InputError(f"sigma_deg: {int((sigma_deg <= 0).sum())} value(s) of {mapping.sigma_deg} are not positive")
        sigma = np.deg2rad(np.broadcast_to(sigma_deg, (len(sigma_deg), 3)))
    return Sensor(name, t_s, convert_attitude(kind, text, values), sigma, values if kind == "euler" else None)


def _convert_to_one_scale(clocks: list[units.Clock], offset_s: float) -> list[units.Clock]:
    """Convert clocks to one scale: unchanged if they share it, otherwise UTC, or seconds if the mapping states an offset."""
    if len({clock.scale for clock in clocks}) == 1:
        return clocks
    gyro, *others = clocks
    if all(clock.scale for clock in clocks):
        return [units.convert_to_utc(clock) for clock in clocks]
    if len({clock.scale == "" for clock in others}) > 1 or not offset_s:
        shift_s = gyro.whole[0] - others[0].whole[0] + gyro.part[0] - others[0].part[0]
        raise InputError(
            "time: one table has dates and the other seconds from an unknown start, unless its unit is ms, us or ns of unix "
            "time; give both the same kind, or the "
            f"shift of the attitudes' tags: if both tables begin at one time, --attitude-offset {shift_s:.6f}; "
            "--align auto finds the offset"
        )
    return [replace(clock, scale="") for clock in clocks]


def _begin_together(gyro: units.Clock, others: list[units.Clock], notes: list[str]) -> tuple[units.Clock, list[units.Clock]]:
    """Shift the clock without a date so that it begins with the clock with dates; unchanged if both are of one kind."""
    scales = {clock.scale for clock in others}
    if len(scales) != 1 or bool(gyro.scale) == bool(next(iter(scales))):
        return gyro, others
    first = min(int(clock.whole.min()) for clock in others) - int(gyro.whole.min())
    notes.append(f"only one table has dates: {abs(first)} s are added to the other's time tags, so that both begin together")
    if gyro.scale:
        return gyro, [replace(clock, whole=clock.whole - first, scale=gyro.scale) for clock in others]
    return replace(gyro, whole=gyro.whole + first, scale=others[0].scale), others
