"""A recording: gyro stream, reference attitudes and raw sensor tables; loaded, validated and saved."""

from gyrocal.recording.format import load, save
from gyrocal.recording.header import format_toml, format_validation_error, read_toml
from gyrocal.recording.parts import Attitudes, GyroStream, Interval, Orbit, find_reference_rows
from gyrocal.recording.recording_data import Recording

__all__ = [
    "Attitudes",
    "GyroStream",
    "Interval",
    "Orbit",
    "Recording",
    "find_reference_rows",
    "format_toml",
    "format_validation_error",
    "load",
    "read_toml",
    "save",
]
