"""Columns by name or by number, in every entry of a mapping that names some.

A name may be a column's number from 1, as "#9", or as "9" where no column has that name. Elements of one group, such as
"Gyroscope X" of two header rows, may be named without it where no other group has all of them.
"""

from __future__ import annotations

import re

import pandas as pd

from gyrocal.angle_units import ANGLE_UNITS, RATE_UNITS
from gyrocal.errors import InputError
from gyrocal.importing.column_mapping import ATTITUDE_DIRECTIONS, PLACE, QUATERNION_ORDERS, Mapping, find_name
from gyrocal.importing.units import COUNTS_UNIT, INCREMENT_UNITS, TIME_WORDS

SEQUENCE = re.compile("[xyz]{3}|[XYZ]{3}")
MAPPING_WORDS = {
    *ATTITUDE_DIRECTIONS,
    *QUATERNION_ORDERS,
    *ANGLE_UNITS,
    *RATE_UNITS,
    *INCREMENT_UNITS,
    *TIME_WORDS,
    COUNTS_UNIT,
}
# Entries with columns of each table, and how many of the pieces between colons are words: None any number from one on.
GYRO_ENTRIES = {"time": None, "gyro": None, "gyro_by": 0, "sample_number": 0, "temperature": 0, "rows": None}
ATTITUDE_ENTRIES = {"attitude_time": None, "quat": None, "euler": None, "matrix": None, "attitude_by": 0, "sigma_deg": 0}


def resolve_columns(gyro: pd.DataFrame, attitude: pd.DataFrame, mapping: Mapping) -> tuple[pd.DataFrame, pd.DataFrame, Mapping]:
    """Both tables and the mapping with every column by name.

    A name with a comma or a colon, which a mapping cannot hold, gets spaces in their place.

    gyro, attitude: the tables; the same object where one holds both
    """
    is_one = gyro is attitude
    entries: dict[str, str] = {}
    renamed_gyro: dict[str, str] = {}
    renamed_attitude = renamed_gyro if is_one else {}
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
    attitude = gyro if is_one else attitude.rename(columns=renamed_attitude)
    changed = {key: text for key, text in entries.items() if text != getattr(mapping, key)}
    return gyro, attitude, mapping.model_copy(update=changed) if changed else mapping


def _resolve_text(text: str, columns: list[str], what: str, renamed: dict[str, str], count: int | None) -> str:
    """One text of a mapping with columns by name; as it is where its columns are not in the table.

    count: of the pieces after the names; None any number from one on.
    """
    pieces = text.split(":")
    ways = []
    for first in range(1, len(pieces)) if count is None else [len(pieces) - count]:
        head = ":".join(pieces[:first])
        names = [name.strip() for name in ([head] if head in columns else head.split(","))]
        names = _add_group([name for name in names if name], columns, what)
        found = [find_name(name, columns, what) for name in names]
        if found and all(found):
            ways.append((found, [word.strip() for word in pieces[first:]]))
    if not ways:
        return text
    # A column may be named as a word is: the reading whose words are all known goes before.
    found, words = next(
        (way for way in ways if all(SEQUENCE.fullmatch(word) or {*word.split("+")} <= MAPPING_WORDS for word in way[1])),
        ways[0],
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
    if all(name in columns or PLACE.fullmatch(name) for name in plain):
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
