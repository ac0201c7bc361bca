"""A recording: gyro stream, reference attitudes and raw sensor tables; loaded, validated and saved."""

from gyrocal.recording.faults import validation_message
from gyrocal.recording.format import (
    Attitudes,
    GyroStream,
    Interval,
    Orbit,
    Recording,
    load,
    read_toml,
    reference_rows,
    save,
    toml_value,
)
from gyrocal.recording.gyros import triad
from gyrocal.recording.trackers import AttitudeSensor, of_sensor

__all__ = [
    "AttitudeSensor",
    "Attitudes",
    "GyroStream",
    "Interval",
    "Orbit",
    "Recording",
    "load",
    "of_sensor",
    "read_toml",
    "reference_rows",
    "save",
    "toml_value",
    "triad",
    "validation_message",
]
