"""Columns of a table by name or by number, and tables with two header rows.

A mapping names columns. A name may be a column's number from 1, as "#9", or as "9" where no column has that name. Some loggers
write two header rows, groups above elements:

    Time (s);Orientation;;;;Gyroscope;;
    ;W;X;Y;Z;X;Y;Z

The name of a column then is that of its group, which holds until the next one, with that of the element: "Gyroscope X".
"""

from __future__ import annotations

import csv
import re
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from gyrocal.errors import InputError
from gyrocal.importing.column_mapping import ATTITUDE_DIRECTIONS, QUATERNION_ORDERS, Mapping
from gyrocal.importing.units import ANGLE_UNITS, CALENDARS, COUNTS_UNIT, PER_SAMPLE, RATE_UNITS, TIME_UNITS

if TYPE_CHECKING:
    import pandas as pd

SEPARATORS = (",", ";", "\t")
COLUMN_NUMBER = re.compile(r"#?([1-9][0-9]{0,5})")
SEQUENCE = re.compile("[xyz]{3}|[XYZ]{3}")
MAPPING_WORDS = {*ATTITUDE_DIRECTIONS, *QUATERNION_ORDERS, *ANGLE_UNITS, *RATE_UNITS, *TIME_UNITS, *CALENDARS, COUNTS_UNIT}
MAPPING_WORDS |= {unit + PER_SAMPLE for unit in ANGLE_UNITS}


def read_two_headers(path: Path) -> tuple[str, list[str]] | None:
    """Separator and joined names of a table with two header rows; None for a table with one."""
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        lines = list(islice(file, 3))
    if len(lines) < 3:
        return None
    for separator in SEPARATORS:
        groups, elements, values = ([cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator))
        # A separator at the end of the headers alone names a column without values.
        values += [""] * (len(groups) - len(values))
        if len(groups) > 1 and len(groups) == len(elements) == len(values) and _has_two_headers(groups, elements, values):
            return separator, join_headers(groups, elements)
    return None


def _has_two_headers(groups: list[str], elements: list[str], values: list[str]) -> bool:
    """Whether the first two rows are names and the third holds numbers below them."""
    named = [k for k, cell in enumerate(elements) if cell]
    if len(named) < 2 or any(_is_number(cell) for cell in (*groups, *elements) if cell):
        return False
    return any(_is_number(values[k]) for k in named)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def join_headers(groups: list[str], elements: list[str]) -> list[str]:
    """Join two header rows; a column without a name is named by its number, a second one of the same name gets a suffix."""
    names: list[str] = []
    group = ""
    for k, (own, element) in enumerate(zip(groups, elements, strict=True), 1):
        group = own or group
        name = f"{group} {element}".strip() if element else own or f"column {k}"
        count = sum(name == other or other.startswith(f"{name}.") for other in names)
        names.append(f"{name}.{count}" if count else name)
    return names


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
        found = [_find_column(name, columns, what) for name in names if name]
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


def _find_column(name: str, columns: list[str], what: str) -> tuple[str, str] | None:
    """Sign, "" or "-", and name of the column that a mapping means; None where the table has none."""
    if name in columns:
        return "", name
    sign, plain = ("-", name[1:].strip()) if name.startswith("-") else ("", name)
    if plain in columns:
        return sign, plain
    number = COLUMN_NUMBER.fullmatch(plain)
    if number is None:
        return None
    place = int(number.group(1))
    if place > len(columns):
        raise InputError(f"{what}: no column {plain}; the table has {len(columns)} columns")
    return sign, columns[place - 1]
