"""A log of a gyro alone, without reference attitudes: enough for the noise of a body at rest, not for a calibration."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal.errors import InputError
from gyrocal.importing.column_mapping import validate_mapping
from gyrocal.importing.columns import resolve_columns
from gyrocal.importing.estimates import estimate_walk
from gyrocal.importing.streams import read_csv, read_gyro_log
from gyrocal.recording import GyroStream, Interval, Recording
from gyrocal.recording.parts import build_empty_attitudes


def import_gyro_log(file: str | os.PathLike[str], entries: dict[str, Any]) -> tuple[Recording, tuple[str, ...]]:
    """Read a CSV table of gyros as a recording without references, and what was assumed, a sentence each.

    Parameters
    ----------
    file : path of the table
    entries : of a mapping; time and gyro are needed, and those of attitudes are not read

    Raises
    ------
    InputError
        A column is missing or does not hold what the mapping says.
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
    streams = read_gyro_log(table, mapping)
    arw = 0.0 if mapping.arw_deg_per_sqrt_s is None else estimate_walk(mapping, streams, streams.raw, [], [])
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
