"""Gyro samples and attitudes of somebody's tables, on one clock and in SI units, before anything is estimated.

A rate column's sample k is the mean over the sample that its tag starts, is the middle of, or ends. The differences of an
accumulated angle are means over the time between two tags exactly, whatever lies between; across a gap there is none.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.importing import units
from gyrocal.importing.column_mapping import Mapping, convert_attitude, parse_spec
from gyrocal.importing.lost_references import leave_out_lost_references

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

UNDATED = "2000-01-01T00:00:00"  # epoch of files without a date
WRAPS = (2.0**16, 2.0**24, 2.0**32, 360.0, 2 * np.pi)
GAP_SAMPLES = 1.5  # samples without a gyro reading
WRAP_TOLERANCE = 0.02  # of a wrap: how near a jump must come to it to be one


@dataclass(frozen=True)
class Sensor:
    """Attitudes by one sensor.

    Attributes
    ----------
    name : of the sensor; empty if there is only one
    t_s : (m,) s since the epoch
    q : (m, 4) A(q), inertial to the sensor's own axes, scalar last
    """

    name: str
    t_s: Array
    q: Array


@dataclass(frozen=True)
class Streams:
    """What the tables hold.

    Attributes
    ----------
    t_s : (n,) starts of the gyro's samples, s since the epoch
    raw : (n, k) rates of the k gyros about their own axes, rad/s
    sample_s : s between samples
    channels : names of the gyros
    sensors : the attitudes, the first sensor's axes being the body's
    epoch, time_scale : as in a recording
    assumed : what was taken for granted, a sentence each
    """

    t_s: Array
    raw: Array
    sample_s: float
    channels: tuple[str, ...]
    sensors: tuple[Sensor, ...]
    epoch: str
    time_scale: str
    assumed: tuple[str, ...]


def read_csv(path: Path) -> pd.DataFrame:
    """Read a CSV table with one or two header rows, its separator found.

    Raises
    ------
    InputError
        It cannot be read.
    """
    from gyrocal.importing.columns import read_two_headers
    from gyrocal.recording import csv_file

    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        headers = read_two_headers(path)
        if headers is not None:
            return csv_file.read(path, skipinitialspace=True, sep=headers[0], skiprows=2, header=None, names=headers[1])
        frame = csv_file.read(path, skipinitialspace=True)
        if frame.shape[1] == 1:
            frame = csv_file.read(path, skipinitialspace=True, sep=None, engine="python")
    except Exception as fault:  # pandas raises a zoo of types for a damaged file
        raise InputError(f"{path}: cannot be read as CSV: {' '.join(str(fault).split())}") from None
    if frame.empty:
        raise InputError(f"{path}: no rows")
    frame.columns = [str(name).strip().removeprefix("#").strip() for name in frame.columns]
    return frame


def read_streams(gyro: pd.DataFrame, attitude: pd.DataFrame, mapping: Mapping) -> Streams:
    """Both tables as the mapping reads them.

    Raises
    ------
    InputError
        A column is missing or does not hold what the mapping says.
    """
    clock_g, raw, channels, assumed = _read_gyro(gyro, mapping)
    named, clocks, said = _read_attitudes(attitude, mapping)
    assumed += said
    clock_g, clocks = _convert_to_one_scale([clock_g, *clocks])
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
        assumed.append(f"{offset:g} s added to the time tags of the attitudes")
    sensors = []
    for (name, q), one in zip(named, clocks, strict=True):
        *ordered, said = _sort_rows(one.subtract(origin) + offset, q, f"attitude {name}".strip())
        sensors.append(Sensor(name, *ordered))
        assumed += said
    t_s, raw, said = _sort_rows(clock_g.subtract(origin), raw, "gyro")
    assumed += said
    t_s, raw, sample_s, said = _build_samples(t_s, raw, mapping)
    assumed += said
    for k, read in enumerate(sensors):
        keep, lost = leave_out_lost_references(read.t_s, read.q, t_s, raw, sample_s, f"attitude {read.name}".strip())
        sensors[k] = Sensor(read.name, read.t_s[keep], read.q[keep])
        assumed += lost
    time_scale = scale or "seconds of the file"
    return Streams(t_s, raw, sample_s, channels, tuple(sensors), epoch, time_scale, tuple(assumed))


def read_gyro_log(gyro: pd.DataFrame, mapping: Mapping) -> Streams:
    """The gyro's table alone, as the mapping reads it."""
    clock, raw, channels, assumed = _read_gyro(gyro, mapping)
    start = int(clock.whole.min()) if clock.scale else 0
    epoch = units.convert_to_date(start, clock.scale).replace(tzinfo=None).isoformat() if clock.scale else UNDATED
    t_s, raw, said = _sort_rows(clock.subtract(start), raw, "gyro")
    t_s, raw, sample_s, more = _build_samples(t_s, raw, mapping)
    time_scale = clock.scale or "seconds of the file"
    return Streams(t_s, raw, sample_s, channels, (), epoch, time_scale, (*assumed, *said, *more))


def _read_gyro(frame: pd.DataFrame, mapping: Mapping) -> tuple[units.Clock, Array, tuple[str, ...], list[str]]:
    names, words = parse_spec(mapping.gyro, "gyro")
    tags, unit = parse_spec(mapping.time, "time")
    if mapping.gyro_by is not None:
        frame, names = _arrange_by_gyro(frame, mapping.gyro_by, tags, names)
    if len(words) != 1:
        raise InputError(f"gyro: {mapping.gyro!r} must have one unit")
    clock, values, assumed = _read_rows(frame, names, "gyro", "gyro", ("time", tags, unit), mapping.gyro_by is None)
    return clock, values, tuple(name.removeprefix("-") for name in names), assumed


def _read_rows(
    frame: pd.DataFrame, names: list[str], key: str, what: str, time: tuple[str, list[str], list[str]], places: bool = True
) -> tuple[units.Clock, Array, list[str]]:
    """Time tags and numbers of the rows that hold numbers, and what is said of the others.

    Parameters
    ----------
    key, what : entry of the mapping, and what is measured
    time : entry of the mapping, columns and unit
    places : whether the rows are those of the table, so that the first left out can be told
    """
    values = read_numbers(frame, names, key)
    good = np.isfinite(values).all(axis=1)
    if key in ("quat", "matrix"):  # zeros are no attitude; loggers write them for one that is missing
        good &= (values != 0).any(axis=1)
    if not good.any():
        raise InputError(f"{key}: no row of {', '.join(names)} holds numbers")
    entry, tags, unit = time
    clock = units.build_clock(_select_columns(frame, tags, entry).iloc[np.flatnonzero(good)], _require_one_unit(unit, entry))
    if good.all():
        return clock, values, []
    zeros = ", or of zeros alone," if np.isfinite(values[~good]).all(axis=1).any() else ""
    first = f", the first of them row {int(frame.index[np.flatnonzero(~good)[0]])}" if places else ""
    return clock, values[good], [f"{int((~good).sum())} {what} row(s) without numbers{zeros} are left out{first}"]


def _arrange_by_gyro(frame: pd.DataFrame, by: str, tags: list[str], names: list[str]) -> tuple[pd.DataFrame, list[str]]:
    """Rows of several gyros as one row a time: a column a gyro, in the order in which they first come."""
    _select_columns(frame, [by, *tags, *names], "gyro")
    if len(names) != 1:
        raise InputError(f"gyro: with gyro_by = {by!r} one column is wanted, not {len(names)}")
    order = [str(name) for name in frame[by].unique()]
    table = frame.assign(**{by: frame[by].astype(str)}).pivot_table(index=tags, columns=by, values=names[0], aggfunc="first")
    return table[order].reset_index(), order


def _read_attitudes(frame: pd.DataFrame, mapping: Mapping) -> tuple[list[tuple[str, Array]], list[units.Clock], list[str]]:
    kind = mapping.attitude
    text = str(getattr(mapping, kind))
    names, _ = parse_spec(text, kind)
    tags, unit = parse_spec(mapping.attitude_time or mapping.time, "attitude_time")
    parts = [("", frame)]
    if mapping.attitude_by is not None:
        _select_columns(frame, [mapping.attitude_by], "attitude")
        parts = [(str(name), part) for name, part in frame.groupby(mapping.attitude_by, sort=False)]
    named, clocks, assumed = [], [], []
    for name, part in parts:
        clock, values, said = _read_rows(part, names, kind, "attitude", ("attitude_time", tags, unit))
        assumed += said
        named.append((name, convert_attitude(kind, text, values)))
        clocks.append(clock)
    return named, clocks, assumed


def read_numbers(frame: pd.DataFrame, names: list[str], what: str) -> Array:
    """Columns (rows, names) as numbers, those with a minus before the name with the other sign."""
    import pandas as pd

    plain = [name.removeprefix("-") if name not in frame.columns else name for name in names]
    sign = [-1.0 if name not in frame.columns else 1.0 for name in names]
    twice = sorted({name for name in plain if plain.count(name) > 1})
    if twice:
        raise InputError(f"{what}: column {', '.join(twice)} is named twice")
    chosen = _select_columns(frame, plain, what)
    for name in plain:
        if not pd.api.types.is_numeric_dtype(chosen[name]) or pd.api.types.is_bool_dtype(chosen[name]):
            raise InputError(f"{what}: column {name} holds {chosen[name].dtype}, not numbers")
    return np.asarray(chosen.to_numpy(dtype=np.float64) * sign)


def _select_columns(frame: pd.DataFrame, names: list[str], what: str) -> pd.DataFrame:
    missing = [name for name in names if name not in frame.columns]
    if missing:
        raise InputError(f"{what}: no column {', '.join(missing)}; there are {', '.join(map(str, frame.columns))}")
    return frame[names]


def _require_one_unit(words: list[str], what: str) -> str:
    if len(words) != 1:
        raise InputError(f"{what}: one unit is wanted, not {':'.join(words)}")
    return words[0]


def _convert_to_one_scale(clocks: list[units.Clock]) -> tuple[units.Clock, list[units.Clock]]:
    """All clocks in one scale: as they are if they share it, otherwise UTC."""
    if len({one.scale for one in clocks}) > 1:
        for what, one in zip(("time", *["attitude_time"] * (len(clocks) - 1)), clocks, strict=True):
            units.expect_date(one, what)
        clocks = [units.convert_to_utc(one) for one in clocks]
    return clocks[0], clocks[1:]


def _parse_epoch(epoch: str, scale: str) -> int:
    """The whole second of a clock in which an epoch is."""
    try:
        return units.convert_to_second(units.parse_date(epoch), scale)
    except ValueError as fault:
        raise InputError(f"epoch: {fault}") from None


def _sort_rows(t_s: Array, values: Array, what: str) -> tuple[Array, Array, list[str]]:
    """Rows in the order of time, each time once, and what is said of those that were not."""
    said = []
    back = np.flatnonzero(np.diff(t_s) < 0) + 1
    if back.size:
        said.append(f"the time goes back {back.size} time(s) in the {what} rows, first to {t_s[back[0]]:.9g} s: put in order")
    order = np.argsort(t_s, kind="stable")
    t_s, values = t_s[order], values[order]
    first = np.concatenate([[True], np.diff(t_s) > 0])
    if first.sum() < 3:
        raise InputError(f"{what}: {int(first.sum())} rows of different times; is the time column right?")
    if not first.all():
        count, begin = int((~first).sum()), float(t_s[~first][0])
        said.append(f"{count} {what} row(s) of a time that another one has are left out, the first at {begin:.9g} s")
    return t_s[first], values[first], said


def _build_samples(t_s: Array, raw: Array, mapping: Mapping) -> tuple[Array, Array, float, list[str]]:
    """Starts, rates and length of the gyro's samples."""
    _, words = parse_spec(mapping.gyro, "gyro")
    factor, accumulated = units.compute_gyro_factor(words[0], mapping.lsb)
    spacing = np.diff(t_s)
    sample_s = float(np.median(spacing))
    if accumulated:
        # How often it wraps in a gap, and what it does there, nobody knows: no sample begins at the last tag before one.
        whole = spacing <= GAP_SAMPLES * sample_s
        step, said = _unwrap_steps(np.diff(raw, axis=0)[whole], mapping.wrap)
        rates = factor * step / spacing[whole, None]
        if not whole.all():
            said.append(f"{int((~whole).sum())} differences over gaps longer than {GAP_SAMPLES:g} samples are left out")
        return t_s[:-1][whole], rates, sample_s, [*said, "rates are differences of accumulated angles"]
    if mapping.wrap is not None:
        raise InputError("wrap: goes with accumulated angles, not with rates")
    late = {"start": 0.0, "middle": 0.5, "end": 1.0}[mapping.tag] * sample_s
    said = [f"a gyro time tag is the {mapping.tag} of its sample"]
    close = np.concatenate([[False], spacing < 0.5 * sample_s])
    if close.any():
        said.append(
            f"{int(close.sum())} gyro row(s) closer than half a sample to the one before are left out, the first at "
            f"{t_s[close][0]:.9g} s"
        )
        t_s, raw = t_s[~close], raw[~close]
    return t_s - late, factor * raw, sample_s, said


def _unwrap_steps(step: Array, wrap: float | None) -> tuple[Array, list[str]]:
    """Differences of an accumulated angle without the jumps at its wrap, which is guessed where it is not given."""
    said: list[str] = []
    if wrap is None:
        typical = max(float(np.median(np.abs(step))), np.finfo(float).tiny)
        jumps = np.abs(step[np.abs(step) > 20 * typical])
        if jumps.size == 0:
            return step, said
        room = [float(np.abs(jumps / one - 1).max()) for one in WRAPS]
        if min(room) > WRAP_TOLERANCE:
            raise InputError(
                f"gyro: the accumulated angle jumps by {jumps.max():.6g}; if it wraps there, say where: --wrap VALUE"
            )
        wrap = WRAPS[int(np.argmin(room))]
        said = [f"the accumulated angle wraps at {wrap:.9g}, as {jumps.size} jumps of it say"]
    return step - wrap * np.round(step / wrap), said
