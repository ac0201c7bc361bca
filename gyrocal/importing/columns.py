"""Columns by name or by number, in every entry of a mapping that names columns.

A name may be a column's number from 1, as "#9", or as "9" if no column has that name. Elements of one group, such as
"Gyroscope X" of two header rows, may be named without the group if no other group has all of them.
"""

from __future__ import annotations

import re

import pandas as pd

from gyrocal.angle_units import ANGLE_UNITS, RATE_UNITS
from gyrocal.errors import InputError
from gyrocal.importing import column_mapping
from gyrocal.importing.column_mapping import COLUMN_NUMBER, EULER_SEQUENCE, Mapping, find_name
from gyrocal.importing.units import COUNTS_UNIT, INCREMENT_UNITS, TIME_WORDS

MAPPING_WORDS = {
    *column_mapping.ATTITUDE_DIRECTIONS,
    *column_mapping.QUATERNION_ORDERS,
    *ANGLE_UNITS,
    *RATE_UNITS,
    *INCREMENT_UNITS,
    *TIME_WORDS,
    COUNTS_UNIT,
}
# Entries with columns of each table, and the number of words after colons; None allows any number from one.
GYRO_ENTRIES = {"time": None, "gyro": None, "gyro_by": 0, "sample_number": 0, "temperature": 0, "rows": None}
ATTITUDE_ENTRIES = {"attitude_time": None, "quat": None, "euler": None, "matrix": None, "attitude_by": 0, "sigma_deg": 0}


def resolve_columns(gyro: pd.DataFrame, attitude: pd.DataFrame, mapping: Mapping) -> tuple[pd.DataFrame, pd.DataFrame, Mapping]:
    """Return both tables and the mapping with every column by name.

    A comma or colon in a name, which a mapping cannot hold, is replaced by a space.

    gyro, attitude: the tables; the same object where one holds both
    """
    is_shared = gyro is attitude
    entries: dict[str, str] = {}
    renamed_gyro: dict[str, str] = {}
    renamed_attitude = renamed_gyro if is_shared else {}
    tables = (gyro, GYRO_ENTRIES, renamed_gyro), (attitude, ATTITUDE_ENTRIES, renamed_attitude)
    for frame, keys, renamed in tables:
        columns = [str(name) for name in frame.columns]
        for key, words in keys.items():
            text = getattr(mapping, key)
            if key == "attitude_time" and text is None and entries["time"] != mapping.time:
                text = mapping.time
            if isinstance(text, str):
                entries[key] = _resolve_text(text, columns, key, renamed, words)
    gyro = gyro.rename(columns=renamed_gyro)
    attitude = gyro if is_shared else attitude.rename(columns=renamed_attitude)
    changed = {key: text for key, text in entries.items() if text != getattr(mapping, key)}
    return gyro, attitude, mapping.model_copy(update=changed) if changed else mapping


def _resolve_text(text: str, columns: list[str], what: str, renamed: dict[str, str], word_count: int | None) -> str:
    """Replace the columns in an entry of a mapping by their names; the entry is unchanged if they are not in the table.

    renamed: new names of columns, to which this adds; word_count: number of words after the names; None allows any from one
    """
    pieces = text.split(":")
    readings = []
    for first in range(1, len(pieces)) if word_count is None else [len(pieces) - word_count]:
        head = ":".join(pieces[:first])
        names = [name.strip() for name in ([head] if head in columns else head.split(","))]
        names = _add_group([name for name in names if name], columns, what)
        resolved = [find_name(name, columns, what) for name in names]
        if resolved and all(resolved):
            readings.append((resolved, [word.strip() for word in pieces[first:]]))
    if not readings:
        return text
    # A column may have the name of a word: the reading whose words are all known is preferred.
    resolved, words = next((reading for reading in readings if all(map(_is_mapping_word, reading[1]))), readings[0])
    names = []
    for sign, name in filter(None, resolved):
        if re.search("[,:]", name):
            renamed[name] = " ".join(re.sub("[,:]", " ", name).split())
        names.append(sign + renamed.get(name, name))
    return ":".join([",".join(names), *words])


def _is_mapping_word(word: str) -> bool:
    """Whether a word is a unit, or several joined by +, a direction, an order or an Euler sequence."""
    return EULER_SEQUENCE.fullmatch(word) is not None or {*word.split("+")} <= MAPPING_WORDS


def _add_group(names: list[str], columns: list[str], what: str) -> list[str]:
    """Add the one group of two header rows that has columns of all these names; unchanged if no group is needed."""
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
