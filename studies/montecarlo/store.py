"""Parts: the rows of a study on disk, a Parquet file per chunk of cases.

A part is written under another name and then renamed, so that it is there whole or not at all, and is found by its number,
never by looking what files there are. Its metadata say which configuration it is of, and its pages carry checksums: when a
study is resumed, a damaged part is seen, set aside and computed again. Nothing is forced to the disk (fsync), which would cost
more than a chunk: a part lost in a power failure is a damaged part.

The table holds the rows in the order of the cases, in row groups of a fixed size, so that its bytes do not depend on how the
cases were cut into parts.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from gyrocal.errors import GyrocalError, InputError, suggest_names
from gyrocal.files import TEMPORARY, open_replacement
from studies.montecarlo.files import write_bytes

ROW_GROUP = 8192  # rows of the table's row groups
METADATA = b"gyrocal"


@dataclass(frozen=True)
class PartInfo:
    """What a part says about itself.

    Attributes
    ----------
    failures : error of each failed case
    cpu_s : CPU time of its cases
    """

    failures: dict[int, str]
    cpu_s: float


def build_table(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Rows as a table; a column is there for every name that a row has, in order of appearance."""
    names = dict.fromkeys(name for row in rows for name in row)
    return pa.table({name: _build_array([row.get(name) for row in rows]) for name in names})


def _build_array(values: list[Any]) -> pa.Array:
    if any(isinstance(value, float) for value in values):
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    return pa.array(values)


@dataclass(frozen=True)
class Parts:
    """The parts of a study.

    Attributes
    ----------
    folder : of the study
    cases : number of cases
    chunk : cases in a part
    config_sha256 : hash of what the rows depend on
    """

    folder: Path
    cases: int
    chunk: int
    config_sha256: str

    def __len__(self) -> int:
        return -(-self.cases // self.chunk)

    def list_cases(self, index: int) -> range:
        """The cases of a part."""
        return range(index * self.chunk, min((index + 1) * self.chunk, self.cases))

    def path(self, index: int) -> Path:
        """The file of a part."""
        return self.folder / "parts" / f"part-{index:06d}.parquet"

    def remove_temporary(self) -> None:
        """Remove what a killed run left half written."""
        for folder in (self.folder, self.folder / "parts", self.folder / "failures"):
            for path in folder.glob(f"*{TEMPORARY}"):
                path.unlink(missing_ok=True)

    def write(self, index: int, rows: Sequence[Mapping[str, Any]], cpu_s: float) -> None:
        """Write a part: the rows of its cases in their order, and their CPU time."""
        about = json.dumps({"config_sha256": self.config_sha256, "cpu_s": cpu_s})
        sink = pa.BufferOutputStream()
        pq.write_table(build_table(rows).replace_schema_metadata({METADATA: about}), sink, write_page_checksum=True)
        write_bytes(self.path(index), sink.getvalue())

    def read(self, index: int) -> pa.Table:
        """Read the rows of a part, what it says about itself in the schema's metadata."""
        with pq.ParquetFile(self.path(index), page_checksum_verification=True) as file:
            return file.read()

    def inspect(self, index: int) -> PartInfo | str | None:
        """Read the description of a part on disk; text if it is damaged, None if cases of it are missing.

        Raises
        ------
        InputError
            It is of another configuration.
        """
        if not self.path(index).exists():
            return None
        try:
            table = self.read(index)
            about = json.loads((table.schema.metadata or {})[METADATA])
            numbers, errors = (table.column(name).to_pylist() for name in ("case", "error"))
        except (OSError, pa.ArrowException, KeyError, ValueError) as error:
            return " ".join(str(error).split()) or type(error).__name__
        if about["config_sha256"] != self.config_sha256:
            raise InputError(f"{self.path(index)}: belongs to a study with another configuration; choose another folder")
        cases, held = self.list_cases(index), sorted(set(numbers))
        if held != list(cases)[: len(held)]:
            return f"it does not hold the cases {cases.start} to {cases.stop - 1}"
        failures = {number: error for number, error in zip(numbers, errors, strict=True) if error}
        # The last part of a study that had fewer cases when it was written has to be computed again.
        return PartInfo(failures, about["cpu_s"]) if len(held) == len(cases) else None

    def read_case_rows(self, case: int) -> pd.DataFrame | None:
        """The rows of one case; None if they are not there or damaged."""
        index = case // self.chunk
        if not isinstance(self.inspect(index), PartInfo):
            return None
        return self.read(index).filter(pc.field("case") == case).to_pandas()

    def set_aside(self, index: int) -> Path:
        """Rename a damaged part; returns its new path."""
        return self.path(index).rename(self.path(index).with_suffix(".corrupt"))

    def table(self, stop: int) -> pa.Table:
        """Rows of the first cases, which are those of whole parts and are there, in one piece.

        Raises
        ------
        GyrocalError
            A column does not hold the same kind of value in all parts.
        """
        tables = [self.read(index).replace_schema_metadata(None) for index in range(-(-stop // self.chunk))]
        try:
            return pa.concat_tables(tables, promote_options="permissive").combine_chunks()
        except pa.ArrowException as error:
            raise GyrocalError(f"{self.folder}: a column is of another kind in some parts than in others: {error}") from None

    def values(self, column: str, stop: int) -> pd.DataFrame:
        """Columns case, error and another of the first cases.

        Raises
        ------
        InputError
            No case has that column.
        """
        table = self.table(stop)
        if column not in table.column_names:
            raise InputError(f"{column}: the rows have no such column; {suggest_names(column, table.column_names)}")
        return table.select(list(dict.fromkeys(["case", "error", column]))).to_pandas()

    def write_table(self, path: Path) -> None:
        """Write the table of all parts; if it cannot be written, the one that was there before stays."""
        table = self.table(self.cases)
        with open_replacement(path) as file:
            pq.write_table(table, file, row_group_size=ROW_GROUP, write_page_checksum=True)
