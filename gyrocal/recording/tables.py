"""The tables of a recording: read from its folder, and built from its parts.

Files are in degrees, objects in radians. The claimed size of a file is checked before it is read: a pipe without a writer waits
for ever, /dev/zero never ends, and a Parquet file of a kilobyte may hold 10⁹ equal values. The footer of a Parquet file states
the number of values; the first line of a CSV file has its columns, and its size limits the number of values.
"""

from __future__ import annotations

import os
import stat
import warnings
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from gyrocal.errors import InputError
from gyrocal.recording import sensor_tables
from gyrocal.recording.parts import Attitudes, GyroStream
from gyrocal.recording.sensor_tables import SensorTables

if TYPE_CHECKING:
    import pandas as pd


RATE_COLUMNS = ("rate_x_deg_s", "rate_y_deg_s", "rate_z_deg_s")
QUATERNION_COLUMNS = ("q1", "q2", "q3", "q4")
SIGMA_COLUMNS = ("sigma_x_deg", "sigma_y_deg", "sigma_z_deg")
CORRELATION_COLUMNS = ("rho_xy", "rho_xz", "rho_yz")  # optional, of the errors of an attitude about two body axes
OPTIONAL_TABLES = ("housekeeping", "masked", *sensor_tables.OWN_COLUMNS)
MOST_VALUES = 400_000_000  # in a table, 3.2 GB; 10⁷ samples of four columns are a tenth of it
MOST_FILE_COLUMNS = 1000
LARGEST_LINE = 1 << 20  # bytes of names


def find(folder: Path, name: str) -> Path | None:
    """Find the file of a table; None if there is none."""
    paths = [folder / (name + suffix) for suffix in (".parquet", ".csv") if (folder / (name + suffix)).exists()]
    if len(paths) > 1:
        raise InputError(f"{folder}: both {name}.parquet and {name}.csv are there; keep the one that is meant")
    return paths[0] if paths else None


def read(folder: Path, name: str, required: tuple[str, ...]) -> tuple[str, pd.DataFrame]:
    """Read a table with finite numbers in the required columns; return the name of its file and the table."""
    import pandas as pd  # late: 65 MiB that a Monte Carlo worker does without

    from gyrocal.recording import parquet  # late, as pandas

    path = find(folder, name)
    if path is None:
        raise InputError(f"{folder}: neither {name}.parquet nor {name}.csv is there")
    _check_claimed_size(path)
    try:
        frame = parquet.read(path) if path.suffix == ".parquet" else read_csv_file(path)
    except pd.errors.EmptyDataError:
        raise InputError(f"{path}: the file is empty") from None
    except Exception as fault:  # pyarrow and pandas raise a zoo of types for a damaged file
        raise InputError(f"{path}: cannot be read: {' '.join(str(fault).split())}") from None
    missing = [column for column in required if column not in frame.columns]
    if missing:
        close = [str(c) for c in frame.columns if any(str(c).startswith(m.rsplit("_deg", 1)[0]) for m in missing)]
        if len(frame.columns) == 1:
            hint = "; is the separator a comma?"
        elif close:
            hint = f"; found {', '.join(close)}: the name says the unit, so convert it, or rename it if that is its unit"
        else:
            hint = f"; found {', '.join(map(str, frame.columns))}"
        raise InputError(f"{path}: column {', '.join(missing)} is missing{hint}")
    if frame.empty:
        raise InputError(f"{path}: no rows")
    for column in required:
        if not pd.api.types.is_numeric_dtype(frame[column]) or pd.api.types.is_bool_dtype(frame[column]):
            raise InputError(f"{path}: column {column} holds {frame[column].dtype}, not numbers")
        bad = np.flatnonzero(~np.isfinite(frame[column].to_numpy(dtype=float)))
        if bad.size:
            raise InputError(
                f"{path}: column {column}, row {bad[0]}: not a finite number ({bad.size} such); drop or repair these rows"
            )
    return path.name, frame


def check_regular(path: Path) -> None:
    """Refuse a folder, pipe or device; a missing file is left for the reader to report."""
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return
    if not stat.S_ISREG(mode):
        raise InputError(f"{path}: not a regular file; a recording is read from files, not from folders, pipes or devices")


def _check_claimed_size(path: Path) -> None:
    """Refuse a table that is no regular file or claims more values than can be read; the reader reports damage."""
    import pyarrow as pa  # late, as pandas
    import pyarrow.parquet as pq

    check_regular(path)
    rows, columns = 0, 0
    if path.suffix == ".parquet":
        with suppress(pa.ArrowException, OSError):
            about = pq.read_metadata(path)
            rows, columns = int(about.num_rows), int(about.num_columns)
    else:
        with path.open("rb") as file:
            columns = file.readline(LARGEST_LINE).count(b",") + 1
    if columns > MOST_FILE_COLUMNS:
        raise InputError(f"{path}: {columns} columns, of {MOST_FILE_COLUMNS} at most; keep those that are needed")
    if rows * columns > MOST_VALUES:
        what = f"{rows} rows of {columns} columns are more than can be read, {MOST_VALUES} values"
        raise InputError(f"{path}: {what}; cut the recording into parts")


def read_csv_file(path: Path | IO[bytes], **options: Any) -> pd.DataFrame:
    """Read a CSV file without the loss of fields, which pandas drops with a warning; a comma at the end of each row is allowed.

    A `ValueError` if a row has more fields than the header has names, or the file is damaged.

    Parameters
    ----------
    path : of the file, or the file
    options : of `pandas.read_csv`
    """
    import pandas as pd  # late, as above

    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        warnings.simplefilter("ignore", pd.errors.DtypeWarning)  # callers check that their columns hold numbers
        try:
            return pd.read_csv(path, index_col=False, **options)
        except pd.errors.ParserWarning:
            text = "a row has more fields than the header has names; is a comma the decimal sign, or a name missing?"
            raise ValueError(text) from None


def build_frames(
    gyro: GyroStream, attitudes: Attitudes, others: Mapping[str, pd.DataFrame], sensors: SensorTables | None
) -> dict[str, pd.DataFrame]:
    """Build the tables of a recording as on file."""
    import pandas as pd  # late: 65 MiB that a Monte Carlo worker does without

    frames = {"gyro": pd.DataFrame(np.column_stack([gyro.t_s, gyro.rates_deg_s]), columns=["t_s", *RATE_COLUMNS])}
    if attitudes.t_s.size:
        columns = ["t_s", *QUATERNION_COLUMNS, *SIGMA_COLUMNS]
        values = [attitudes.t_s, attitudes.quaternions, attitudes.sigma_deg]
        if attitudes.correlation is not None:
            columns, values = [*columns, *CORRELATION_COLUMNS], [*values, attitudes.correlation]
        frames["attitude"] = pd.DataFrame(np.column_stack(values), columns=columns)
    return frames | dict(others) | (sensor_tables.build_sensor_frames(sensors) if sensors is not None else {})
