"""Rows of a table as time tags and numbers, in the order of time."""

from __future__ import annotations

from dataclasses import replace
from shlex import quote

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gyrocal.arrays import Array
from gyrocal.errors import InputError
from gyrocal.importing import units
from gyrocal.importing.column_mapping import parse_spec

# By which tags go back where rows are exchanged or tagged late; farther back is another log or a stray tag.
MOST_SWAPPED_ROWS = 4
MOST_STRAY_SHARE = 0.01  # of the rows with a tag far from those beside them
MOST_OFF_NORM_SHARE = 0.2  # of the rows
OFF_NORM_MEDIANS = 10.0  # median departures from norm 1 by which a row of the same kind may be off
NORM_LIMIT = 0.01  # by which the norm of an attitude may be off at all


def read_rows(
    frame: pd.DataFrame,
    names: list[str],
    key: str,
    what: str,
    time: tuple[str, str],
    said: list[str],
    places: bool = True,
    spare: int = 0,
    ordered: bool = True,
) -> tuple[units.Clock, Array]:
    """Read time tags and numbers of the rows that hold numbers; what is done with the others is said.

    Parameters
    ----------
    key, what : entry of the mapping, and what is measured
    time : entry of the mapping for the tags, and its text
    places : whether the rows are those of the table, so that the first left out can be told
    spare : how many of its numbers a row may lack
    ordered : whether the rows must be in the order of their tags, as none need be whose number or rate is stated
    """
    values = read_numbers(frame, names, key)
    good = np.isfinite(values).sum(axis=1) >= len(names) - spare
    is_attitude = key in ("quat", "matrix")
    if is_attitude:  # zeros are no attitude; loggers write them for one that is missing
        good &= (values != 0).any(axis=1)
    tags, unit = parse_spec(time[1], time[0])
    if len(unit) != 1:
        raise InputError(f"{time[0]}: one unit is wanted, not {':'.join(unit)}")
    stamps = select_columns(frame, tags, time[0])
    good &= ~stamps.isin([np.inf, -np.inf]).any(axis=1).to_numpy() & stamps.notna().all(axis=1).to_numpy()
    if not good.any():
        raise InputError(f"{key}: no row of {', '.join([*tags, *names])} holds numbers")
    clock = units.build_clock(stamps.iloc[np.flatnonzero(good)], unit[0])
    if clock.said:
        said.append(f"the tags of the {what} rows {clock.said}")
    if not good.all():
        zeros = ", or of zeros alone," if (values[~good] == 0).all(axis=1).any() else ""
        first = f", the first of them row {int(frame.index[np.flatnonzero(~good)[0]])}" if places else ""
        said.append(f"{int((~good).sum())} {what} row(s) without numbers{zeros} are left out{first}")
    rows = frame.index.to_numpy()[good].astype(np.int64) if places else np.flatnonzero(good)
    clock, values = replace(clock, rows=rows), values[good]
    if ordered:
        head = frame.attrs.get("head")
        kept = _order_rows(clock.subtract(int(clock.whole[0])), rows, f"{what} rows", time[0], head, said)
        clock, values = clock.select_rows(kept), values[kept]
    if is_attitude:
        norm, kept = _find_off_norm(values[:, : 4 if key == "quat" else 9], what, said)
        values[:, :4] /= norm
        clock, values = clock.select_rows(kept), values[kept]
    return clock, values


def _order_rows(
    t_s: Array, rows: NDArray[np.int64], what: str, entry: str, head: tuple[int, str] | None, said: list[str]
) -> NDArray[np.intp]:
    """Rows (k,) to keep, in the order to read them in.

    Neighbours that a network has exchanged stay for `sort_rows`. A row whose tag alone is far off, such as zero, is left out:
    the tags go on beside it. Any other step back is the start of another log, which the order of time would mix with the first.

    head: lines above the first row of the table, and its file
    """
    everything, steps = np.arange(t_s.size), np.diff(t_s)
    if not (steps < 0).any():
        return everything
    if (steps <= 0).all():
        said.append(f"the {what} are in the reverse order of time and are read from the last one on")
        return everything[::-1]
    spacing = np.diff(np.sort(t_s))  # in whatever order the rows are
    usual = float(np.median(spacing[spacing > 0]))
    least = MOST_SWAPPED_ROWS * max(usual, np.ptp(t_s) / t_s.size)
    if -steps.min() <= least:
        return everything
    # The median of a row and its neighbours follows a log that starts anew, but no few rows whose tags are off.
    windows = np.lib.stride_tricks.sliding_window_view(
        np.pad(t_s, MOST_SWAPPED_ROWS, mode="symmetric"), 2 * MOST_SWAPPED_ROWS + 1
    )
    off = np.abs(t_s - np.median(windows, axis=1)) > 2 * MOST_SWAPPED_ROWS * usual
    if (np.diff(t_s[~off]) > -least).all() and off.sum() <= max(MOST_STRAY_SHARE * t_s.size, 1):
        first = f"left out, the first row {rows[off][0]}"
        said.append(f"{off.sum()} of the {what} have a time tag far from those beside them: {first}")
        return np.flatnonzero(~off)
    place = int(rows[int(np.argmin(steps)) + 1])
    cut = "" if head is None else f": head -n {head[0] + place} {quote(head[1])} > part.csv"
    raise InputError(
        f"{entry}: goes back by {-steps.min():.6g} s at row {place} of the {what}, which is no wrap; if another log starts "
        f"there, import the rows before it by themselves{cut}"
    )


def _find_off_norm(values: Array, what: str, said: list[str]) -> tuple[float, NDArray[np.intp]]:
    """The common norm of quaternions (n, 4), or one of matrices (n, 9), and the rows to keep.

    Decimals on file round each element by half a step at most, and the norm by twice that; smoothing and interpolation leave
    it off by as much as the median shows. A row that is off by more, such as one interpolated through a change of the
    quaternion's sign, is no attitude. Where more rows than `MOST_OFF_NORM_SHARE` are, they are not of another kind than the
    others, and those within `NORM_LIMIT` are taken.
    """
    common, scale = 1.0, np.abs(values).max()
    step = next((10.0**-d for d in range(9) if np.abs(np.round(values, d) - values).max() <= 1e-12 * scale), 1e-9)
    if values.shape[1] == 4:
        norms = np.linalg.norm(values, axis=1)
        middle = float(np.median(norms))
        if abs(middle - 1) > NORM_LIMIT and np.mean(np.abs(norms / middle - 1) > NORM_LIMIT) <= MOST_OFF_NORM_SHARE:
            common = middle  # fixed-point numbers
            said.append(f"the quaternions are divided by their common norm, {common:.6g}")
        off = np.abs(norms / common - 1)
    else:
        M = values.reshape(-1, 3, 3)
        off = np.where(np.linalg.det(M) < 0, np.inf, np.abs(M @ M.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)))
    usual = OFF_NORM_MEDIANS * float(np.median(off))
    for limit in (max(2 * step / common, min(usual, NORM_LIMIT)), NORM_LIMIT):
        good = off <= limit
        if not good.all() and np.mean(~good) <= MOST_OFF_NORM_SHARE:
            first = f"left out, the first off by {off[~good][0]:.2g}"
            said.append(f"{np.count_nonzero(~good)} {what} row(s) are not of norm 1 within {limit:.1g}: {first}")
            return common, np.flatnonzero(good)
    return common, np.arange(len(values))


def read_numbers(frame: pd.DataFrame, names: list[str], what: str) -> Array:
    """Columns (rows, names) as numbers, those with a minus before the name with the other sign."""
    plain = [name.removeprefix("-") if name not in frame.columns else name for name in names]
    sign = [-1.0 if name not in frame.columns else 1.0 for name in names]
    twice = sorted({name for name in plain if plain.count(name) > 1})
    if twice:
        raise InputError(f"{what}: column {', '.join(twice)} is named twice")
    chosen = select_columns(frame, plain, what)
    for name in plain:
        if not units.is_numeric(chosen[name]):
            found = units.describe_first_word(chosen[name])
            raise InputError(f"{what}: column {name} holds {found}, not numbers; cells are numbers alone, without their unit")
    return np.asarray(chosen.to_numpy(dtype=np.float64) * sign)


def read_labels(frame: pd.DataFrame, name: str, what: str) -> pd.Series:
    """A column as labels, whole numbers without a point; missing ones stay missing."""
    column = select_columns(frame, [name], what)[name]
    if pd.api.types.is_float_dtype(column) and (column.dropna() % 1 == 0).all():
        column = column.astype("Int64")
    return column.astype(str).str.strip().where(column.notna())


def select_columns(frame: pd.DataFrame, names: list[str], what: str) -> pd.DataFrame:
    """Select columns by name; the refusal of a missing one lists those that the table has."""
    missing = [name for name in names if name not in frame.columns]
    if missing:
        raise InputError(f"{what}: no column {', '.join(missing)}; there are {', '.join(map(str, frame.columns))}")
    return frame[names]


def sort_rows(t_s: Array, values: Array, what: str, said: list[str]) -> tuple[Array, Array]:
    """Put rows in the order of time, each time once; what is done with the others is said."""
    back = np.flatnonzero(np.diff(t_s) < 0) + 1
    if back.size:
        said.append(f"the time goes back {back.size} time(s) in the {what} rows, first to {t_s[back[0]]:.9g} s: put in order")
    order = np.argsort(t_s, kind="stable")
    t_s, values = t_s[order], values[order]
    first = np.concatenate([[True], np.diff(t_s) > 0])
    if first.sum() < 3:
        hint = " --rate HZ takes the order of the rows" if what == "gyro" else ""
        raise InputError(
            f"{what}: {int(first.sum())} rows of different times; is the time column right, and with all its digits?{hint}"
        )
    if not first.all():
        count, begin = int((~first).sum()), float(t_s[~first][0])
        said.append(f"{count} {what} row(s) of a time that another one has are left out, the first at {begin:.9g} s")
    return t_s[first], values[first]
