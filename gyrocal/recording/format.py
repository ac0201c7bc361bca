"""A recording: a gyro stream, reference attitudes and calibration intervals; load, validate, save.

On disk a recording is one folder: ``recording.toml``, ``gyro.parquet`` (or ``.csv``), ``attitude.parquet`` and optional
tables. Files are in degrees, objects in radians. The gyro sample k is the mean body rate over [t_k, t_k + sample_s) as the
uncalibrated gyro shows it. Simulated and real data share the format, and nothing in it says which it is.

Format 1 holds the three gyros x, y and z and references of one sensor. Format 2 may have reference attitudes of several
sensors, and more named gyros, of which it may say which were switched on in an interval: both are joined when it is loaded.
What format 1 can hold is written in it.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.files import lock_folder, write_together
from gyrocal.recording import attitude_sensors, checks, header, sensor_tables, tables
from gyrocal.recording.gyro_join import join_gyros
from gyrocal.recording.parts import TIME_TOLERANCE_S, Attitudes, GyroStream, Orbit, build_empty_attitudes
from gyrocal.recording.recording_data import Recording
from gyrocal.recording.tables import CORRELATION_COLUMNS, OPTIONAL_TABLES, QUATERNION_COLUMNS, SIGMA_COLUMNS

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)

HEADER = "recording.toml"
IS_A_RECORDING = f"a recording is a folder with {HEADER} in it"


def load(folder: str | os.PathLike[str], *, without_references: bool = False) -> Recording:
    """Load and validate a recording.

    Parameters
    ----------
    folder : path of the recording's folder
    without_references : whether it may do without reference attitudes, as for their noise alone

    Raises
    ------
    InputError
        One line saying which file, where in it, and what is wrong.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: not a folder; {IS_A_RECORDING}")
    with lock_folder(folder, shared=True):
        if not (folder / HEADER).exists():
            raise InputError(f"{folder / HEADER}: no such file; {IS_A_RECORDING}")
        return _load(folder, without_references)


def _load(folder: Path, without_references: bool) -> Recording:
    said = header.read(folder / HEADER)
    rates = tuple(f"rate_{name}_deg_s" for name in said.gyro.names)
    gyro_name, gyro = tables.read(folder, "gyro", ("t_s", *rates), rates if len(rates) > 3 else ())
    attitude_name, attitude = "attitude", None
    without_references = without_references and tables.find(folder, "attitude") is None
    if not without_references:
        stated = bool(said.attitude.sensor) and all(one.sigma_deg for one in said.attitude.sensor)
        wanted = ("t_s", *QUATERNION_COLUMNS, *(() if stated else SIGMA_COLUMNS))
        attitude_name, attitude = tables.read(folder, "attitude", wanted)
    optional = {name: tables.read(folder, name, ("t_s",))[1] for name in OPTIONAL_TABLES if tables.find(folder, name)}
    with _name_in_error(folder / gyro_name):
        stream = _build_stream(said, tables.convert_column(gyro, "t_s"), np.deg2rad(tables.convert_columns(gyro, rates)))
    with _name_in_error(folder):
        sensors = sensor_tables.read(optional)
    with _name_in_error(folder / gyro_name):  # checked here first so that the message can name the file
        checks.check_gyro(stream)
    attitudes = build_empty_attitudes()
    if attitude is not None:
        with _name_in_error(folder / attitude_name):
            attitudes = _read_attitudes(attitude, said, stream)
            checks.check_attitudes(attitudes)
    with _name_in_error(folder):
        return Recording(
            title=said.title,
            epoch=said.epoch,
            time_scale=said.time_scale,
            gyro=stream,
            attitudes=attitudes,
            intervals=tuple(one.interval for one in said.interval),
            orbit=Orbit(**said.orbit.model_dump()) if said.orbit else None,
            tables={name: table for name, table in optional.items() if name not in sensor_tables.list_known_tables(optional)},
            sensors=sensors,
            without_references=without_references,
        )


def _build_stream(said: header.Header, t_s: Array, raw: Array) -> GyroStream:
    """Samples of the three gyros, or of the rates by more gyros, joined; of an interval those that were switched on."""
    gyro, names = said.gyro, said.gyro.names
    arw, G = float(np.deg2rad(gyro.arw_deg_per_sqrt_s)), np.array(gyro.apriori_G)
    if len(names) > 3:
        for one in said.interval:
            unknown = [name for name in one.gyros or () if name not in names]
            if unknown:
                raise InputError(f"interval {one.name}: no gyro {', '.join(unknown)}; there are {', '.join(names)}")
            inside = _find_samples(t_s, gyro.sample_s, one)
            raw[np.ix_(inside, np.array([one.gyros is not None and name not in one.gyros for name in names]))] = np.nan
        joined = join_gyros(raw, np.linalg.pinv(G), names=names)
        for text in joined.describe(arw / np.sqrt(gyro.sample_s)):
            logger.info("%s", text)
        kept = np.isfinite(joined.rates).all(axis=1)
        for one in said.interval:
            lost = np.flatnonzero(_find_samples(t_s, gyro.sample_s, one) & ~kept)
            if lost.size:
                raise InputError(
                    f"interval {one.name}: row {lost[0]} has fewer than three gyros that see all axes ({lost.size} such); "
                    "leave the interval out, or make three rates of the gyros by gyrocal import csv --gyros"
                )
        t_s, raw, arw, G = t_s[kept], joined.rates[kept], arw * joined.gain, np.eye(3)
    degrees = float("inf") if gyro.arw_dof is None else gyro.arw_dof
    return GyroStream(t_s, raw, gyro.sample_s, arw, G, np.deg2rad(gyro.apriori_bias_deg_s), gyro.arw_estimated, degrees)


def _find_samples(t_s: Array, sample_s: float, interval: header.IntervalHeader) -> NDArray[np.bool_]:
    """(n,) whether a sample has a part in an interval."""
    first, stop = interval.start_s - sample_s + TIME_TOLERANCE_S, interval.stop_s - TIME_TOLERANCE_S
    return np.asarray((t_s > first) & (t_s < stop))


def _read_attitudes(table: pd.DataFrame, said: header.Header, gyro: GyroStream) -> Attitudes:
    """The references of a table, those of several sensors joined."""
    degrees = float("inf") if said.attitude.sigma_dof is None else said.attitude.sigma_dof
    if said.attitude.sensor:
        from gyrocal.recording.reference_join import join_references  # late: it loads scipy

        joined = join_references(attitude_sensors.read(table, said.attitude.sensor), gyro)
        for text in joined.describe():
            logger.info("%s", text)
        return replace(joined.attitudes, sigma_estimated=said.attitude.sigma_estimated, sigma_degrees=degrees)
    attitude_sensors.check_unnamed(table, said.format)
    correlated = [name for name in CORRELATION_COLUMNS if name in table.columns]
    if correlated and len(correlated) < len(CORRELATION_COLUMNS):
        raise InputError(f"columns {', '.join(CORRELATION_COLUMNS)} go together; only {', '.join(correlated)} is there")
    return Attitudes(
        t_s=tables.convert_column(table, "t_s"),
        quaternions=tables.convert_columns(table, QUATERNION_COLUMNS),
        sigma=np.deg2rad(tables.convert_columns(table, SIGMA_COLUMNS)),
        sigma_estimated=said.attitude.sigma_estimated,
        correlation=tables.convert_columns(table, CORRELATION_COLUMNS) if correlated else None,
        sigma_degrees=degrees,
    )


@contextmanager
def _name_in_error(path: Path) -> Iterator[None]:
    """Name the file or folder in the message of an `InputError`."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def save(recording: Recording, folder: str | os.PathLike[str]) -> None:
    """Write a recording; the folder is made, and an existing recording in it is replaced as a whole or, after an error, not."""
    from gyrocal.recording import parquet  # late, as pandas

    frames = tables.build_frames(recording.gyro, recording.attitudes, recording.tables, recording.sensors)
    absent = [f"{name}.parquet" for name in ("gyro", "attitude", *OPTIONAL_TABLES) if name not in frames]
    in_csv = [f"{name}.csv" for name in ("gyro", "attitude", *OPTIONAL_TABLES)]  # of a recording that was here before
    files = {f"{name}.parquet": partial(parquet.write, frame) for name, frame in frames.items()}
    text = header.format_header(recording).encode()
    write_together(Path(folder), {**files, HEADER: lambda file: file.write(text)}, (*absent, *in_csv))
