"""A recording: gyro stream, reference attitudes and raw sensor tables; loaded, validated and saved."""

from gyrocal.recording.faults import validation_message
from gyrocal.recording.format import load, save
from gyrocal.recording.gyros import triad
from gyrocal.recording.parts import Attitudes, AttitudeSensor, GyroStream, Interval, Orbit, reference_rows
from gyrocal.recording.recording import Recording, of_sensor
from gyrocal.recording.toml import read_toml, toml_value

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
