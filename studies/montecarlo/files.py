"""The files a study or a command writes: text, JSON and tables, each through `gyrocal.files.open_replacement`."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gyrocal.files import open_replacement

if TYPE_CHECKING:
    import pandas as pd


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file, in a folder that is made if need be."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open_replacement(path) as file:
        file.write(data)


def write_text(path: Path, text: str) -> None:
    """Write text as UTF-8."""
    write_bytes(path, text.encode())


def format_json(value: Any) -> str:
    """Format a value as JSON for people; NaN and infinity become null, numpy's scalars numbers."""
    return json.dumps(convert_to_plain(value), indent=2, ensure_ascii=False, allow_nan=False)


def write_json(path: Path, value: Any) -> None:
    """Write a value as `format_json`."""
    write_text(path, format_json(value) + "\n")


def write_csv(path: Path, table: pd.DataFrame, digits: int = 9) -> None:
    """Write a table as CSV, its numbers with `digits` significant digits, also in columns that hold texts too."""
    table = table.copy()
    for name in [name for name in table if table[name].dtype == object]:
        table[name] = [float(f"{value:.{digits}g}") if isinstance(value, float) else value for value in table[name]]
    write_text(path, table.to_csv(index=False, float_format=f"%.{digits}g"))


def write_parquet(path: Path, table: pd.DataFrame) -> None:
    """Write a table as Parquet with zstd compression: answers of a thousand diagnoses are repetitive text."""
    with open_replacement(path) as file:
        table.to_parquet(file, index=False, write_page_checksum=True, compression="zstd")


def convert_to_plain(value: Any) -> Any:
    """Convert a value to JSON's types: numpy's scalars and arrays to numbers and lists, not finite numbers to None."""
    if isinstance(value, dict):
        return {str(key): convert_to_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [convert_to_plain(item) for item in value]
    if isinstance(value, np.generic | np.ndarray):
        return convert_to_plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value
