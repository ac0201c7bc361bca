"""A recording: a gyro stream, reference attitudes and calibration intervals; load, validate, save.

On disk a recording is one folder: ``recording.toml``, ``gyro.parquet`` (or ``.csv``), ``attitude.parquet`` and optional
tables. Files are in degrees, objects in radians. The gyro sample k is the mean body rate over [t_k, t_k + sample_s) as the
uncalibrated gyro shows it. Simulated and real data share the format, and nothing in it says which it is.

A recording holds three rates and one reference attitude at a time: an import joins more gyros and several sensors.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gyrocal.arrays import Array
from gyrocal.errors import InputError
from gyrocal.files import lock_folder, write_together
from gyrocal.recording import checks, header, sensor_tables, tables
from gyrocal.recording.parts import Attitudes, GyroStream, Orbit, build_empty_attitudes
from gyrocal.recording.recording_data import Recording
from gyrocal.recording.tables import CORRELATION_COLUMNS, OPTIONAL_TABLES, QUATERNION_COLUMNS, RATE_COLUMNS, SIGMA_COLUMNS

if TYPE_CHECKING:
    import pandas as pd


HEADER = "recording.toml"
IS_A_RECORDING = f"a recording is a folder with {HEADER} in it"


def load(folder: str | os.PathLike[str], *, without_references: bool = False) -> Recording:
    """Load and validate a recording; without_references allows one without reference attitudes.

    An `InputError` gives in one line the file, the place in it and the fault.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: not a folder; {IS_A_RECORDING}")
    with lock_folder(folder, shared=True):
        if not (folder / HEADER).exists():
            raise InputError(f"{folder / HEADER}: no such file; {IS_A_RECORDING}")
        return _load(folder, without_references)


def _load(folder: Path, without_references: bool) -> Recording:
    """Read and validate the files of a recording whose folder is locked."""
    stated = header.read(folder / HEADER)
    gyro_name, gyro = tables.read(folder, "gyro", ("t_s", *RATE_COLUMNS))
    without_references = without_references and tables.find(folder, "attitude") is None
    attitude_name, attitude = "attitude", None
    if not without_references:
        attitude_name, attitude = tables.read(folder, "attitude", ("t_s", *QUATERNION_COLUMNS, *SIGMA_COLUMNS))
    optional = {name: tables.read(folder, name, ("t_s",))[1] for name in OPTIONAL_TABLES if tables.find(folder, name)}
    stream = _build_stream(stated.gyro, gyro)
    with _name_in_error(folder):
        sensors = sensor_tables.read(optional)
    with _name_in_error(folder / gyro_name):  # checked here first so that the message can name the file
        checks.check_gyro(stream)
    attitudes = build_empty_attitudes()
    if attitude is not None:
        with _name_in_error(folder / attitude_name):
            attitudes = _read_attitudes(attitude, stated.attitude)
            checks.check_attitudes(attitudes)
    with _name_in_error(folder):
        return Recording(
            title=stated.title,
            epoch=stated.epoch,
            time_scale=stated.time_scale,
            gyro=stream,
            attitudes=attitudes,
            intervals=tuple(span.interval for span in stated.interval),
            orbit=Orbit(**stated.orbit.model_dump()) if stated.orbit else None,
            tables={name: table for name, table in optional.items() if name not in sensor_tables.list_known_tables(optional)},
            sensors=sensors,
            without_references=without_references,
        )


def _build_stream(stated: header.GyroHeader, table: pd.DataFrame) -> GyroStream:
    """Build the gyro stream of a table, deg/s, and the header."""
    return GyroStream(
        t_s=_convert_columns(table, ("t_s",))[:, 0],
        rates=np.deg2rad(_convert_columns(table, RATE_COLUMNS)),
        sample_s=stated.sample_s,
        arw=float(np.deg2rad(stated.arw_deg_per_sqrt_s)),
        apriori_G=np.array(stated.apriori_G),
        apriori_bias=np.deg2rad(stated.apriori_bias_deg_s),
        arw_estimated=stated.arw_estimated,
        arw_degrees=float("inf") if stated.arw_dof is None else stated.arw_dof,
    )


def _read_attitudes(table: pd.DataFrame, stated: header.AttitudeHeader) -> Attitudes:
    """Read the reference attitudes of a table, whose sigmas are in deg."""
    correlated = [name for name in CORRELATION_COLUMNS if name in table.columns]
    if correlated and len(correlated) < len(CORRELATION_COLUMNS):
        raise InputError(f"columns {', '.join(CORRELATION_COLUMNS)} go together; only {', '.join(correlated)} is there")
    return Attitudes(
        t_s=_convert_columns(table, ("t_s",))[:, 0],
        quaternions=_convert_columns(table, QUATERNION_COLUMNS),
        sigma=np.deg2rad(_convert_columns(table, SIGMA_COLUMNS)),
        sigma_estimated=stated.sigma_estimated,
        correlation=_convert_columns(table, CORRELATION_COLUMNS) if correlated else None,
        sigma_degrees=float("inf") if stated.sigma_dof is None else stated.sigma_dof,
    )


def _convert_columns(table: pd.DataFrame, names: tuple[str, ...]) -> Array:
    """Convert columns to numbers (n, columns)."""
    return np.ascontiguousarray(table[list(names)].to_numpy(dtype=np.float64))


@contextmanager
def _name_in_error(path: Path) -> Iterator[None]:
    """Name the file or folder in the message of an `InputError`."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def save(recording: Recording, folder: str | os.PathLike[str]) -> None:
    """Write a recording and make its folder; an existing recording is replaced as a whole or, after an error, not at all."""
    from gyrocal.recording import parquet  # late, as pandas

    frames = tables.build_frames(recording.gyro, recording.attitudes, recording.tables, recording.sensors)
    absent = [f"{name}.parquet" for name in ("gyro", "attitude", *OPTIONAL_TABLES) if name not in frames]
    in_csv = [f"{name}.csv" for name in ("gyro", "attitude", *OPTIONAL_TABLES)]  # of the recording that is replaced
    files = {f"{name}.parquet": partial(parquet.write, frame) for name, frame in frames.items()}
    text = header.format_header(recording).encode()
    write_together(Path(folder), {**files, HEADER: lambda file: file.write(text)}, (*absent, *in_csv))
