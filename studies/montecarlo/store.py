"""Parts: the rows of a study on disk, a Parquet file for some cases each.

A part is written under another name and then renamed, so that it is complete or missing, and is found by its number, never by
listing files. Its metadata name its configuration, and its pages carry checksums: when a study is resumed, a damaged part is
detected and computed again. Nothing is forced to the disk (fsync), which would cost more than the part: a part lost in a power
failure is a damaged part.

The table holds the rows in the order of the cases, in row groups of a fixed size, so that its bytes do not depend on how the
cases were cut into parts.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from gyrocal.errors import GyrocalError, InputError
from gyrocal.files import TEMPORARY, open_replacement
from studies.montecarlo.files import write_bytes

ROW_GROUP = 8192  # rows of the table's row groups
METADATA = b"gyrocal"
LARGEST_PART = 64  # cases
ANOTHER_FOLDER = "choose another --out, or delete the folder"
PARTS = 128  # least number of parts of a study with at least as many cases


class PartInfo(NamedTuple):
    """Error of each failed case of a part, and CPU time of its cases, s."""

    failures: dict[int, str]
    cpu_s: float


def build_table(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Build a table of rows, with a column for every name in a row, in order of appearance."""
    names = dict.fromkeys(name for row in rows for name in row)
    return pa.table({name: _build_array([row.get(name) for row in rows]) for name in names})


def _build_array(values: list[Any]) -> pa.Array:
    """Build a column; one with a float among whole numbers is of floats."""
    if any(isinstance(value, float) for value in values):
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    return pa.array(values)


@dataclass(frozen=True)
class Parts:
    """The parts of a study in its folder, with its number of cases and the hash of its configuration."""

    folder: Path
    cases: int
    config_sha256: str

    @property
    def size(self) -> int:
        """Number of cases in a part."""
        return min(LARGEST_PART, -(-self.cases // PARTS))

    def list_ranges(self) -> list[range]:
        """List the cases of each part."""
        return [range(start, min(start + self.size, self.cases)) for start in range(0, self.cases, self.size)]

    def path(self, case: int) -> Path:
        """Return the file of the part that has a case."""
        return self.folder / "parts" / f"part-{case // self.size:06d}.parquet"

    def remove_temporary(self) -> None:
        """Remove the half-written files of a killed run."""
        for folder in (self.folder, self.folder / "parts", self.folder / "failures"):
            for path in folder.glob(f"*{TEMPORARY}"):
                path.unlink(missing_ok=True)

    def write(self, cases: range, rows: Sequence[Mapping[str, Any]], cpu_s: float) -> None:
        """Write a part: the rows of its cases in their order, and their CPU time."""
        about = json.dumps({"config_sha256": self.config_sha256, "cpu_s": cpu_s})
        sink = pa.BufferOutputStream()
        pq.write_table(build_table(rows).replace_schema_metadata({METADATA: about}), sink, write_page_checksum=True)
        write_bytes(self.path(cases.start), sink.getvalue())

    def read(self, case: int) -> pa.Table:
        """Read the rows of the part that has a case; the schema's metadata describe it."""
        with pq.ParquetFile(self.path(case), page_checksum_verification=True) as file:
            return file.read()

    def inspect(self, cases: range) -> PartInfo | str | None:
        """Read the description of a part: text if it is damaged, None if there is none, `InputError` if of another study."""
        path = self.path(cases.start)
        if not path.exists():
            return None
        try:
            table = self.read(cases.start)
            about = json.loads((table.schema.metadata or {})[METADATA])
            numbers, errors = (table.column(name).to_pylist() for name in ("case", "error"))
        except (OSError, pa.ArrowException, KeyError, ValueError) as error:
            return " ".join(str(error).split()) or type(error).__name__
        if about["config_sha256"] != self.config_sha256:
            raise InputError(f"{path}: belongs to a study with another configuration; {ANOTHER_FOLDER}")
        if sorted(set(numbers)) != list(cases):
            return f"it does not hold the cases {cases.start} to {cases.stop - 1}"
        return PartInfo({number: error for number, error in zip(numbers, errors, strict=True) if error}, about["cpu_s"])

    def read_case_rows(self, case: int) -> pd.DataFrame | None:
        """Read the rows of one case; None if they are missing or damaged."""
        start = case - case % self.size
        if not isinstance(self.inspect(range(start, min(start + self.size, self.cases))), PartInfo):
            return None
        return self.read(case).filter(pc.field("case") == case).to_pandas()

    def table(self, stop: int) -> pa.Table:
        """Read the rows of the first cases, which must be whole parts, as one table."""
        tables = [self.read(case).replace_schema_metadata(None) for case in range(0, stop, self.size)]
        try:
            return pa.concat_tables(tables, promote_options="permissive").combine_chunks()
        except pa.ArrowException as error:
            raise GyrocalError(f"{self.folder}: a column is of another kind in some parts than in others: {error}") from None

    def write_table(self, path: Path, stop: int) -> None:
        """Write the table of the first cases; if it cannot be written, the one that was there before stays."""
        table = self.table(stop)
        with open_replacement(path) as file:
            pq.write_table(table, file, row_group_size=ROW_GROUP, write_page_checksum=True)
