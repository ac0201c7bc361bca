"""A recording as two CSV tables, with the mapping that reads them again.

Times that have a date in UTC are nanoseconds of unix time, those of GPS time week and second, others seconds from the epoch.
"""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gyrocal.errors import InputError
from gyrocal.files import open_replacement
from gyrocal.importing.units import NANO, UNIX_RANGE_S, WEEK_S, convert_to_second, parse_date
from gyrocal.recording import Interval, Recording, format_toml
from gyrocal.recording.tables import RATE_COLUMNS


def write_csv(recording: Recording, folder: str | os.PathLike[str]) -> None:
    """Write gyro.csv, attitude.csv and mapping.toml; the folder is made.

    ``gyrocal import csv FOLDER/gyro.csv FOLDER/attitude.csv OUT --mapping FOLDER/mapping.toml`` imports them again. Imported
    references have one sigma per axis, the root mean square of this recording's.
    """
    gyro = recording.to_frame("gyro").rename(columns={name: name.removesuffix("_deg_s") for name in RATE_COLUMNS})
    rates = [str(name) for name in gyro.columns if name != "t_s"]
    if not recording.attitudes.t_s.size:
        raise InputError("the recording has no reference attitudes, without which its tables are no import")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    gyro, time, fraction_s = _insert_times(gyro, recording)
    attitude, _, _ = _insert_times(recording.to_frame("attitude"), recording)
    entries = time | {
        "gyro": f"{','.join(rates)}:deg/s",
        "quat": "q1,q2,q3,q4:scalar-last:body-to-inertial",
        "sigma_deg": np.rad2deg(np.sqrt(np.mean(np.square(recording.attitudes.sigma), axis=0))).tolist(),
        "G": recording.gyro.apriori_G.tolist(),
        "bias_deg_s": np.rad2deg(recording.gyro.apriori_bias).tolist(),
        "title": recording.title,
    }
    if recording.gyro.arw > 0:
        entries["arw_deg_per_sqrt_s"] = float(np.rad2deg(recording.gyro.arw))
    entries["interval"] = [_build_span(interval, fraction_s) for interval in recording.intervals]
    for name, table in (("gyro", gyro), ("attitude", attitude)):
        with open_replacement(folder / f"{name}.csv") as file:
            file.write(table.to_csv(index=False).encode())
    with open_replacement(folder / "mapping.toml") as file:
        file.write("".join(f"{name} = {format_toml(value)}\n" for name, value in entries.items()).encode())


def _build_span(interval: Interval, fraction_s: float) -> dict[str, Any]:
    """Build the entry of a mapping for an interval, without unset fields; fraction_s is added to its times."""
    values = asdict(interval) | {"start_s": interval.start_s + fraction_s, "stop_s": interval.stop_s + fraction_s}
    return {name: value for name, value in values.items() if value is not None}


def _insert_times(table: pd.DataFrame, recording: Recording) -> tuple[pd.DataFrame, dict[str, Any], float]:
    """Replace t_s by times of the recording's time scale; also return mapping entries, and the epoch's fraction of a second."""
    scale = recording.time_scale.upper()
    epoch = parse_date(recording.epoch)
    second, values = epoch.replace(microsecond=0), table.drop(columns="t_s")
    nanoseconds = np.round(table["t_s"].to_numpy(dtype=np.float64) * NANO).astype(np.int64) + epoch.microsecond * 1000
    unix = convert_to_second(epoch, "UTC")
    if scale == "UTC" and UNIX_RANGE_S[0] < unix < UNIX_RANGE_S[1]:
        values.insert(0, "unix_ns", unix * NANO + nanoseconds)
        return values, {"time": "unix_ns:ns", "epoch": second.isoformat()}, epoch.microsecond / 1e6
    if scale == "GPS":
        seconds = convert_to_second(epoch, "GPS") + nanoseconds // NANO
        values.insert(0, "gps_week", seconds // WEEK_S)
        values.insert(1, "gps_second", seconds % WEEK_S + nanoseconds % NANO / NANO)
        entries = {"time": "gps_week,gps_second:gps", "epoch": second.replace(tzinfo=None).isoformat()}
        return values, entries, epoch.microsecond / 1e6
    return table, {"time": "t_s:s", "epoch": recording.epoch}, 0.0
