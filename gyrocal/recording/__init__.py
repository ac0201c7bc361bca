"""A recording: gyro stream, reference attitudes and raw sensor tables; loaded, validated and saved."""

from gyrocal.recording.format import load as load
from gyrocal.recording.format import save as save
from gyrocal.recording.header import format_toml as format_toml
from gyrocal.recording.header import format_validation_error as format_validation_error
from gyrocal.recording.header import read_toml as read_toml
from gyrocal.recording.parts import Attitudes as Attitudes
from gyrocal.recording.parts import GyroStream as GyroStream
from gyrocal.recording.parts import Interval as Interval
from gyrocal.recording.parts import Orbit as Orbit
from gyrocal.recording.parts import find_reference_rows as find_reference_rows
from gyrocal.recording.recording_data import Recording as Recording
