"""Columns of a table by name or by number.

A mapping names columns. A name may be a column's number from 1, as "#9", or as "9" where no column has that name. Elements of
one group, such as "Gyroscope X" of two header rows, may be named without it where no other group has all of them.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from gyrocal.errors import InputError
from gyrocal.importing.column_mapping import ATTITUDE_DIRECTIONS, QUATERNION_ORDERS, Mapping
from gyrocal.importing.units import ANGLE_UNITS, CALENDARS, COUNTS_UNIT, PER_SAMPLE, RATE_UNITS, TIME_UNITS

if TYPE_CHECKING:
    import pandas as pd

COLUMN_NUMBER = re.compile(r"#?([1-9][0-9]{0,5})")
SEQUENCE = re.compile("[xyz]{3}|[XYZ]{3}")
MAPPING_WORDS = {*ATTITUDE_DIRECTIONS, *QUATERNION_ORDERS, *ANGLE_UNITS, *RATE_UNITS, *TIME_UNITS, *CALENDARS, COUNTS_UNIT}
MAPPING_WORDS |= {unit + PER_SAMPLE for unit in ANGLE_UNITS}


def resolve_columns(gyro: pd.DataFrame, attitude: pd.DataFrame, mapping: Mapping) -> tuple[pd.DataFrame, pd.DataFrame, Mapping]:
    """Both tables and the mapping with every column by name.

    A name with a comma or a colon, which a mapping cannot hold, gets spaces in their place.

    Parameters
    ----------
    gyro, attitude : the tables; the same object where one holds both
    mapping : with names, or numbers from 1
    """
    is_one = gyro is attitude
    entries: dict[str, str] = {}
    renamed_gyro: dict[str, str] = {}
    renamed_attitude = renamed_gyro if is_one else {}
    for key, frame, renamed in (
        ("time", gyro, renamed_gyro),
        ("gyro", gyro, renamed_gyro),
        ("attitude_time", attitude, renamed_attitude),
        *((kind, attitude, renamed_attitude) for kind in ("quat", "euler", "matrix")),
    ):
        text = getattr(mapping, key)
        if text is not None:
            entries[key] = _resolve_text(text, [str(name) for name in frame.columns], key, renamed)
    if mapping.attitude_time is None and entries["time"] != mapping.time:
        columns = [str(name) for name in attitude.columns]
        entries["attitude_time"] = _resolve_text(mapping.time, columns, "attitude_time", renamed_attitude)
    gyro = gyro.rename(columns=renamed_gyro)
    attitude = gyro if is_one else attitude.rename(columns=renamed_attitude)
    changed = {key: text for key, text in entries.items() if text != getattr(mapping, key)}
    return gyro, attitude, mapping.model_copy(update=changed) if changed else mapping


def _resolve_text(text: str, columns: list[str], what: str, renamed: dict[str, str]) -> str:
    """One text of a mapping with columns by name; as it is where its columns are not in the table."""
    pieces = text.split(":")
    ways = []
    for first in range(1, len(pieces)):
        names = [name.strip() for name in ":".join(pieces[:first]).split(",")]
        names = _add_group([name for name in names if name], columns, what)
        found = [_find_column(name, columns, what) for name in names]
        if found and all(found):
            ways.append((found, [word.strip() for word in pieces[first:]]))
    if not ways:
        return text
    # A column may be named as a word is: the reading whose words are all known goes before.
    found, words = next(
        (way for way in ways if all(word in MAPPING_WORDS or SEQUENCE.fullmatch(word) for word in way[1])), ways[0]
    )
    names = []
    for sign, name in (one for one in found if one is not None):
        if re.search("[,:]", name):
            renamed[name] = " ".join(re.sub("[,:]", " ", name).split())
        names.append(sign + renamed.get(name, name))
    return ":".join([",".join(names), *words])


def _add_group(names: list[str], columns: list[str], what: str) -> list[str]:
    """Names with the one group of two header rows that has columns of all of them; as they are where none is needed."""
    plain = [name.removeprefix("-").strip() for name in names]
    if all(name in columns or COLUMN_NUMBER.fullmatch(name) for name in plain):
        return names
    groups = [{column.removesuffix(f" {name}") for column in columns if column.endswith(f" {name}")} for name in plain]
    shared = sorted(set.intersection(*groups)) if groups else []
    if len(shared) > 1:
        raise InputError(
            f"{what}: {', '.join(plain)} are columns of {' and of '.join(shared)}; write {shared[0]} {plain[0]} or the like"
        )
    if not shared:
        return names
    return [("-" if name.startswith("-") else "") + f"{shared[0]} {short}" for name, short in zip(names, plain, strict=True)]


def _find_column(name: str, columns: list[str], what: str) -> tuple[str, str] | None:
    """Sign, "" or "-", and name of the column that a mapping means; None where the table has none."""
    if name in columns:
        return "", name
    sign, plain = ("-", name[1:].strip()) if name.startswith("-") else ("", name)
    if plain in columns:
        return sign, plain
    uncommented = plain.removeprefix("#").strip()  # a header may begin with the sign of a comment
    if uncommented in columns and not uncommented.isdigit():
        return sign, uncommented
    if plain in ("0", "#0"):
        raise InputError(f"{what}: no column {plain}; columns are counted from 1, as in #1")
    number = COLUMN_NUMBER.fullmatch(plain)
    if number is None:
        return None
    place = int(number.group(1))
    if place > len(columns):
        raise InputError(f"{what}: no column {plain}; the table has {len(columns)} columns")
    return sign, columns[place - 1]
