"""Gyro samples and attitudes of somebody's tables, on one clock and in SI units, before anything is estimated.

A rate column's sample k is the mean over the sample that its tag starts, is the middle of, or ends. The differences of an
accumulated angle are means over the time between two tags exactly, whatever lies between; across a gap there is none.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.importing import units
from gyrocal.importing.column_mapping import Mapping, convert_attitude, parse_spec
from gyrocal.importing.time_base import fit_even_times, is_uneven

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

UNDATED = "2000-01-01T00:00:00"  # epoch of files without a date
WRAPS = (2.0**16, 2.0**24, 2.0**32, 360.0, 2 * np.pi)
GAP_SAMPLES = 1.5  # samples without a gyro reading
MOST_FILLED_SAMPLES = 2  # lost in a row that are filled
MOST_LOST_SHARE = 0.01  # of the rows; more that are lost or changed are said first
MOST_SWAPPED_ROWS = 4  # by which the tags go back where rows are tagged late; farther back, rows are out of order
MOST_LABELS = 16  # values of a column that says which gyro a row is of
WRAP_TOLERANCE = 0.02  # of a wrap: how near a jump must come to it to be one


@dataclass(frozen=True)
class Sensor:
    """Attitudes by one sensor.

    Attributes
    ----------
    name : of the sensor; empty if there is only one
    t_s : (m,) s since the epoch
    q : (m, 4) A(q), inertial to the sensor's own axes, scalar last
    sigma : (m, 3) 1-sigma about the sensor's own axes, rad, of columns of the table
    angles : (m, 3) Euler angles as they are on file
    """

    name: str
    t_s: Array
    q: Array
    sigma: Array | None = None
    angles: Array | None = None

    def select_rows(self, rows: NDArray[Any]) -> Sensor:
        """The attitudes of some rows."""
        sigma, angles = (None if one is None else one[rows] for one in (self.sigma, self.angles))
        return Sensor(self.name, self.t_s[rows], self.q[rows], sigma, angles)


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
    """Read a text table, whose layout is found; `attrs` has what is said of it.

    Raises
    ------
    InputError
        It cannot be read.
    """
    from gyrocal.importing.table_layout import find_layout
    from gyrocal.recording import csv_file

    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        layout = find_layout(path)
        frame = csv_file.read(
            path,
            sep=layout.separator,
            encoding=layout.encoding,
            decimal=layout.decimal,
            skipinitialspace=True,
            skiprows=layout.first_line,
            header=None,
            names=layout.names,
        )
    except InputError:
        raise
    except Exception as fault:  # pandas raises a zoo of types for a damaged file
        raise InputError(f"{path}: cannot be read as CSV: {' '.join(str(fault).split())}") from None
    if frame.empty:
        raise InputError(f"{path}: no rows")
    frame.attrs["said"] = tuple(f"{path.name}: {text}" for text in layout.said)
    return frame


def read_streams(gyro: pd.DataFrame, attitude: pd.DataFrame, mapping: Mapping) -> Streams:
    """Both tables as the mapping reads them.

    Raises
    ------
    InputError
        A column is missing or does not hold what the mapping says.
    """
    from gyrocal.importing.lost_references import leave_out_lost_references  # late: it loads scipy

    clock_g, raw, channels, number, assumed = _read_gyro(gyro, mapping)
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
        times, rows, said = _sort_rows(one.subtract(origin) + offset, values, f"attitude {name}".strip())
        sensors.append(_build_sensor(name, times, rows, mapping))
        assumed += said
    t_s, raw, changes, said = _even_times(clock_g.subtract(origin), raw, number, mapping, gyro)
    assumed += said
    t_s, raw, said = _sort_rows(t_s, raw, "gyro")
    assumed += said
    t_s, raw, sample_s, said = _build_samples(t_s[0] + mapping.time_factor * (t_s - t_s[0]), raw, mapping)
    raw = mapping.rate_factor * raw
    said += [
        f"the {what} times {factor:.9g}"
        for what, factor in (
            ("gyro's time tags are about the first one", mapping.time_factor),
            ("rates are", mapping.rate_factor),
        )
        if factor != 1
    ]
    for k, sensor in enumerate(sensors):
        keep, lost = leave_out_lost_references(sensor.t_s, sensor.q, t_s, raw, sample_s, f"attitude {sensor.name}".strip())
        sensors[k] = sensor.select_rows(keep)
        said += lost
    time_scale = scale or "seconds of the file"
    assumed = _put_large_losses_first([*changes, *assumed, *said], len(clock_g.whole), sum(len(c.whole) for c in clocks))
    return Streams(t_s, raw, sample_s, channels, tuple(sensors), epoch, time_scale, tuple(assumed))


def read_gyro_log(gyro: pd.DataFrame, mapping: Mapping) -> Streams:
    """The gyro's table alone, as the mapping reads it."""
    clock, raw, channels, number, assumed = _read_gyro(gyro, mapping)
    start = int(clock.whole.min()) if clock.scale else 0
    epoch = units.convert_to_date(start, clock.scale).replace(tzinfo=None).isoformat() if clock.scale else UNDATED
    t_s, raw, changes, evened = _even_times(clock.subtract(start), raw, number, mapping, gyro)
    t_s, raw, said = _sort_rows(t_s, raw, "gyro")
    t_s, raw, sample_s, more = _build_samples(t_s, raw, mapping)
    time_scale = clock.scale or "seconds of the file"
    return Streams(t_s, raw, sample_s, channels, (), epoch, time_scale, (*changes, *assumed, *evened, *said, *more))


def _read_gyro(frame: pd.DataFrame, mapping: Mapping) -> tuple[units.Clock, Array, tuple[str, ...], Array | None, list[str]]:
    """Time tags, numbers, names and sample numbers of the gyro's rows, and what is said of them."""
    names, words = parse_spec(mapping.gyro, "gyro")
    tags, unit = parse_spec(mapping.time, "time")
    said = []
    if mapping.rows is not None:
        frame = _select_rows(frame, mapping.rows)
        said.append(f"{len(frame)} rows of the gyro's table, those of {mapping.rows}, are read")
    if mapping.gyro_by is not None:
        if mapping.sample_number is not None:
            raise InputError("sample_number: does not go with gyro_by, whose rows are put together by their time")
        frame, names = _arrange_by_gyro(frame, mapping.gyro_by, tags, names)
    if len(words) != 1:
        raise InputError(
            f"gyro: {mapping.gyro!r} must be columns of the table and one unit; there are {', '.join(map(str, frame.columns))}"
        )
    if mapping.gyro_by is not None and not np.isfinite(read_numbers(frame, names, "gyro")).all(axis=1).any():
        accumulated = units.compute_gyro_factor(words[0], mapping.lsb)[1]
        frame, own = _interpolate_gyros(frame, names, tags, accumulated, mapping.wrap)
        said += own
    channels = tuple(name.removeprefix("-") for name in names)
    counter = [mapping.sample_number] if mapping.sample_number is not None else []
    if counter:
        _select_columns(frame, counter, "sample_number")
    clock, values, left_out = _read_rows(
        frame, [*names, *counter], "gyro", "gyro", ("time", tags, unit), mapping.gyro_by is None
    )
    number = _unwrap_sample_number(values[:, -1]) if counter else None
    return clock, values[:, : len(names)], channels, number, said + left_out


def _select_rows(frame: pd.DataFrame, text: str) -> pd.DataFrame:
    """Rows of a table in which a column has a value, as "COLUMN:VALUE" says."""
    name, _, value = text.rpartition(":")
    _select_columns(frame, [name], "rows")
    chosen = frame[frame[name].astype(str) == value]
    if chosen.empty:
        known = ", ".join(map(str, frame[name].unique()[:MOST_LABELS]))
        raise InputError(f"rows: column {name} has no {value}; it has {known}")
    return chosen


def _unwrap_sample_number(values: Array) -> Array:
    """Sample numbers without the steps back where a counter of 8, 16 or 32 bits wraps."""
    step = np.diff(values)
    back = step[step < 0]
    if back.size:
        wrap = min(2.0**bits for bits in (8, 16, 32, 64) if 2.0**bits > values.max())
        step = np.where(step < -0.5 * wrap, step + wrap, step)
    if (step <= 0).any():
        row = int(np.argmax(step <= 0)) + 1
        raise InputError(f"sample_number: does not grow at row {row}: {values[row - 1]:g}, then {values[row]:g}")
    return np.concatenate([[0.0], np.cumsum(step)])


def _even_times(
    t_s: Array, raw: Array, number: Array | None, mapping: Mapping, frame: pd.DataFrame
) -> tuple[Array, Array, list[str], list[str]]:
    """Time tags on an even time base where more than a percent of them are uneven, or the mapping states number or rate.

    Returns
    -------
    Tags and rates of the rows, what is changed, and what else is said.
    """
    said: list[str] = []
    asked = number is not None or mapping.rate_hz is not None
    if t_s.size < 2:
        return t_s, raw, [], said
    back = np.diff(t_s) < 0
    is_far = -np.diff(t_s).min() > MOST_SWAPPED_ROWS * np.ptp(t_s) / t_s.size or back.mean() > 0.5
    if back.any() and number is None and is_far:
        order = np.argsort(t_s, kind="stable")
        said.append(
            f"the time goes back {int(back.sum())} time(s) in the gyro rows, first to {t_s[1:][back][0]:.9g} s: put in order"
        )
        t_s, raw = t_s[order], raw[order]
    tie = np.concatenate([[False], np.diff(t_s) == 0])
    same = tie & np.concatenate([[False], (np.diff(raw, axis=0) == 0).all(axis=1)])
    if number is None and tie.any() and (same == tie).all():
        return t_s, raw, [], said  # rows written twice, which are left out
    _, words = parse_spec(mapping.gyro, "gyro")
    _, accumulated = units.compute_gyro_factor(words[0], mapping.lsb)
    # Differences of an accumulated angle are divided by those of its tags, and only those with one tag have no such rate.
    uneven = tie.mean() > MOST_LOST_SHARE if accumulated else is_uneven(t_s)
    if not asked and not uneven:
        return t_s, raw, [], said
    if not asked:
        _refuse_several_gyros(frame, mapping)
    found = fit_even_times(t_s, number, None if mapping.rate_hz is None else 1 / mapping.rate_hz)
    if found is None:
        close = np.diff(t_s) < 0.5 * np.median(np.diff(t_s)[np.diff(t_s) > 0])
        if not asked and close.mean() <= MOST_LOST_SHARE:
            return t_s, raw, [], said
        raise InputError(
            f"time: {int(close.sum())} of {t_s.size} gyro rows have the tag of the row before or one within half a sample "
            "of it, and the tags do not follow the number of the row; "
            + ("are sample number and rate those of these rows?" if asked else "give the samples a second, e.g. --rate 100")
            + ("" if asked or len(frame.columns) < 5 else ", or a column that counts the samples, --sample-number COLUMN")
        )
    moved = t_s - found.t_s
    text = (
        f"the gyro's time tags are put on an even time base of {1e3 * found.sample_s:.6g} ms by a straight line through the "
        f"tags against the {'row' if number is None else 'sample'} number, as they come in {found.errors}; they are moved by "
        f"{np.sqrt(np.mean(moved**2)):.3g} s (RMS), {np.abs(moved).max():.3g} s at most"
    )
    text = text.replace("come in jitter", "have jitter").replace("come in late arrival", "have late arrival")
    if found.drift_s:
        text += f"; the clock drifts from a straight line by {found.drift_s:.3g} s, which is kept"
    return found.t_s, raw, [text], said


def _refuse_several_gyros(frame: pd.DataFrame, mapping: Mapping) -> None:
    """Refuse rows of several gyros in one table: a column of few values, each with even time tags of its own."""
    if mapping.rows is not None or mapping.gyro_by is not None:
        return
    tags, unit = parse_spec(mapping.time, "time")
    used = {*tags, *(name.removeprefix("-") for name in parse_spec(mapping.gyro, "gyro")[0])}
    for name in frame.columns:
        if name in used or not 2 <= frame[name].nunique() <= MOST_LABELS:
            continue
        parts = [units.build_clock(part[tags], unit[0]) for _, part in frame.groupby(name)]
        times = [one.subtract(int(one.whole[0])) for one in parts]
        if all(t.size > 2 and (np.diff(t) > 0).all() and not is_uneven(t) for t in times):
            values = [str(value) for value in frame[name].unique()]
            raise InputError(
                f"time: each value of column {name} ({', '.join(values)}) has time tags of its own: choose the rows of one "
                f"gyro, e.g. --rows {name}:{values[0]}; if it numbers the samples of a batch of one gyro, give --rate HZ"
            )


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


def _interpolate_gyros(
    frame: pd.DataFrame, names: list[str], tags: list[str], accumulated: bool, wrap: float | None
) -> tuple[pd.DataFrame, list[str]]:
    """Accumulated angles of gyros with tags of their own, each at the first gyro's tags.

    Between two tags an accumulated angle is linear for the mean rate that is taken from it.
    """
    import pandas as pd

    if len(tags) != 1 or not pd.api.types.is_numeric_dtype(frame[tags[0]]):
        raise InputError("gyro: the gyros have time tags of their own; give these as numbers in one column")
    if not accumulated:
        raise InputError("gyro: the gyros have time tags of their own; only accumulated angles can be taken to common ones")
    t = frame[tags[0]].to_numpy()
    start = t.min()
    columns = {name: frame[name].to_numpy(dtype=np.float64) for name in names}
    rows = {name: np.flatnonzero(np.isfinite(values)) for name, values in columns.items()}
    begin = max(t[own[0]] for own in rows.values())
    end = min(t[own[-1]] for own in rows.values())
    common = rows[names[0]]
    common = common[(t[common] >= begin) & (t[common] <= end)]
    table = pd.DataFrame({tags[0]: t[common]})
    for name, values in columns.items():
        own = values[rows[name]]
        steps, _ = _unwrap_steps(np.diff(own)[:, None], wrap)
        angle = own[0] + np.concatenate([[0.0], np.cumsum(steps[:, 0])])
        seconds = (t - start).astype(np.float64)
        table[name] = np.interp(seconds[common], seconds[rows[name]], angle)
    return table, [f"each gyro has its own time tags: the angles of all are interpolated at those of {names[0]}"]


def _read_attitudes(frame: pd.DataFrame, mapping: Mapping) -> tuple[list[tuple[str, Array]], list[units.Clock], list[str]]:
    kind = mapping.attitude
    text = str(getattr(mapping, kind))
    names, _ = parse_spec(text, kind)
    if isinstance(mapping.sigma_deg, str):
        names = [*names, *_name_sigma_columns(mapping.sigma_deg)]
    tags, unit = parse_spec(mapping.attitude_time or mapping.time, "attitude_time")
    parts = [("", frame)]
    if mapping.attitude_by is not None:
        _select_columns(frame, [mapping.attitude_by], "attitude")
        parts = [(str(name), part) for name, part in frame.groupby(mapping.attitude_by, sort=False)]
    named, clocks, assumed = [], [], []
    for name, part in parts:
        clock, values, said = _read_rows(part, names, kind, "attitude", ("attitude_time", tags, unit))
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
            raise InputError(f"{what}: column {name} holds {units.describe_first_word(chosen[name])}, not numbers")
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
            return units.Clock(gyro.whole, gyro.part, ""), [units.Clock(one.whole, one.part, "") for one in others]
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
        return gyro, [units.Clock(one.whole - first, one.part, gyro.scale) for one in others]
    return units.Clock(gyro.whole + first, gyro.part, others[0].scale), others


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
    if words[0].endswith(units.PER_SAMPLE):
        # An increment is the angle of one sample whatever the tags say, so that a late tag is no larger rate.
        raw = raw / sample_s
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
    t_s, raw, filled = _fill_lost_samples(t_s, raw, sample_s)
    return t_s - late, factor * raw, sample_s, [*filled, *said]


def _fill_lost_samples(t_s: Array, raw: Array, sample_s: float) -> tuple[Array, Array, list[str]]:
    """Rates interpolated between the neighbours of one or two lost samples; a longer gap stays one."""
    spacing = np.diff(t_s)
    lost = np.where(spacing > GAP_SAMPLES * sample_s, np.round(spacing / sample_s) - 1, 0).astype(int)
    holes = np.flatnonzero((lost >= 1) & (lost <= MOST_FILLED_SAMPLES))
    if not holes.size:
        return t_s, raw, []
    added = np.concatenate([t_s[k] + spacing[k] * np.arange(1, lost[k] + 1) / (lost[k] + 1) for k in holes])
    rates = np.column_stack([np.interp(added, t_s, raw[:, axis]) for axis in range(raw.shape[1])])
    order = np.argsort(np.concatenate([t_s, added]), kind="stable")
    text = (
        f"{added.size} gyro sample(s) are lost, at most {MOST_FILLED_SAMPLES} in a row, and filled by interpolation of the "
        f"rates, the first at {added[0]:.9g} s"
    )
    return np.concatenate([t_s, added])[order], np.concatenate([raw, rates])[order], [text]


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
