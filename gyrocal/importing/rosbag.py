"""ROS bags, 1 and 2: a gyro's Imu messages beside attitudes of motion capture or odometry.

angular_velocity is in rad/s about the sensor's axes. A pose's quaternion (x, y, z, w) takes the axes of the body, or of
child_frame_id, to those of header.frame_id: body-to-world, the scalar part last. Times are those of the headers; where all
are zero, those at which the bag was written. Messages whose header alone has no time are left out.
The orientation in an Imu message is not used: it comes from the gyro itself.

The package ``rosbags`` reads both kinds of bags without ROS.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gyrocal.errors import InputError
from gyrocal.importing import import_tables, validate_mapping
from gyrocal.importing.build import ImportResult
from gyrocal.importing.units import NANO

IMU_MESSAGE_TYPE = "sensor_msgs/msg/Imu"
POSES: dict[str, Callable[[Any], Any]] = {
    "geometry_msgs/msg/PoseStamped": lambda message: message.pose.orientation,
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: message.pose.pose.orientation,
    "geometry_msgs/msg/TransformStamped": lambda message: message.transform.rotation,
    "nav_msgs/msg/Odometry": lambda message: message.pose.pose.orientation,
}
ODOMETRY = "nav_msgs/msg/Odometry"


def import_bag(
    path: str | os.PathLike[str],
    imu_topic: str | None = None,
    pose_topic: str | None = None,
    gyro_unit: str = "rad/s",
    **entries: Any,
) -> ImportResult:
    """Import a bag as a recording.

    An `InputError` if the bag or a topic cannot be read, or rates and attitudes do not fit each other.

    Parameters
    ----------
    path : a file of ROS 1, or a folder or file of ROS 2
    imu_topic, pose_topic : of the gyro and of the attitudes; the only one of its kind by default
    gyro_unit : of the rates; the message's definition states rad/s, and some drivers send another unit
    entries : of the mapping, beyond the columns
    """
    path = Path(path)
    gyro, attitude, notes = read_bag(path, imu_topic, pose_topic)
    columns = {"time": "t:ns", "gyro": f"x,y,z:{gyro_unit}", "quat": "qx,qy,qz,qw:scalar-last:body-to-world"}
    columns["title"] = f"bag {path.resolve().stem}"
    try:
        return import_tables(gyro, attitude, validate_mapping(columns | entries, str(path)), said=notes)
    except InputError as fault:
        if "the gyro in " not in str(fault):
            raise
        raise InputError(f"{fault}; --gyro-unit says the unit of a bag's rates") from None


def read_bag(
    path: str | os.PathLike[str], imu_topic: str | None = None, pose_topic: str | None = None
) -> tuple[pd.DataFrame, pd.DataFrame, list[str]]:
    """Read gyro (x, y, z, t) and attitudes (qx, qy, qz, qw, t) of a bag as tables, t in ns, and list the assumptions."""
    path = Path(path)
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError(f"{path}: rosbags is needed to read it: pip install 'gyrocal[ros]'") from None
    if not path.exists():
        raise InputError(f"{path}: no such file")
    try:
        # Bags of ROS 2 need not hold the definitions of their messages; those of the messages read here have not changed.
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            gyro_topic = _choose_topic(reader, (IMU_MESSAGE_TYPE,), imu_topic, "--imu-topic", path)
            attitude_topic = _choose_topic(reader, tuple(POSES), pose_topic, "--pose-topic", path)
            gyro, notes = _read_topic(reader, gyro_topic, lambda message: message.angular_velocity, ["x", "y", "z"])
            kind = reader.topics[attitude_topic].msgtype
            attitude, pose_notes = _read_topic(reader, attitude_topic, POSES[str(kind)], ["qx", "qy", "qz", "qw"])
    except InputError:
        raise
    except Exception as fault:  # a damaged bag raises a zoo of types
        raise InputError(f"{path}: cannot be read as a bag: {' '.join(str(fault).split())}") from None
    notes = [f"rates are those of {gyro_topic}, attitudes those of {attitude_topic}", *notes, *pose_notes]
    if kind == ODOMETRY:
        notes.append(f"{attitude_topic} is odometry: if it uses this gyro, what it says of the gyro is not independent of it")
    return gyro, attitude, notes


def _choose_topic(reader: Any, kinds: tuple[str, ...], topic: str | None, option: str, path: Path) -> str:
    """Choose the topic with messages of these kinds: the stated one, or the only one."""
    candidates = sorted(name for name, about in reader.topics.items() if about.msgtype in kinds)
    if topic is None and len(candidates) == 1:
        return str(candidates[0])
    if topic in candidates:
        return str(topic)
    words = ", ".join(kind.rpartition("/")[2] for kind in kinds)
    problem = f"no topic {topic}" if topic else "several topics" if candidates else "no topic"
    hint = f"give {option}: " if candidates else "there are "
    raise InputError(f"{path}: {problem} of {words}; {hint}{', '.join(candidates or reader.topics)}")


def _read_topic(reader: Any, topic: str, vector: Callable[[Any], Any], names: list[str]) -> tuple[pd.DataFrame, list[str]]:
    """Read the messages of a topic as a table of numbers and times t in ns, and list the assumptions."""
    connections = [connection for connection in reader.connections if connection.topic == topic]
    tags, written, rows = [], [], []
    for connection, recorded, raw in reader.messages(connections=connections):
        message = reader.deserialize(raw, connection.msgtype)
        stamp, values = message.header.stamp, vector(message)
        tags.append(stamp.sec * NANO + stamp.nanosec)
        written.append(recorded)
        rows.append([getattr(values, name[-1]) for name in names])
    notes = []
    if not any(tags):
        tags, notes = written, [f"the headers of {topic} have no time: those at which the bag was written are used"]
    table = pd.DataFrame(np.array(rows, dtype=np.float64).reshape(-1, len(names)), columns=names)
    table = table.assign(t=np.array(tags, dtype=np.int64))
    timed = table["t"] != 0
    if tags and not timed.all():
        notes.append(f"{int((~timed).sum())} of {len(tags)} messages of {topic} are left out, whose headers have no time")
        table = table[timed].reset_index(drop=True)
    return table, notes
