"""ArduPilot's DataFlash logs (.bin): a gyro, beside a table of attitudes that were not made with it.

GYR has every sample of a gyro, IMU its filtered rates at the time of the message. Rates are in rad/s about the body's axes
forward, right, down (AP_InertialSensor's LogStructure.h). Times are µs since boot: SampleUS of GYR, TimeUS of IMU. The filters'
yaw, pitch and roll, in deg, take the body's axes to north, east, down.

The package ``pymavlink`` reads the file.
"""

from __future__ import annotations

import os
from collections import defaultdict
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.importing import flight_logs
from gyrocal.importing.column_mapping import validate_mapping
from gyrocal.importing.columns import resolve_columns
from gyrocal.importing.streams import read_csv, read_streams

if TYPE_CHECKING:
    import pandas as pd

    from gyrocal.importing.build import ImportResult

Array = NDArray[np.float64]

MESSAGE_START = b"\xa3\x95"  # of each message
RATE_FIELDS = ("GyrX", "GyrY", "GyrZ")
# The part of a sample that a message's time tags, and how ArduPilot has changed the rates; the rawer first.
GYRO_MESSAGES = {
    "GYR": ("end", "ArduPilot has subtracted its own calibration's offsets"),
    "IMU": ("middle", "ArduPilot has subtracted its own calibration's offsets and filtered them"),
}
FILTER_MESSAGES = ("ATT", "AHR2", "XKF1", "NKF1")  # with the attitudes by ArduPilot's own filters
MOST_COPY_ANGLE = np.deg2rad(0.02)  # of a copied attitude from its source; logged angles are rounded to 0.01 deg


def import_ardupilot(
    path: str | os.PathLike[str], attitude_file: str | os.PathLike[str], instance: int | None = None, **entries: Any
) -> ImportResult:
    """A recording of a DataFlash log and a text table of attitudes.

    Parameters
    ----------
    path, attitude_file : of the log, and of the table
    instance : number of the gyro; the first by default
    entries : of the mapping: attitude_time, one of quat, euler and matrix, and any other but the gyro's columns

    Raises
    ------
    InputError
        A file cannot be read, the attitudes are those of ArduPilot's filters, or rates and attitudes do not fit.
    """
    path = Path(path)
    if not entries.get("attitude_time") or not any(entries.get(kind) for kind in ("quat", "euler", "matrix")):
        example = "--attitude-time timestamp_ms:ms --quat qw,qx,qy,qz:body-to-world"
        raise InputError(f"{attitude_file}: what its columns mean is not stated; give time and attitude, e.g. {example}")
    gyro, filters, said, tag = read_ardupilot(path, instance)
    mapping = validate_mapping(
        flight_logs.build_log_entries(gyro, f"ArduPilot {path.resolve().stem}", tag) | entries, str(path)
    )
    gyro, attitude, mapping = resolve_columns(gyro, read_csv(Path(attitude_file)), mapping)
    streams = read_streams(gyro, attitude, mapping)
    copied = [name for one in streams.sensors for name, angles in filters.items() if _is_copy(one.q, angles)]
    if copied:
        text = f"the attitudes are those of {copied[0]}, ArduPilot's own estimate from this gyro, no reference"
        if not mapping.unchecked:
            raise InputError(f"{attitude_file}: {text}; give those of motion capture or the like (--unchecked takes any)")
        said.insert(0, f"{text}: the calibration only repeats the filter's")

    from gyrocal.importing.build import build  # late: what compiles is not loaded for a file that cannot be read

    return build(streams, mapping, said=said)


def read_ardupilot(
    path: str | os.PathLike[str], instance: int | None = None
) -> tuple[pd.DataFrame, dict[str, Array], list[str], str]:
    """Gyro (x, y, z, t in µs, perhaps temperature), angles of each filter (n, 3), what is said of the gyro, and the tag."""
    path = Path(path)
    messages = flight_logs.read_log(path, "pymavlink.DFReader", "ardupilot", "DataFlash", _read_messages)
    rates_hz = {
        key: flight_logs.compute_message_rate(rows[:, 0]) for key, rows in sorted(messages.items()) if key[0] in GYRO_MESSAGES
    }
    numbers = sorted({number for _, number in rates_hz})
    if not numbers:
        raise InputError(f"{path}: no gyro: the log has neither IMU nor GYR messages; set LOG_BITMASK or INS_RAW_LOG_OPT")
    number = numbers[0] if instance is None else instance
    if number not in numbers:
        raise InputError(f"{path}: no gyro of instance {number}; --instance may be {', '.join(map(str, numbers))}")
    chosen = max((key for key in rates_hz if key[1] == number), key=lambda key: rates_hz[key])
    tag, changed = GYRO_MESSAGES[chosen[0]]
    said = [f"rates are those of {flight_logs.format_message(chosen)} at {rates_hz.pop(chosen):.3g} Hz: {changed}"]
    said += flight_logs.describe_others({key: hz for key, hz in rates_hz.items() if key[1] == number}, "slower")
    said += flight_logs.describe_others({key: hz for key, hz in rates_hz.items() if key[1] != number}, "--instance")
    rows, warm = messages[chosen], messages.get(("IMU", number), np.zeros((0, 5)))
    gyro = flight_logs.build_gyro_table(rows[:, 0], rows[:, 1:4], warm[:, 0], warm[:, 4])
    return gyro, {name: messages[name, 0] for name in FILTER_MESSAGES if (name, 0) in messages}, said, tag


def _read_messages(reader: Any, path: Path) -> dict[flight_logs.Key, Array]:
    """Rows of each message: µs, rates and °C (NaN if not there) of the gyros; yaw, pitch and roll in deg of the filters."""
    rows: defaultdict[flight_logs.Key, list[list[float]]] = defaultdict(list)
    with path.open("rb") as file:
        if file.read(2) != MESSAGE_START:
            raise ValueError("it does not begin with a message")
    log = reader.DFReader_binary.__new__(reader.DFReader_binary)
    try:
        log.__init__(str(path))
    except Exception:
        log.filehandle.close()  # a constructor that raises leaves it open
        raise
    with closing(log):
        numbered = [f"{name}{k}" for name in GYRO_MESSAGES for k in ("", 1, 2, 3)]  # IMU2 and GYR1 in logs before field I
        while (one := log.recv_match(type=[*numbered, *FILTER_MESSAGES])) is not None:
            name = one.get_type()
            if name in FILTER_MESSAGES:
                rows[name, 0].append([one.Yaw, one.Pitch, one.Roll])
                continue
            key = (name[:3], int(getattr(one, "I", int(name[3:] or 1) - 1)))
            time = one.SampleUS if key[0] == "GYR" else one.TimeUS
            rows[key].append([time, *(getattr(one, field) for field in RATE_FIELDS), getattr(one, "T", np.nan)])
    return {key: np.array(values, dtype=float) for key, values in rows.items()}


def _is_copy(q: Array, angles: Array) -> bool:
    """Whether most attitudes A(q) (m, 4) are among those of yaw, pitch and roll (n, 3), deg."""
    from scipy.spatial import KDTree
    from scipy.spatial.transform import Rotation

    own = Rotation.from_euler("ZYX", angles, degrees=True).as_quat()
    # A chord of unit quaternions spans half of the angle of the rotation between them.
    chord, _ = KDTree(np.concatenate([own, -own])).query(q)
    return bool(4 * np.arcsin(np.median(chord) / 2) < MOST_COPY_ANGLE)
