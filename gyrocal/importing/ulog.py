"""PX4's ULog files: a gyro beside attitudes that were not made with it.

A quaternion (w, x, y, z) takes the axes forward, right, down of the body to north, east, down, or to a world with an arbitrary
heading (VehicleOdometry.msg, VehicleAttitude.msg): body-to-world, the scalar part first. Times are µs since boot:
timestamp_sample, where the topic has it, and otherwise timestamp.

The package ``pyulog`` reads the file.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.importing.build import ImportResult, build
from gyrocal.importing.column_mapping import validate_mapping
from gyrocal.importing.flight_logs import (
    Key,
    build_gyro_table,
    build_log_entries,
    compute_message_rate,
    describe_others,
    format_message,
    read_log,
)
from gyrocal.importing.streams import read_streams

if TYPE_CHECKING:
    import pandas as pd

# The gyro's topics, the rawest first: fields, the part of a sample that its tag times, and how PX4 has changed the rates.
GYRO_TOPICS = {
    "sensor_gyro": (("x", "y", "z"), "end", ""),
    "sensor_combined": (tuple(f"gyro_rad[{k}]" for k in range(3)), "end", "PX4 has subtracted its own calibration's offsets"),
    "vehicle_angular_velocity": (tuple(f"xyz[{k}]" for k in range(3)), "middle", "PX4 has subtracted a bias and filtered them"),
}
REFERENCE_TOPICS = (
    "vehicle_attitude_groundtruth",
    "vehicle_mocap_odometry",
    "vehicle_visual_odometry",
    "external_ins_attitude",
)
FILTER_TOPICS = ("vehicle_attitude", "vehicle_odometry", "estimator_attitude", "estimator_odometry")
ULOG_QUATERNION = tuple(f"q[{k}]" for k in range(4))
LEAST_GYRO_RATE_HZ = 20.0  # PX4's default profile logs sensor_gyro at 1 Hz, single samples of which nothing can be integrated


def import_ulog(
    path: str | os.PathLike[str], gyro_topic: str | None = None, attitude_topic: str | None = None, **entries: Any
) -> ImportResult:
    """A recording of a ULog file.

    Parameters
    ----------
    path : of the file
    gyro_topic, attitude_topic : NAME or NAME:INSTANCE; by default the rawest gyro that is logged fast enough, and the first of
        `REFERENCE_TOPICS`
    entries : of the mapping, beyond the columns

    Raises
    ------
    InputError
        The file or a topic cannot be read, no attitudes are independent of the gyro, or rates and attitudes do not fit.
    """
    path = Path(path)
    gyro, attitude, said, tag = read_ulog(path, gyro_topic, attitude_topic)
    made = build_log_entries(gyro, f"ULog {path.resolve().stem}", tag) | {"quat": "qw,qx,qy,qz:scalar-first:body-to-world"}
    mapping = validate_mapping(made | entries, str(path))
    return build(read_streams(gyro, attitude, mapping), mapping, said=said)


def read_ulog(
    path: str | os.PathLike[str], gyro_topic: str | None = None, attitude_topic: str | None = None
) -> tuple[pd.DataFrame, pd.DataFrame, list[str], str]:
    """Gyro (x, y, z, t, perhaps temperature) and attitudes (qw, qx, qy, qz, t), t in µs, what is said of them, and the tag."""
    import pandas as pd

    path = Path(path)
    log = read_log(path, "pyulog", "px4", "ULog", _read_file)
    topics = {(one.name, one.multi_id): one.data for one in log.data_list}
    gyro_key = _choose_gyro(topics, gyro_topic, path)
    attitude_key = _choose_reference(topics, attitude_topic, path)
    fields, tag, changed = GYRO_TOPICS[gyro_key[0]]
    rates, q = topics[gyro_key], topics[attitude_key]
    said = []
    if attitude_key[0] in FILTER_TOPICS:
        said.append(
            f"{attitude_key[0]} is PX4's own estimate from this gyro, no reference: the calibration only repeats the filter's"
        )
    said.append(f"rates are those of {format_message(gyro_key)}{': ' * bool(changed)}{changed}")
    said += _list_other_gyros(topics, gyro_key)
    said.append(f"attitudes are those of {format_message(attitude_key)}")
    if attitude_key[0] == "vehicle_visual_odometry":
        said.append("if the visual odometry uses this gyro, its attitudes say nothing independent of the gyro")
    for name, values, field, text in (
        (gyro_key[0], rates, "gyro_calibration_count", "PX4 changed the gyro's calibration, and with it the bias,"),
        (attitude_key[0], q, "reset_counter", "the attitudes were reset and may jump"),
        (attitude_key[0], q, "quat_reset_counter", "the attitudes were reset and may jump"),
    ):
        count = int(np.count_nonzero(np.diff(values[field]))) if field in values else 0
        said += [f"{text} {count} time(s) within the log ({name}.{field})"] if count else []
    clipped = sum(
        int(np.count_nonzero(values)) for name, values in rates.items() if name.startswith(("clip_counter", "gyro_clipping"))
    )
    said += [f"PX4 counts {clipped} clipped gyro readings: there the rates are too small"] if clipped else []
    if log.file_corruption or log.dropouts:
        lost = sum(one.duration for one in log.dropouts) / 1e3
        said.append(f"the log is damaged or incomplete: {len(log.dropouts)} dropout(s), {lost:g} s in all")
    rotation = log.initial_parameters.get("SENS_BOARD_ROT", 0)
    if gyro_key[0] == "sensor_gyro" and rotation:
        said.append(
            f"SENS_BOARD_ROT is {rotation}: sensor_gyro is about the board's axes, not the body's; see --mounting estimate"
        )
    warm = topics.get(gyro_key if gyro_key[0] == "sensor_gyro" else ("sensor_gyro", 0), {})
    warmth = (_read_times(warm), warm["temperature"]) if "temperature" in warm else ()
    gyro = build_gyro_table(_read_times(rates), np.column_stack([rates[field] for field in fields]), *warmth)
    attitude = pd.DataFrame(
        {f"q{letter}": q[field].astype(float) for letter, field in zip("wxyz", ULOG_QUATERNION, strict=True)}
    )
    return gyro, attitude.assign(t=_read_times(q)), said, tag


def _read_file(pyulog: Any, path: Path) -> Any:
    with path.open("rb") as file:
        return pyulog.ULog(file)


def _read_times(values: dict[str, NDArray[Any]]) -> NDArray[np.int64]:
    """µs since boot of the measurements; of the messages where the topic does not have those."""
    measured = values.get("timestamp_sample", np.zeros(1))
    return np.asarray(measured if measured.all() else values["timestamp"]).astype(np.int64)


def _choose_gyro(topics: dict[Key, Any], topic: str | None, path: Path) -> Key:
    """The topic that is asked for, or the rawest that is fast enough to be integrated."""
    there = {key: topics[key] for name in GYRO_TOPICS for key in sorted(topics) if key[0] == name}
    if topic is not None:
        return _find_topic(there, topic, path, "--gyro-topic")
    if not there:
        raise InputError(f"{path}: no gyro: none of the topics {', '.join(GYRO_TOPICS)} is logged; set SDLOG_PROFILE")
    fast = (key for key, values in there.items() if _compute_rate(values) >= LEAST_GYRO_RATE_HZ)
    return next(fast, max(there, key=lambda key: _compute_rate(there[key])))


def _choose_reference(topics: dict[Key, Any], topic: str | None, path: Path) -> Key:
    """The attitudes that are asked for, or the first that were not made with the gyro."""
    there = {key: values for key, values in topics.items() if set(ULOG_QUATERNION) <= set(values)}
    if topic is not None:
        return _find_topic(there, topic, path, "--attitude-topic")
    found = [key for name in REFERENCE_TOPICS for key in sorted(there) if key[0] == name]
    if not found:
        own = next((key[0] for key in sorted(there) if key[0] in FILTER_TOPICS), None)
        why = f": {own} is PX4's own estimate from this gyro (--attitude-topic {own} takes it in any case)" if own else ""
        raise InputError(f"{path}: no attitudes independent of the gyro{why}; log one of {', '.join(REFERENCE_TOPICS)}")
    return found[0]


def _find_topic(there: dict[Key, Any], topic: str, path: Path, option: str) -> Key:
    """The key of NAME or NAME:INSTANCE."""
    for key in sorted(there):
        if topic in (key[0], f"{key[0]}:{key[1]}"):
            return key
    known = ", ".join(map(format_message, sorted(there))) or "none of its kind"
    raise InputError(f"{path}: no topic {topic}; {option} may be {known}")


def _list_other_gyros(topics: dict[Key, Any], chosen: Key) -> list[str]:
    """List the raw gyros that are not used."""
    others = [key for key in sorted(topics) if key[0] == "sensor_gyro" != chosen[0]]
    others += [key for key in sorted(topics) if key[0] == chosen[0] and key[1] != chosen[1]]
    return describe_others({key: _compute_rate(topics[key]) for key in others}, "--gyro-topic")


def _compute_rate(values: dict[str, NDArray[Any]]) -> float:
    return compute_message_rate(values["timestamp"])
