"""Recordings from anyone's tables: a mapping states the meaning of the columns, and everything else is estimated.

A `Mapping` states the meaning of the columns. `streams` reads them in SI units on one clock and joins gyros. `join_references`
joins the attitudes of several sensors to one series of body attitudes. `agreement` tests whether rates and attitudes agree as
read, and searches the mapping that would fit. `estimates` estimates noise and bias, and `build` builds the recording. See
docs/import.md.
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
    mapping : meaning of the columns
    entries : in place of a mapping, its entries, e.g. ``time="timestamp_ms:ms", gyro="gx,gy,gz:deg/s",
        quat="qw,qx,qy,qz:body-to-inertial"``

    Raises
    ------
    InputError
        One line with the fault; if rates and attitudes do not fit each other, with the mapping that would fit.
    """
    if mapping is None:
        mapping = validate_mapping(entries, "mapping")
    elif entries:
        raise InputError("give a mapping or its entries, not both")
    gyro_table = read_csv(Path(gyro_file))
    attitude_table = read_csv(Path(attitude_file)) if attitude_file is not None else gyro_table
    return import_tables(gyro_table, attitude_table, mapping)


def import_tables(gyro: pd.DataFrame, attitude: pd.DataFrame, mapping: Mapping, *, said: Sequence[str] = ()) -> ImportResult:
    """Import the table of a gyro and the table of attitudes, which may be the same object.

    said: assumptions made when the tables were built, a sentence each
    """
    gyro, attitude, mapping = resolve_columns(gyro, attitude, mapping)
    streams = read_streams(gyro, attitude, mapping)
    return import_streams(streams, mapping, said)


def import_gyro_log(file: str | os.PathLike[str], entries: dict[str, Any]) -> tuple[Recording, tuple[str, ...]]:
    """Read a CSV table of gyros as a recording without references, for their noise alone, and list the assumptions.

    An `InputError` if a column is missing or does not hold what the mapping says. The entries time and gyro are needed; entries
    of attitudes are not read.
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
    """Write the recording, titled by its folder unless it has a title, and the notes of the import into the folder."""
    recording = imported.recording
    if not imported.mapping.title:
        recording = replace(recording, title=Path(folder).resolve().name)
    save(recording, folder)
    entries = imported.mapping.model_dump(exclude_none=True, exclude_defaults=True)
    write_import_notes(folder, imported.warnings, imported.assumed, entries)
