"""What a file of a recording claims, looked at before it is read: a pipe or a device, or far more than a recording can be.

Nothing is read from what is no regular file, since a pipe without a writer waits for ever and /dev/zero never ends. A Parquet
file of a kilobyte may hold 10⁹ equal values; its footer says how many. CSV tells its columns in its first line, and cannot hold
more than its size.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

from gyrocal.errors import InputError

MOST_VALUES = 400_000_000  # in a table, 3.2 GB; 10⁷ samples of four columns are a tenth of it
MOST_FILE_COLUMNS = 1000
LARGEST_LINE = 1 << 20  # bytes of names
LARGEST_HEADER = 1 << 24  # bytes of recording.toml


def check_regular(path: Path) -> None:
    """Refuse a folder, pipe or device; a missing file is left for the reader to report."""
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return
    if not stat.S_ISREG(mode):
        raise InputError(f"{path}: not a regular file; a recording is read from files, not from folders, pipes or devices")


def check_header(path: Path) -> None:
    """Refuse a recording.toml that is no regular file, or as large as none is."""
    check_regular(path)
    if path.exists() and path.stat().st_size > LARGEST_HEADER:
        raise InputError(f"{path}: {path.stat().st_size} bytes are no header of a recording, of {LARGEST_HEADER} at most")


def check_table(path: Path) -> None:
    """Refuse a table that is no regular file or claims more than can be read; a damaged one is left to whoever reads it."""
    check_regular(path)
    rows, columns = _read_parquet_shape(path) if path.suffix == ".parquet" else (0, _count_csv_columns(path))
    if columns > MOST_FILE_COLUMNS:
        raise InputError(f"{path}: {columns} columns, of {MOST_FILE_COLUMNS} at most; keep those that are needed")
    if rows * columns > MOST_VALUES:
        what = f"{rows} rows of {columns} columns are more than can be read, {MOST_VALUES} values"
        raise InputError(f"{path}: {what}; cut the recording into parts")


def _read_parquet_shape(path: Path) -> tuple[int, int]:
    """Rows and columns that a Parquet file claims; zeros where it is damaged."""
    import pyarrow as pa  # late, as pandas
    import pyarrow.parquet as pq

    try:
        about = pq.read_metadata(path)
    except (pa.ArrowException, OSError):
        return 0, 0
    return int(about.num_rows), int(about.num_columns)


def _count_csv_columns(path: Path) -> int:
    """Columns that the first line of a CSV file names."""
    with path.open("rb") as file:
        return file.readline(LARGEST_LINE).count(b",") + 1
