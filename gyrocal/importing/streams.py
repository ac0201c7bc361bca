"""Gyro samples and attitudes of a user's tables, on one clock and in SI units, before anything is estimated."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.importing import units
from gyrocal.importing.column_mapping import Mapping, convert_attitude, find_name, parse_spec
from gyrocal.importing.gyro_join import JoinedGyros, join_gyros
from gyrocal.importing.gyro_samples import MOST_LOST_SHARE, build_samples, put_on_even_times, read_gyro_rows
from gyrocal.importing.table_rows import read_labels, read_rows, sort_rows

if TYPE_CHECKING:
    import pandas as pd

    from gyrocal.importing.reference_join import SensorReferences

Array = NDArray[np.float64]

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
    from gyrocal.importing.table_layout import find_layout, open_table
    from gyrocal.recording.tables import read_csv_file

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
        frame, lost = _read_mixed_columns(frame, layout.decimal)
    except InputError:
        raise
    except Exception as fault:  # pandas raises a zoo of types for a damaged file
        raise InputError(f"{path}: cannot be read as CSV: {' '.join(str(fault).split())}") from None
    if frame.empty:
        raise InputError(f"{path}: no rows")
    frame.attrs["said"] = tuple(f"{path.name}: {text}" for text in (*layout.said, *lost))
    frame.attrs["head"] = (layout.first_line, str(path))
    return frame


def _read_mixed_columns(frame: pd.DataFrame, decimal: str) -> tuple[pd.DataFrame, list[str]]:
    """The table without rows that repeat the header, words for not-a-number in any spelling as such, and what is said."""
    import pandas as pd

    from gyrocal.importing.table_layout import NOT_A_NUMBER

    mixed = [name for name in frame.columns if not pd.api.types.is_numeric_dtype(frame[name])]
    if not mixed:
        return frame, []
    words = frame[mixed].astype(str).apply(lambda column: column.str.strip())
    again = (words == mixed).all(axis=1) & (len(mixed) == frame.shape[1])  # as in files that were joined
    frame, words = frame[~again].copy(), words[~again]
    for name in mixed:
        lost = words[name].str.fullmatch(NOT_A_NUMBER.pattern, case=False) | frame[name].isna()
        if lost.any() or again.any():
            plain = words[name].mask(lost)
            numbers = pd.to_numeric(plain.str.replace(decimal, "."), errors="coerce")
            frame[name] = numbers if numbers.notna().sum() == plain.notna().sum() else frame[name]
    return frame, [f"{again.sum()} row(s) repeat the header and are left out"] if again.any() else []


def read_streams(gyro: pd.DataFrame, attitude: pd.DataFrame, mapping: Mapping) -> Streams:
    """Both tables as the mapping reads them.

    An `InputError` if a column is missing or does not hold what the mapping says.
    """
    from gyrocal.importing.lost_references import leave_out_lost_references  # late: it loads scipy

    clock_g, raw, channels, G, number, assumed = read_gyro_rows(gyro, mapping)
    temperature = _read_temperature(gyro, mapping, int(clock_g.whole[0]))
    named, clocks, said = _read_attitudes(attitude, mapping)
    layouts = dict.fromkeys(text for table in (gyro, attitude) for text in table.attrs.get("said", ()))
    assumed = [*layouts, *assumed, *said]
    if mapping.common_start or mapping.align == "auto":
        clock_g, clocks = _begin_together(clock_g, clocks, assumed)
    clock_g, clocks = _convert_to_one_scale([clock_g, *clocks], mapping.attitude_offset_s)
    scale = clock_g.scale
    start = min(int(one.whole.min()) for one in (clock_g, *clocks))
    origin = (start if mapping.epoch is None else _parse_epoch(mapping.epoch, scale)) if scale else 0
    if scale:
        epoch = units.convert_to_date(origin, scale).replace(tzinfo=None).isoformat() + ("Z" if scale == "UTC" else "")
    else:
        epoch = mapping.epoch or UNDATED
        assumed.append("the time tags carry no date: the epoch is " + ("the given one" if mapping.epoch else epoch))
    offset = mapping.attitude_offset_s
    if offset:
        assumed.append(f"{offset:.12g} s added to the time tags of the attitudes")
    sensors = []
    for (name, values), one in zip(named, clocks, strict=True):
        times, rows, said = sort_rows(one.subtract(origin) + offset, values, f"attitude {name}".strip())
        sensors.append(_build_sensor(name, times, rows, mapping))
        assumed += said
    t_s, changes = put_on_even_times(clock_g.subtract(origin), raw, number, clock_g.rows, mapping, gyro)
    t_s, raw, sample_s, said = build_samples(t_s, raw, mapping)
    if temperature is not None:
        temperature[:, 0] += clock_g.whole[0] - origin
        temperature[:, 0] = t_s[0] + mapping.time_factor * (temperature[:, 0] - t_s[0])
    t_s, raw, G, joined = _join_gyros(t_s, raw, G, channels, mapping, said)
    for k, sensor in enumerate(sensors):
        keep, lost = leave_out_lost_references(sensor.t_s, sensor.q, t_s, raw, sample_s, f"attitude {sensor.name}".strip())
        sensors[k] = sensor.select_rows(keep)
        said += lost
    time_scale = scale or "seconds of the file"
    assumed = _put_large_losses_first([*changes, *assumed, *said], len(clock_g.whole), sum(len(c.whole) for c in clocks))
    return Streams(t_s, raw, sample_s, G, tuple(sensors), epoch, time_scale, tuple(assumed), temperature, joined)


def read_gyro_log(gyro: pd.DataFrame, mapping: Mapping) -> Streams:
    """The gyro's table alone, as the mapping reads it."""
    clock, raw, channels, G, number, assumed = read_gyro_rows(gyro, mapping)
    start = int(clock.whole.min()) if clock.scale else 0
    epoch = units.convert_to_date(start, clock.scale).replace(tzinfo=None).isoformat() if clock.scale else UNDATED
    t_s, changes = put_on_even_times(clock.subtract(start), raw, number, clock.rows, mapping, gyro)
    t_s, raw, sample_s, said = build_samples(t_s, raw, mapping)
    t_s, raw, G, joined = _join_gyros(t_s, raw, G, channels, mapping, said)
    time_scale = clock.scale or "seconds of the file"
    return Streams(t_s, raw, sample_s, G, (), epoch, time_scale, (*changes, *assumed, *said), gyros=joined)


def _join_gyros(
    t_s: Array, raw: Array, G: Array, names: tuple[str, ...], mapping: Mapping, said: list[str]
) -> tuple[Array, Array, Array, JoinedGyros | None]:
    """Starts and rates (n, 3) of the samples and their G: as they are for three gyros, else of the gyros together."""
    if len(names) == 3:
        return t_s, raw, G, None
    joined = join_gyros(raw, np.linalg.pinv(G), noise=mapping.get_relative_noise(len(names)), names=names)
    kept, whole = np.isfinite(joined.rates).all(axis=1), np.isfinite(raw).all(axis=1)
    if not whole.all():
        said.append(
            f"{int((kept & ~whole).sum())} gyro row(s) in which a gyro is missing use the others; "
            f"{int((~kept).sum())} of fewer than three with independent axes are left out"
        )
    return t_s[kept], joined.rates[kept], np.eye(3), joined


def _read_temperature(frame: pd.DataFrame, mapping: Mapping, start: int) -> Array | None:
    """The column of the gyro's temperature as (m, 2): s since a second of the gyro's clock, and °C."""
    if mapping.temperature is None:
        return None
    tags, unit = parse_spec(mapping.time, "time")
    clock, values, _ = read_rows(frame, [mapping.temperature], "temperature", "gyro", ("time", tags, unit))
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


def _read_attitudes(frame: pd.DataFrame, mapping: Mapping) -> tuple[list[tuple[str, Array]], list[units.Clock], list[str]]:
    kind = mapping.attitude
    text = str(getattr(mapping, kind))
    names, _ = parse_spec(text, kind)
    if isinstance(mapping.sigma_deg, str):
        names = [*names, *_name_sigma_columns(mapping.sigma_deg)]
    tags, unit = parse_spec(mapping.attitude_time or mapping.time, "attitude_time")
    parts, assumed = [("", frame)], list[str]()
    if mapping.attitude_by is not None:
        labels = read_labels(frame, mapping.attitude_by, "attitude_by")
        parts = [(str(name), part) for name, part in frame.groupby(labels, sort=False)]
        missing = int(labels.isna().sum())
        assumed += [f"{missing} attitude row(s) without a sensor in {mapping.attitude_by} are left out"] if missing else []
    if mapping.sensor is not None:
        known = [name for name, _ in parts]
        found = None if mapping.attitude_by is None else find_name(mapping.sensor, known, "sensor", "attitude sensor")
        if found is None:
            there = ", ".join(known) if mapping.attitude_by is not None else "attitude_by names their column"
            raise InputError(f"sensor: no attitude sensor {mapping.sensor}; {there}")
        parts = [(name, part) for name, part in parts if name == found[1]]
    named, clocks = [], []
    for name, part in parts:
        clock, values, said = read_rows(part, names, kind, "attitude", ("attitude_time", tags, unit))
        assumed += said
        named.append((name, values))
        clocks.append(clock)
    return named, clocks, assumed


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


def _convert_to_one_scale(clocks: list[units.Clock], offset_s: float) -> tuple[units.Clock, list[units.Clock]]:
    """All clocks in one scale: as they are if they share it, otherwise UTC, or seconds where an offset joins the two."""
    gyro, *others = clocks
    if len({one.scale for one in clocks}) > 1:
        for what, one in zip(("time", *["attitude_time"] * len(others)), clocks, strict=True):
            units.expect_date(one, what)
        if any(one.scale == "" for one in clocks):
            if len({one.scale == "" for one in others}) > 1 or not offset_s:
                apart = gyro.whole[0] - others[0].whole[0] + gyro.part[0] - others[0].part[0]
                raise InputError(
                    "time: one table has dates and the other seconds from an unknown start; give both the same kind, or the "
                    f"shift of the attitudes' tags: if both tables begin at one time, --attitude-offset {apart:.6f}; "
                    "--align auto finds the offset"
                )
            return replace(gyro, scale=""), [replace(one, scale="") for one in others]
        gyro, *others = [units.convert_to_utc(one) for one in clocks]
    return gyro, others


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


def _parse_epoch(epoch: str, scale: str) -> int:
    """The whole second of a clock in which an epoch is."""
    try:
        return units.convert_to_second(units.parse_date(epoch), scale)
    except ValueError as fault:
        raise InputError(f"epoch: {fault}") from None
