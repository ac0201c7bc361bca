"""Recordings from anyone's tables: what the columns mean is told, what is not told is estimated, and both are written down.

A `Mapping` says what the columns are. `streams` reads them in SI units on one clock and joins gyros, `join_references` makes
one series of body attitudes of several sensors', `agreement` asks whether rates and attitudes fit each other as they are read
and how else they would, `estimates` estimates noise and bias, and `build` puts it together. See docs/import.md.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gyrocal.errors import InputError
from gyrocal.importing.agreement import explain_refusal
from gyrocal.importing.build import ImportResult, import_streams
from gyrocal.importing.column_mapping import Mapping, load_mapping, validate_mapping
from gyrocal.importing.columns import resolve_columns
from gyrocal.importing.estimates import estimate_walk
from gyrocal.importing.gyro_join import join_gyros
from gyrocal.importing.reference_join import SensorReferences, join_references
from gyrocal.importing.streams import read_csv, read_streams
from gyrocal.recording import GyroStream, Interval, Recording, save
from gyrocal.recording.import_notes import write_import_notes
from gyrocal.recording.parts import build_empty_attitudes

__all__ = [
    "ImportResult",
    "Mapping",
    "SensorReferences",
    "explain_refusal",
    "import_csv",
    "import_gyro_log",
    "import_tables",
    "join_gyros",
    "join_references",
    "load_mapping",
    "validate_mapping",
    "write",
]


def import_csv(
    gyro_file: str | os.PathLike[str],
    attitude_file: str | os.PathLike[str] | None = None,
    *,
    mapping: Mapping | None = None,
    **entries: Any,
) -> ImportResult:
    """Import one or two CSV tables as a recording.

    Parameters
    ----------
    gyro_file, attitude_file : paths; without the second the first holds both
    mapping : what the columns mean
    entries : in place of a mapping, its entries, e.g. ``time="timestamp_ms:ms", gyro="gx,gy,gz:deg/s",
        quat="qw,qx,qy,qz:body-to-inertial"``

    Raises
    ------
    InputError
        One line saying what is wrong, and where rates and attitudes do not fit each other, how they would.
    """
    if mapping is None:
        mapping = validate_mapping(entries, "mapping")
    elif entries:
        raise InputError("give a mapping or its entries, not both")
    table = read_csv(Path(gyro_file))
    other = read_csv(Path(attitude_file)) if attitude_file is not None else table
    return import_tables(table, other, mapping)


def import_tables(gyro: pd.DataFrame, attitude: pd.DataFrame, mapping: Mapping, *, said: Sequence[str] = ()) -> ImportResult:
    """Import the gyro's table and that of the attitudes, which every format makes; the same object where one holds both.

    said: what was taken for granted when the tables were made, a sentence each
    """
    gyro, attitude, mapping = resolve_columns(gyro, attitude, mapping)
    streams = read_streams(gyro, attitude, mapping)
    return import_streams(streams, mapping, said)


def import_gyro_log(file: str | os.PathLike[str], entries: dict[str, Any]) -> tuple[Recording, tuple[str, ...]]:
    """Read a CSV table of gyros as a recording without references, for their noise alone, and what was assumed.

    An `InputError` if a column is missing or does not hold what the mapping says. Of its entries time and gyro are needed, and
    those of attitudes are not read.
    """
    path = Path(file)
    table = read_csv(path)
    if "time" not in entries or "gyro" not in entries:
        columns = ", ".join(map(str, table.columns))
        raise InputError(
            f"{path}: a table needs --time and --gyro, e.g. --time t:s --gyro gx,gy,gz:deg/s; its columns are {columns}"
        )
    mapping = validate_mapping(entries, "options", attitude_needed=False)
    table, _, mapping = resolve_columns(table, table, mapping)
    streams = read_streams(table, None, mapping)
    arw = 0.0 if mapping.arw_deg_per_sqrt_s is None else estimate_walk(mapping, streams, streams.raw, [], [])[0]
    stop = float(streams.t_s[-1] + streams.sample_s)
    recording = Recording(
        title=mapping.title or path.stem,
        epoch=streams.epoch,
        time_scale=streams.time_scale,
        gyro=GyroStream(streams.t_s, streams.raw, streams.sample_s, arw, streams.G, np.zeros(3)),
        attitudes=build_empty_attitudes(),
        intervals=(Interval("whole", "", float(streams.t_s[0]), stop),),
        without_references=True,
    )
    return recording, streams.assumed


def write(imported: ImportResult, folder: str | os.PathLike[str]) -> None:
    """Write the recording, titled by its folder unless it has a title, and beside it the notes of the import."""
    recording = imported.recording
    if not imported.mapping.title:
        recording = replace(recording, title=Path(folder).resolve().name)
    save(recording, folder)
    entries = imported.mapping.model_dump(exclude_none=True, exclude_defaults=True)
    write_import_notes(folder, imported.warnings, imported.assumed, entries)
