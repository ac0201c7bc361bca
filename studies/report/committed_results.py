"""Comparison of a reproduction's results with the committed ones: which numbers agree, and which moved.

Processors, compilers and libraries of linear algebra differ in the last bits of a sum. With other kernels of linear algebra and
without vector instructions, N's tables differ by at most 9e-8 relative, most numbers by 1e-9 and less. Results are therefore
rounded to `SIGNIFICANT_DIGITS`, and a number has moved if it differs by more than one unit of the last digit.
"""

import json
from dataclasses import dataclass, field
from math import isclose
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from studies.report.tables import SIGNIFICANT_DIGITS

ROOM = 1.1e-5  # relative: one unit of the last of them
ZERO_TOLERANCE = 1e-12  # of numbers that are zero but for rounding
COLUMN_ZERO_TOLERANCE = 1e-9  # of the largest number of a column: smaller numbers are zero but for rounding
RESULT_SETTINGS = ("cases", "entropy", "scenario", "overrides", "days", "seeds", "slews")  # settings that results depend on


@dataclass(frozen=True)
class Results:
    """Settings, summary and tables of one results folder."""

    folder: Path  # its path
    config: dict[str, Any]  # settings that the results depend on
    summary: dict[str, Any]  # of ``summary.json``, as paths and values
    tables: dict[str, pd.DataFrame] = field(repr=False)  # of the CSV files, by name


def round_values(value: Any) -> Any:
    """Round the numbers of a summary's value to `SIGNIFICANT_DIGITS`."""
    if isinstance(value, dict):
        return {key: round_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [round_values(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(f"{value:.{SIGNIFICANT_DIGITS}g}")
    return value


def read(folder: Path) -> Results | None:
    """Read the results in a folder; None if there is no summary."""
    try:
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        config = json.loads((folder / "manifest.json").read_text(encoding="utf-8")).get("config", {})
    except (OSError, ValueError):
        return None
    tables = {path.stem: pd.read_csv(path) for path in sorted(folder.glob("*.csv"))}
    return Results(folder, {key: config[key] for key in RESULT_SETTINGS if key in config}, flatten(summary), tables)


def flatten(value: Any, path: str = "") -> dict[str, Any]:
    """Return the leaves of a document by their paths, such as "a.b.0"."""
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    if parts is None:
        return {path: value}
    return {name: leaf for key, part in parts for name, leaf in flatten(part, f"{path}.{key}" if path else str(key)).items()}


def list_moved_numbers(now: Results, then: Results) -> pd.DataFrame:
    """List the numbers that differ: file, place, committed and new value; empty if none does."""
    rows = []
    for name in dict.fromkeys([*then.summary, *now.summary]):
        old, new = then.summary.get(name, "not there"), now.summary.get(name, "not there")
        if not _is_same(old, new):
            rows.append(("summary.json", name, old, new))
    for name in dict.fromkeys([*then.tables, *now.tables]):
        rows += _compare_cells(name, then.tables.get(name), now.tables.get(name))
    return pd.DataFrame(rows, columns=["file", "number", "committed", "now"])


def _is_same(old: Any, new: Any) -> bool:
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in (old, new)):
        return isclose(old, new, rel_tol=ROOM, abs_tol=ZERO_TOLERANCE)
    return bool(old == new)


def _compare_cells(name: str, then: pd.DataFrame | None, now: pd.DataFrame | None) -> list[tuple[str, str, Any, Any]]:
    """List the cells of a table that moved: file, place, committed and new value; a table of another shape is one entry."""
    file = f"{name}.csv"
    if then is None or now is None:
        return [(file, "the table", "not there" if then is None else "there", "not there" if now is None else "there")]
    if list(then.columns) != list(now.columns) or len(then) != len(now):
        return [(file, "rows × columns", f"{then.shape[0]} × {then.shape[1]}", f"{now.shape[0]} × {now.shape[1]}")]
    rows: list[tuple[str, str, Any, Any]] = []
    for column in then.columns:
        old, new = then[column], now[column]
        if pd.api.types.is_numeric_dtype(old) and pd.api.types.is_numeric_dtype(new):
            old_values, new_values = old.to_numpy(dtype=float), new.to_numpy(dtype=float)
            tolerance = COLUMN_ZERO_TOLERANCE * np.nanmax(np.abs(old_values), initial=0.0) + ZERO_TOLERANCE
            same = np.isclose(new_values, old_values, rtol=ROOM, atol=tolerance, equal_nan=True)
        else:
            same = (old.fillna("") == new.fillna("")).to_numpy()
        rows += [(file, f"{column}, row {k + 1}", old.iloc[k], new.iloc[k]) for k in np.flatnonzero(~same)]
    return rows


def compare_results(now: Results, then: Results | None) -> tuple[str, pd.DataFrame]:
    """Compare results with committed ones: a summary, and the numbers that moved."""
    if then is None:
        return f"{now.folder}: nothing committed to compare with.", pd.DataFrame()
    if now.config != then.config:
        keys = [key for key in dict.fromkeys([*then.config, *now.config]) if now.config.get(key) != then.config.get(key)]
        changes = ", ".join(f"{key}: {then.config.get(key)} → {now.config.get(key)}" for key in keys)
        return f"{now.folder}: not compared with {then.folder}, which was made with other settings ({changes}).", pd.DataFrame()
    differences = list_moved_numbers(now, then)
    count = f"{len(then.summary)} numbers of the summary and {len(then.tables)} tables"
    if differences.empty:
        within = f"each within one unit of the {SIGNIFICANT_DIGITS}th digit"
        return f"{now.folder} agrees with {then.folder}: {count}, {within}.", differences
    files = ", ".join(f"{len(part)} in {name}" for name, part in differences.groupby("file", sort=False))
    return f"{now.folder} DIFFERS from {then.folder}: {len(differences)} numbers moved ({files}), of {count}.", differences
