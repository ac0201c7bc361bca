"""Rows of a table as time tags and numbers, in the order of time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.importing import units

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]


def read_rows(
    frame: pd.DataFrame,
    names: list[str],
    key: str,
    what: str,
    time: tuple[str, list[str], list[str]],
    places: bool = True,
    spare: int = 0,
) -> tuple[units.Clock, Array, list[str]]:
    """Time tags and numbers of the rows that hold numbers, and what is said of the others.

    Parameters
    ----------
    key, what : entry of the mapping, and what is measured
    time : entry of the mapping, columns and unit
    places : whether the rows are those of the table, so that the first left out can be told
    spare : how many of its numbers a row may lack
    """
    values = read_numbers(frame, names, key)
    good = np.isfinite(values).sum(axis=1) >= len(names) - spare
    if key in ("quat", "matrix"):  # zeros are no attitude; loggers write them for one that is missing
        good &= (values != 0).any(axis=1)
    if not good.any():
        raise InputError(f"{key}: no row of {', '.join(names)} holds numbers")
    entry, tags, unit = time
    if len(unit) != 1:
        raise InputError(f"{entry}: one unit is wanted, not {':'.join(unit)}")
    clock = units.build_clock(select_columns(frame, tags, entry).iloc[np.flatnonzero(good)], unit[0])
    said = [f"the tags of the {what} rows {clock.said}"] if clock.said else []
    if key == "quat":
        norms = np.linalg.norm(values[good, :4], axis=1)
        norm = float(np.median(norms))
        if abs(norm - 1) > 0.01 and np.abs(norms / norm - 1).max() <= 0.01:  # fixed-point numbers
            values[:, :4] /= norm
            said.append(f"the quaternions are divided by their common norm, {norm:.6g}")
    if good.all():
        return clock, values, said
    zeros = ", or of zeros alone," if np.isfinite(values[~good]).all(axis=1).any() else ""
    first = f", the first of them row {int(frame.index[np.flatnonzero(~good)[0]])}" if places else ""
    return clock, values[good], [*said, f"{int((~good).sum())} {what} row(s) without numbers{zeros} are left out{first}"]


def read_numbers(frame: pd.DataFrame, names: list[str], what: str) -> Array:
    """Columns (rows, names) as numbers, those with a minus before the name with the other sign."""
    import pandas as pd

    plain = [name.removeprefix("-") if name not in frame.columns else name for name in names]
    sign = [-1.0 if name not in frame.columns else 1.0 for name in names]
    twice = sorted({name for name in plain if plain.count(name) > 1})
    if twice:
        raise InputError(f"{what}: column {', '.join(twice)} is named twice")
    chosen = select_columns(frame, plain, what)
    for name in plain:
        if not pd.api.types.is_numeric_dtype(chosen[name]) or pd.api.types.is_bool_dtype(chosen[name]):
            raise InputError(f"{what}: column {name} holds {units.describe_first_word(chosen[name])}, not numbers")
    return np.asarray(chosen.to_numpy(dtype=np.float64) * sign)


def read_labels(frame: pd.DataFrame, name: str, what: str) -> pd.Series:
    """A column as labels, whole numbers without a point; missing ones stay missing."""
    import pandas as pd

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


def sort_rows(t_s: Array, values: Array, what: str) -> tuple[Array, Array, list[str]]:
    """Rows in the order of time, each time once, and what is said of those that were not."""
    said = []
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
    return t_s[first], values[first], said
