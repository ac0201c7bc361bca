"""Gyro samples and attitudes of a user's tables, on one clock and in SI units, before anything is estimated."""

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
        """The attitudes of some rows."""
        sigma, angles = (None if one is None else one[rows] for one in (self.sigma, self.angles))
        return Sensor(self.name, self.t_s[rows], self.q[rows], sigma, angles)


@dataclass(frozen=True)
class Streams:
    """What the tables hold."""

    t_s: Array  # (n,) starts of the gyro's samples, s since the epoch
    raw: Array  # (n, 3) rates of three gyros about their own axes, or about those of the body by more gyros, rad/s
    sample_s: float  # s between samples
    G: Array  # (3, 3) of the rates as the gyros' axes are stated, ω = G ω_raw + b
    sensors: tuple[Sensor, ...]  # the attitudes, the first sensor's axes being the body's
    # epoch, time_scale: as in a recording
    epoch: str
    time_scale: str
    assumed: tuple[str, ...]  # what was taken for granted, a sentence each
    temperature: Array | None = None  # (m, 2) s since the epoch, and the gyro's °C
    gyros: JoinedGyros | None = None  # more than three, whose rates are joined


@dataclass(frozen=True)
class BodyAttitudes:
    """Attitudes of the body as far as an import asks of its motion."""

    # t_s, q: (m,) s and (m, 4) inertial to body, scalar last
    t_s: Array
    q: Array
    # where there are several, each one's attitudes with what is known of its noise and mounting
    sensors: tuple[SensorReferences, ...] = ()


def read_csv(path: Path) -> pd.DataFrame:
    """Read a text table, whose layout is found; `attrs` has what is said of it.

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
    frame.attrs["said"] = tuple(f"{path.name}: {text}" for text in layout.said)
    frame.attrs["head"] = (layout.first_line, str(path))
    return frame


def _read_not_a_number(frame: pd.DataFrame, decimal: str) -> pd.DataFrame:
    """The table with words for not-a-number, in any spelling, as such."""
    frame = frame.copy()
    for name in frame.columns:
        if pd.api.types.is_numeric_dtype(frame[name]):
            continue
        words = frame[name].astype(str).str.strip()
        lost = words.str.fullmatch(NOT_A_NUMBER.pattern, case=False) | frame[name].isna()
        plain = words.mask(lost)
        numbers = pd.to_numeric(plain.str.replace(decimal, "."), errors="coerce")
        if lost.any() and numbers.notna().sum() == plain.notna().sum():
            frame[name] = numbers
    return frame


def read_streams(gyro: pd.DataFrame, attitude: pd.DataFrame | None, mapping: Mapping) -> Streams:
    """Read both tables, or the gyro's alone, as the mapping says.

    An `InputError` if a column is missing or does not hold what the mapping says.
    """
    tables = () if attitude is None else (gyro, attitude)
    said = list(dict.fromkeys(text for table in tables for text in table.attrs.get("said", ())))
    rows = read_gyro_rows(gyro, mapping, said)
    clock, offset = rows.clock, mapping.attitude_offset_s
    temperature = _read_temperature(gyro, mapping, int(clock.whole[0]))
    named, clocks = ([], []) if attitude is None else _read_attitudes(attitude, mapping, said)
    if clocks and (mapping.common_start or mapping.align == "auto"):
        clock, clocks = _begin_together(clock, clocks, said)
    clock, *clocks = _convert_to_one_scale([clock, *clocks], offset)
    epoch, origin = _choose_epoch([clock, *clocks], None if attitude is None else mapping.epoch)
    if attitude is not None and not clock.scale:
        said.append("the time tags carry no date: the epoch is " + ("the given one" if mapping.epoch else epoch))
    if offset and attitude is not None:
        said.append(f"{offset:.12g} s added to the time tags of the attitudes")
    sensors = []
    for (name, values), one in zip(named, clocks, strict=True):
        times, values = sort_rows(one.subtract(origin) + offset, values, f"attitude {name}".strip(), said)
        sensors.append(_build_sensor(name, times, values, mapping))
    t_s, raw, sample_s, G, joined = build_samples(rows._replace(clock=clock), origin, mapping, gyro, said)
    if temperature is not None:
        temperature[:, 0] += clock.whole[0] - origin
        temperature[:, 0] = t_s[0] + mapping.time_factor * (temperature[:, 0] - t_s[0])
    for k, sensor in enumerate(sensors):
        what = f"attitude {sensor.name}".strip()
        sensors[k] = sensor.select_rows(leave_out_lost_references(sensor.t_s, sensor.q, t_s, raw, sample_s, what, said))
    if attitude is not None:
        said = _put_large_losses_first(said, len(clock.whole), sum(len(one.whole) for one in clocks))
    time_scale = clock.scale or "seconds of the file"
    return Streams(t_s, raw, sample_s, G, tuple(sensors), epoch, time_scale, tuple(said), temperature, joined)


def _choose_epoch(clocks: list[units.Clock], stated: str | None) -> tuple[str, int]:
    """The epoch of a recording, and the whole second of the clocks that it is."""
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
    """The column of the gyro's temperature as (m, 2): s since a second of the gyro's clock, and °C."""
    if mapping.temperature is None:
        return None
    clock, values = read_rows(frame, [mapping.temperature], "temperature", "gyro", ("time", mapping.time), [])
    return np.column_stack([clock.subtract(start), values])


def _put_large_losses_first(said: list[str], gyro_rows: int, attitude_rows: int) -> list[str]:
    """What is said, rows that are left out or filled first where they are more than a percent."""
    first = []
    for text in said:
        found = re.match(r"(\d+) (gyro|attitude)\b.* (left out|filled)", text)
        rows = gyro_rows if found and found[2] == "gyro" else attitude_rows
        if found and int(found[1]) > MOST_LOST_SHARE * rows:
            first.append(f"{100 * int(found[1]) / rows:.2g} % of the {found[2]} rows: {text}")
    kept = [text for text in said if not any(one.endswith(f": {text}") for one in first)]
    return [*first, *kept]


def _read_attitudes(
    frame: pd.DataFrame, mapping: Mapping, said: list[str]
) -> tuple[list[tuple[str, Array]], list[units.Clock]]:
    """Name and numbers of each attitude sensor, and its time tags."""
    kind = mapping.attitude
    names, _ = parse_spec(str(getattr(mapping, kind)), kind)
    if isinstance(mapping.sigma_deg, str):
        names = [*names, *_name_sigma_columns(mapping.sigma_deg)]
    parts = [("", frame)]
    if mapping.attitude_by is not None:
        labels = read_labels(frame, mapping.attitude_by, "attitude_by")
        parts = [(str(name), part) for name, part in frame.groupby(labels, sort=False)]
        if missing := int(labels.isna().sum()):
            said.append(f"{missing} attitude row(s) without a sensor in {mapping.attitude_by} are left out")
    if mapping.sensor is not None:
        known = [name for name, _ in parts]
        found = None if mapping.attitude_by is None else find_name(mapping.sensor, known, "sensor", "attitude sensor")
        if found is None:
            there = ", ".join(known) if mapping.attitude_by is not None else "attitude_by names their column"
            raise InputError(f"sensor: no attitude sensor {mapping.sensor}; {there}")
        parts = [(name, part) for name, part in parts if name == found[1]]
    named, clocks = [], []
    for name, part in parts:
        clock, values = read_rows(part, names, kind, "attitude", ("attitude_time", mapping.attitude_time or mapping.time), said)
        named.append((name, values))
        clocks.append(clock)
    return named, clocks


def _name_sigma_columns(text: str) -> list[str]:
    names = [name.strip() for name in text.split(",")]
    if len(names) not in (1, 3) or not all(names):
        raise InputError(f"sigma_deg: {text!r} is not a number, three numbers, a column of the attitudes' table, or three")
    return names


def _build_sensor(name: str, t_s: Array, values: Array, mapping: Mapping) -> Sensor:
    """A sensor of the numbers of its rows: the attitude, then its sigma where columns hold it."""
    kind = mapping.attitude
    text = str(getattr(mapping, kind))
    sigma = None
    if isinstance(mapping.sigma_deg, str):
        count = len(_name_sigma_columns(mapping.sigma_deg))
        values, own = values[:, :-count], values[:, -count:]
        if not (own > 0).all():
            raise InputError(f"sigma_deg: {int((own <= 0).sum())} value(s) of {mapping.sigma_deg} are not positive")
        sigma = np.deg2rad(np.broadcast_to(own, (len(own), 3)))
    return Sensor(name, t_s, convert_attitude(kind, text, values), sigma, values if kind == "euler" else None)


def _convert_to_one_scale(clocks: list[units.Clock], offset_s: float) -> list[units.Clock]:
    """All clocks in one scale: as they are if they share it, otherwise UTC, or seconds where an offset joins the two."""
    if len({one.scale for one in clocks}) == 1:
        return clocks
    gyro, *others = clocks
    if all(one.scale for one in clocks):
        return [units.convert_to_utc(one) for one in clocks]
    if len({one.scale == "" for one in others}) > 1 or not offset_s:
        apart = gyro.whole[0] - others[0].whole[0] + gyro.part[0] - others[0].part[0]
        raise InputError(
            "time: one table has dates and the other seconds from an unknown start, unless its unit is ms, us or ns of unix "
            "time; give both the same kind, or the "
            f"shift of the attitudes' tags: if both tables begin at one time, --attitude-offset {apart:.6f}; "
            "--align auto finds the offset"
        )
    return [replace(clock, scale="") for clock in clocks]


def _begin_together(gyro: units.Clock, others: list[units.Clock], said: list[str]) -> tuple[units.Clock, list[units.Clock]]:
    """Clocks of which that without a date is shifted to begin with the other."""
    scales = {one.scale for one in others}
    if len(scales) != 1 or bool(gyro.scale) == bool(next(iter(scales))):
        return gyro, others
    first = min(int(one.whole.min()) for one in others) - int(gyro.whole.min())
    said.append(f"only one table has dates: {abs(first)} s are added to the other's time tags, so that both begin together")
    if gyro.scale:
        return gyro, [replace(one, whole=one.whole - first, scale=gyro.scale) for one in others]
    return replace(gyro, whole=gyro.whole + first, scale=others[0].scale), others
