"""A baseline: recordings and studies with their stored values, described by one TOML file, for comparisons in CI.

A recording is calibrated as by ``gyrocal calibrate``; changes of its parameters are in sigmas (`gyrocal.calibration.change`).
The rows of a study are the same on every backend, and changes of its values are relative: an absolute limit could miss a bias
of 1e-7 rad/s. The stored values are in the folder ``expected`` beside the file.
"""

from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import click
import numpy as np
import pandas as pd
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gyrocal.calibration.change import compute_change
from gyrocal.errors import InputError, suggest_names
from gyrocal.estimation.remainder_noise import read_calibration
from gyrocal.recording import format_validation_error, read_toml
from studies import catalogue
from studies.cli.calibrate import command as calibrate_command
from studies.montecarlo import engine
from studies.montecarlo.files import write_bytes, write_csv
from studies.montecarlo.study import load_config
from studies.report.calibration import check_limits
from studies.report.junit import Verdict

RTOL = 1e-7  # compilers and BLAS libraries differ in rounding, by 1e-9 and less
DIGITS = 12  # of stored values, more than the comparison uses
Name = Annotated[str, Field(pattern=r"^[\w.-]+$")]


class _Document(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class RecordingEntry(_Document):
    """A recording; settings are options of ``gyrocal calibrate``, and limits are those of its --max-sigma and --max-change."""

    path: str
    settings: dict[str, Any] = {}
    max_sigma: float = Field(default=0.1, gt=0)
    max_change: tuple[str, ...] = ()

    def compute(self, folder: Path, out: Path) -> None:
        """Calibrate the recording and write the result."""
        calibrate_to_json(folder / self.path, self.settings, out)

    def compare(self, stored: Path, new: Path) -> tuple[list[Verdict], pd.DataFrame]:
        """Compare two results: a verdict a limit, and a table of the limits that are not kept."""
        old, now = read_calibration(stored), read_calibration(new)
        same = old.recording_sha256 == now.recording_sha256
        change = compute_change(old.parameters, old.covariance, now.parameters, now.covariance, same)
        verdicts = check_limits(change, self.max_sigma, self.max_change)
        moved = [{"limit": verdict.name, "change": verdict.failure} for verdict in verdicts if verdict.failure]
        return verdicts, pd.DataFrame(moved)


class StudyEntry(_Document):
    """A study's name or file; limits are the largest changes of its columns' values, in place of RTOL of each value."""

    path: str
    settings: dict[str, Any] = {}
    cases: int | None = None
    limits: dict[str, float] = {}

    def compute(self, folder: Path, out: Path) -> None:
        """Run the study and write its rows."""
        study = catalogue.find_entry(str(folder / self.path) if catalogue.is_file(self.path) else self.path).study
        config = load_config(study, None, self.settings | ({} if self.cases is None else {"cases": self.cases}))
        with TemporaryDirectory() as work:
            rows = engine.run(study, config, Path(work), backend="serial").load()
        for column in set(self.limits) - set(rows):
            raise InputError(f"limits.{column}: no such column; {suggest_names(column, map(str, rows))}")
        write_csv(out, rows, DIGITS)

    def compare(self, stored: Path, new: Path) -> tuple[list[Verdict], pd.DataFrame]:
        """Compare two sets of rows: a verdict a column, and a table of moved values."""
        moved = find_changed_values(read_rows(stored), read_rows(new), self.limits)
        counts = moved["quantity"].value_counts()
        names = dict.fromkeys([*read_rows(new), *counts.index])
        return [Verdict(name, f"{counts[name]} values moved" if name in counts else "") for name in names], moved


class Baseline(_Document):
    """The entries of a file, by name."""

    recordings: dict[Name, RecordingEntry] = {}
    studies: dict[Name, StudyEntry] = {}


@dataclass(frozen=True)
class Comparison:
    """An entry of a baseline against its stored values: the verdicts on its limits, and a table of moved values."""

    name: str
    verdicts: list[Verdict]
    moved: pd.DataFrame


def compare_baseline(path: Path, write: bool = False) -> list[Comparison]:
    """Compute all entries of a baseline and compare them with the stored values, which `write` replaces.

    `InputError` if the file describes no baseline, has no stored values, or an entry cannot be computed.
    """
    try:
        baseline = Baseline.model_validate(read_toml(path))
    except ValidationError as error:
        raise InputError(f"{path}: {format_validation_error(error, Baseline)}") from None
    entries: dict[tuple[str, str], Any] = {("recordings", name): entry for name, entry in baseline.recordings.items()}
    entries |= {("studies", name): entry for name, entry in baseline.studies.items()}
    if not entries:
        raise InputError(f"{path}: describes nothing; give [recordings.NAME] or [studies.NAME] with a path, see docs/ci.md")
    comparisons = []
    for (kind, name), entry in entries.items():
        stored = path.parent / "expected" / f"{name}{'.json' if kind == 'recordings' else '.csv'}"
        if not (stored.exists() or write):
            raise InputError(f"{stored}: no stored values there; write them with --write")
        with TemporaryDirectory() as folder:
            new = Path(folder) / stored.name
            try:
                entry.compute(path.parent, new)
            except (InputError, click.UsageError) as error:
                raise InputError(f"{path}: {kind}.{name}: {error}") from None
            comparisons.append(Comparison(f"{kind}.{name}", *entry.compare(stored if stored.exists() else new, new)))
            if write:
                write_bytes(stored, new.read_bytes())
    return comparisons


def calibrate_to_json(recording: Path, settings: Mapping[str, Any], out: Path) -> None:
    """Calibrate a recording by ``gyrocal calibrate``, with options by their names, and write its JSON."""
    options = [word for key, value in settings.items() for word in (f"--{key.replace('_', '-')}", str(value))]
    with redirect_stdout(StringIO()):
        calibrate_command.main([str(recording), *options, "--json", str(out)], standalone_mode=False)


def read_rows(path: Path) -> pd.DataFrame:
    """Read stored rows of a study."""
    try:
        return pd.read_csv(path)
    except ValueError as fault:  # pandas' parser errors, and those of UTF-8, are ValueErrors
        raise InputError(f"{path}: not rows of a study: {' '.join(str(fault).split())}") from None


def find_changed_values(old: pd.DataFrame, new: pd.DataFrame, limits: Mapping[str, float] | None = None) -> pd.DataFrame:
    """Find values that differ by more than their column's limit, by default relative RTOL, the largest change first."""
    if list(old.columns) != list(new.columns) or len(old) != len(new):
        return pd.DataFrame({"quantity": ["rows or columns"], "old": [str(old.shape)], "new": [str(new.shape)]})
    numeric_columns = [set(table.select_dtypes("number")) for table in (old, new)]
    labels = new[[name for name in new if name == "case" or not (name in numeric_columns[1] or new[name].isna().all())]]
    parts = []
    for name in new:
        before, after = old[name], new[name]
        relative: Any = np.nan
        same = (before == after) | (before.isna() & after.isna())
        if name in numeric_columns[0] & numeric_columns[1]:
            change = (after - before).abs()
            relative = change / before.abs()
            same |= change <= (limits or {}).get(str(name), RTOL * before.abs())
        part = labels.assign(quantity=str(name), old=before.astype(object), new=after.astype(object), relative_change=relative)
        parts.append(part[~same])
    return pd.concat(parts).sort_values("relative_change", ascending=False, ignore_index=True)
