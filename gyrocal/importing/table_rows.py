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

# Rows by which tags go back if rows are exchanged or tagged late; a larger step back is another log or a stray tag.
MOST_SWAPPED_ROWS = 4
MOST_STRAY_SHARE = 0.01  # of the rows, with a tag far from those beside them
MOST_OFF_NORM_SHARE = 0.2  # of the rows
OFF_NORM_MEDIANS = 10.0  # median deviations from norm 1: larger ones are outliers
NORM_LIMIT = 0.01  # largest deviation of the norm of an attitude from 1


def read_rows(
    frame: pd.DataFrame,
    names: list[str],
    key: str,
    what: str,
    time: tuple[str, str],
    notes: list[str],
    is_table: bool = True,
    most_missing: int = 0,
    is_ordered: bool = True,
) -> tuple[units.Clock, Array]:
    """Read time tags (m,) and numbers (m, names) of the rows that hold numbers, and note the rows left out.

    Parameters
    ----------
    key, what : entry of the mapping, and the measured quantity
    time : entry of the mapping for the tags, and its text
    is_table : whether the rows are those of the table, so that a note can name the first one left out
    most_missing : numbers that a row may lack
    is_ordered : whether the rows must be in the order of their tags; rows with a stated number or rate need not be
    """
    values = read_numbers(frame, names, key)
    has_numbers = np.isfinite(values).sum(axis=1) >= len(names) - most_missing
    is_attitude = key in ("quat", "matrix")
    if is_attitude:  # zeros are no attitude; loggers write them for one that is missing
        has_numbers &= (values != 0).any(axis=1)
    tags, unit = parse_spec(time[1], time[0])
    if len(unit) != 1:
        raise InputError(f"{time[0]}: one unit is wanted, not {':'.join(unit)}")
    stamps = select_columns(frame, tags, time[0])
    has_numbers &= ~stamps.isin([np.inf, -np.inf]).any(axis=1).to_numpy() & stamps.notna().all(axis=1).to_numpy()
    if not has_numbers.any():
        raise InputError(f"{key}: no row of {', '.join([*tags, *names])} holds numbers")
    clock = units.build_clock(stamps.iloc[np.flatnonzero(has_numbers)], unit[0])
    if clock.note:
        notes.append(f"the tags of the {what} rows {clock.note}")
    if not has_numbers.all():
        zeros = ", or of zeros alone," if (values[~has_numbers] == 0).all(axis=1).any() else ""
        first = f", the first of them row {int(frame.index[np.flatnonzero(~has_numbers)[0]])}" if is_table else ""
        notes.append(f"{int((~has_numbers).sum())} {what} row(s) without numbers{zeros} are left out{first}")
    rows = frame.index.to_numpy()[has_numbers].astype(np.int64) if is_table else np.flatnonzero(has_numbers)
    clock, values = replace(clock, rows=rows), values[has_numbers]
    if is_ordered:
        head = frame.attrs.get("head")
        kept = _order_rows(clock.subtract(int(clock.whole[0])), rows, f"{what} rows", time[0], head, notes)
        clock, values = clock.select_rows(kept), values[kept]
    if is_attitude:
        norm, kept = _find_off_norm(values[:, : 4 if key == "quat" else 9], what, notes)
        values[:, :4] /= norm
        clock, values = clock.select_rows(kept), values[kept]
    return clock, values


def _order_rows(
    t_s: Array, rows: NDArray[np.int64], what: str, entry: str, head: tuple[int, str] | None, notes: list[str]
) -> NDArray[np.intp]:
    """Return the rows (k,) to keep, in the order of reading.

    Neighbours that a network has exchanged are left to `sort_rows`. A row with a stray tag, such as zero, is left out: the tags
    go on beside it. Any other step back is the start of another log, which the order of time would mix with the first.

    head: lines above the first row of the table, and its file
    """
    all_rows, steps = np.arange(t_s.size), np.diff(t_s)
    if not (steps < 0).any():
        return all_rows
    if (steps <= 0).all():
        notes.append(f"the {what} are in the reverse order of time and are read from the last one on")
        return all_rows[::-1]
    spacing = np.diff(np.sort(t_s))  # in whatever order the rows are
    usual = float(np.median(spacing[spacing > 0]))
    least = MOST_SWAPPED_ROWS * max(usual, np.ptp(t_s) / t_s.size)
    if -steps.min() <= least:
        return all_rows
    # The median of a row and its neighbours follows a log that starts anew, but ignores a few stray tags.
    windows = np.lib.stride_tricks.sliding_window_view(
        np.pad(t_s, MOST_SWAPPED_ROWS, mode="symmetric"), 2 * MOST_SWAPPED_ROWS + 1
    )
    is_stray = np.abs(t_s - np.median(windows, axis=1)) > 2 * MOST_SWAPPED_ROWS * usual
    if (np.diff(t_s[~is_stray]) > -least).all() and is_stray.sum() <= max(MOST_STRAY_SHARE * t_s.size, 1):
        first = f"left out, the first row {rows[is_stray][0]}"
        notes.append(f"{is_stray.sum()} of the {what} have a time tag far from those beside them: {first}")
        return np.flatnonzero(~is_stray)
    place = int(rows[int(np.argmin(steps)) + 1])
    cut = "" if head is None else f": head -n {head[0] + place} {quote(head[1])} > part.csv"
    raise InputError(
        f"{entry}: goes back by {-steps.min():.6g} s at row {place} of the {what}, which is no wrap; if another log starts "
        f"there, import the rows before it by themselves{cut}"
    )


def _find_off_norm(values: Array, what: str, notes: list[str]) -> tuple[float, NDArray[np.intp]]:
    """Estimate the common norm of quaternions (n, 4), which is 1 of matrices (n, 9), and select the rows near it.

    Decimals on file round each element by half a step at most, and the norm by twice that; smoothing and interpolation change
    it by about the median deviation. A row with a much larger one, such as one interpolated through a change of the
    quaternion's sign, is no attitude. If more rows than `MOST_OFF_NORM_SHARE` have one, they are no outliers, and all rows
    within `NORM_LIMIT` are kept.
    """
    common, scale = 1.0, np.abs(values).max()
    step = next((10.0**-d for d in range(9) if np.abs(np.round(values, d) - values).max() <= 1e-12 * scale), 1e-9)
    if values.shape[1] == 4:
        norms = np.linalg.norm(values, axis=1)
        middle = float(np.median(norms))
        if abs(middle - 1) > NORM_LIMIT and np.mean(np.abs(norms / middle - 1) > NORM_LIMIT) <= MOST_OFF_NORM_SHARE:
            common = middle  # fixed-point numbers
            notes.append(f"the quaternions are divided by their common norm, {common:.6g}")
        deviation = np.abs(norms / common - 1)
    else:
        M = values.reshape(-1, 3, 3)
        deviation = np.where(np.linalg.det(M) < 0, np.inf, np.abs(M @ M.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)))
    usual = OFF_NORM_MEDIANS * float(np.median(deviation))
    for limit in (max(2 * step / common, min(usual, NORM_LIMIT)), NORM_LIMIT):
        good = deviation <= limit
        if not good.all() and np.mean(~good) <= MOST_OFF_NORM_SHARE:
            first = f"left out, the first off by {deviation[~good][0]:.2g}"
            notes.append(f"{np.count_nonzero(~good)} {what} row(s) are not of norm 1 within {limit:.1g}: {first}")
            return common, np.flatnonzero(good)
    return common, np.arange(len(values))


def read_numbers(frame: pd.DataFrame, names: list[str], what: str) -> Array:
    """Read columns as numbers (rows, names); a minus before a name changes the sign."""
    plain = [name.removeprefix("-") if name not in frame.columns else name for name in names]
    sign = [-1.0 if name not in frame.columns else 1.0 for name in names]
    twice = sorted({name for name in plain if plain.count(name) > 1})
    if twice:
        raise InputError(f"{what}: column {', '.join(twice)} is named twice")
    chosen = select_columns(frame, plain, what)
    for name in plain:
        if not units.is_numeric(chosen[name]):
            word = units.describe_first_word(chosen[name])
            raise InputError(f"{what}: column {name} holds {word}, not numbers; cells are numbers alone, without their unit")
    return np.asarray(chosen.to_numpy(dtype=np.float64) * sign)


def read_labels(frame: pd.DataFrame, name: str, what: str) -> pd.Series:
    """Read a column as labels, whole numbers without a point; missing ones stay missing."""
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


def sort_rows(t_s: Array, values: Array, what: str, notes: list[str]) -> tuple[Array, Array]:
    """Sort rows (n,) by time, each time once, and note the rows that are moved or left out."""
    back = np.flatnonzero(np.diff(t_s) < 0) + 1
    if back.size:
        notes.append(f"the time goes back {back.size} time(s) in the {what} rows, first to {t_s[back[0]]:.9g} s: put in order")
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
        notes.append(f"{count} {what} row(s) of a time that another one has are left out, the first at {begin:.9g} s")
    return t_s[first], values[first]
