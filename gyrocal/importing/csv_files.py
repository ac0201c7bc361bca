"""A recording as two CSV tables beside the mapping that reads them again.

Times that have a date in UTC are nanoseconds of unix time, those of GPS time week and second, others seconds from the epoch.
"""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.files import replacing
from gyrocal.importing.units import GPS_EPOCH, UNIX_EPOCH, UNIX_RANGE_S, WEEK_S
from gyrocal.recording import Recording, reference_rows, toml_value
from gyrocal.recording.trackers import need_one_sensor

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

NANO = 10**9


def write_csv(recording: Recording, folder: str | os.PathLike[str]) -> None:
    """Write gyro.csv, attitude.csv and mapping.toml; the folder is made.

    ``gyrocal import csv FOLDER/gyro.csv FOLDER/attitude.csv OUT --mapping FOLDER/mapping.toml`` makes a recording of them; its
    intervals are made anew, and its references have one sigma per axis, the root mean square of this one's.
    """
    gyro = recording.to_frame("gyro")
    rates = [str(name) for name in gyro.columns if str(name).startswith("rate_")]
    _write(recording, gyro, {"gyro": f"{','.join(rates)}:deg/s"}, folder)


def write_packets(recording: Recording, counts: pd.DataFrame, lsb: str, wrap: float, folder: str | os.PathLike[str]) -> None:
    """Write gyro.csv with accumulated angles in place of rates, attitude.csv and mapping.toml; the folder is made.

    The mapping keeps the recording's references and, but for those with a hole in the references, its intervals, unlike that
    of `write_csv`.

    Parameters
    ----------
    recording : whose attitudes and stated noise are written
    counts : t_s and a column a gyro
    lsb, wrap : size of a count with its unit, and after how many it wraps
    """
    names = [str(name) for name in counts.columns if name != "t_s"]
    t_s = recording.attitudes.t_s
    apart = [float(np.diff(t_s[reference_rows(t_s, one)]).min()) for one in recording.intervals]
    entries = {
        "gyro": f"{','.join(names)}:counts",
        "lsb": lsb,
        "wrap": float(wrap),
        "interval_s": max(one.stop_s - one.start_s for one in recording.intervals) + 1.0,
        "spacing_s": 0.5 * min(apart),
    }
    _write(recording, counts, entries, folder)


def _write(recording: Recording, gyro: pd.DataFrame, read: dict[str, Any], folder: str | os.PathLike[str]) -> None:
    """A table of the gyro, one of the attitudes, and the mapping with what reads the former."""
    need_one_sensor(recording.attitudes)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    gyro, time = _timed(gyro, recording)
    attitude, _ = _timed(recording.to_frame("attitude"), recording)
    entries = (
        time
        | read
        | {
            "quat": "q1,q2,q3,q4:scalar-last:body-to-inertial",
            "G": recording.gyro.apriori_G.tolist(),
            "bias_deg_s": np.rad2deg(recording.gyro.apriori_bias).tolist(),
            "sigma_deg": np.rad2deg(np.sqrt(np.mean(np.square(recording.attitudes.sigma), axis=0))).tolist(),
            "title": recording.title,
        }
    )
    if recording.gyro.arw > 0:
        entries["arw_deg_per_sqrt_s"] = float(np.rad2deg(recording.gyro.arw))
    for name, table in (("gyro", gyro), ("attitude", attitude)):
        with replacing(folder / f"{name}.csv") as file:
            file.write(table.to_csv(index=False).encode())
    with replacing(folder / "mapping.toml") as file:
        file.write("".join(f"{name} = {toml_value(value)}\n" for name, value in entries.items()).encode())


def _timed(table: pd.DataFrame, recording: Recording) -> tuple[pd.DataFrame, dict[str, Any]]:
    """The table with its times, and the entries of a mapping that read them."""
    scale = recording.time_scale.upper()
    given = datetime.fromisoformat(recording.epoch)
    epoch = given.astimezone(UTC) if given.tzinfo else given.replace(tzinfo=UTC)
    values = table.drop(columns="t_s")
    nanoseconds = np.round(table["t_s"].to_numpy(dtype=np.float64) * NANO).astype(np.int64) + epoch.microsecond * 1000
    unix = int((epoch - UNIX_EPOCH).total_seconds() // 1)
    if scale == "UTC" and UNIX_RANGE_S[0] < unix < UNIX_RANGE_S[1]:
        values.insert(0, "unix_ns", unix * NANO + nanoseconds)
        return values, {"time": "unix_ns:ns"}
    if scale == "GPS":
        seconds = int((epoch - GPS_EPOCH).total_seconds() // 1) + nanoseconds // NANO
        values.insert(0, "gps_week", seconds // WEEK_S)
        values.insert(1, "gps_second", seconds % WEEK_S + nanoseconds % NANO / NANO)
        return values, {"time": "gps_week,gps_second:gps"}
    return table, {"time": "t_s:s", "epoch": recording.epoch}
