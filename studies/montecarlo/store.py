"""Parts: the rows of a study on disk, a Parquet file per chunk of cases.

A part is written under another name and then renamed, so that it is there whole or not at all, and is found by its number,
never by looking what files there are. Its metadata say which cases of which configuration it holds, and its pages carry
checksums: when a study is resumed, a damaged part is seen, set aside and computed again. Nothing is forced to the disk
(fsync), which would cost more than a chunk: a part lost in a power failure is a damaged part.

The table is streamed from the parts, one at a time. It holds the rows in the order of the cases, in row groups of a fixed
size, so that its bytes do not depend on how the cases were cut into parts.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from gyrocal.errors import GyrocalError, InputError, hint
from gyrocal.files import TEMPORARY, replacing
from studies.montecarlo.files import write_bytes

ROW_GROUP = 8192  # rows of the table's row groups
METADATA = b"gyrocal"
FAILED = ("case", "error")


@dataclass(frozen=True)
class PartInfo:
    """What a part says about itself.

    Attributes
    ----------
    failures : error of each failed case
    cpu_s : CPU time of its cases
    stop : end of its cases; below that of its range, where the study had fewer cases when it was written
    """

    failures: dict[int, str]
    cpu_s: float
    stop: int


def table_of(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Rows as a table; a column is there for every name that a row has, in order of appearance."""
    names = dict.fromkeys(name for row in rows for name in row)
    return pa.table({name: _array([row.get(name) for row in rows]) for name in names})


def _array(values: list[Any]) -> pa.Array:
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
    config_sha256 : hash of the configuration
    same : hashes of configurations whose rows are the same, but for the number of cases
    """

    folder: Path
    cases: int
    chunk: int
    config_sha256: str
    same: frozenset[str] = frozenset()

    def __len__(self) -> int:
        return -(-self.cases // self.chunk)

    def range(self, index: int) -> range:
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
        """Write a part.

        Parameters
        ----------
        index : of the part
        rows : of its cases, in their order
        cpu_s : CPU time of its cases
        """
        cases, sink = range(self.range(index).start, rows[-1]["case"] + 1), pa.BufferOutputStream()
        about = {"config_sha256": self.config_sha256, "first": cases.start, "stop": cases.stop, "cpu_s": cpu_s}
        table = table_of(rows).replace_schema_metadata({METADATA: json.dumps(about)})
        pq.write_table(table, sink, write_page_checksum=True)
        write_bytes(self.path(index), sink.getvalue())

    def inspect(self, index: int) -> PartInfo | str | None:
        """What a part on disk says about itself; text saying what is wrong with it, or None if it is not there.

        Raises
        ------
        InputError
            It is of another configuration.
        """
        path = self.path(index)
        if not path.exists():
            return None
        try:
            with pq.ParquetFile(path, page_checksum_verification=True) as file:
                about = json.loads((file.schema_arrow.metadata or {})[METADATA])
                table = file.read()
            numbers, errors = (table.column(name).to_pylist() for name in FAILED)
        except (OSError, pa.ArrowException, KeyError, ValueError) as error:
            return " ".join(str(error).split()) or type(error).__name__
        if about["config_sha256"] not in {self.config_sha256, *self.same}:
            raise InputError(f"{path}: belongs to a study with another configuration; choose another folder")
        expected = self.range(index)
        stop = min(max(about["stop"], expected.start + 1), expected.stop)
        if sorted(set(numbers)) != list(range(expected.start, stop)):
            return f"it does not hold the cases {expected.start} to {stop - 1}"
        failures = {number: error for number, error in zip(numbers, errors, strict=True) if error}
        return PartInfo(failures, about["cpu_s"], stop)

    def rows(self, index: int) -> list[dict[str, Any]]:
        """The rows of a part that is there, as they were written."""
        rows: list[dict[str, Any]] = pq.ParquetFile(self.path(index)).read().to_pylist()
        return rows

    def values(self, column: str, stop: int) -> pd.DataFrame:
        """Columns case, error and another of the first cases, which are there.

        Raises
        ------
        InputError
            No case has that column.
        """
        tables: list[pa.Table] = []
        names: dict[str, None] = {}
        for index in range(-(-stop // self.chunk)):
            with pq.ParquetFile(self.path(index)) as file:
                here = file.schema_arrow.names
                names |= dict.fromkeys(here)
                tables.append(file.read([*FAILED, *([column] if column in here else [])]).replace_schema_metadata(None))
        if column not in names:
            raise InputError(f"{column}: the rows have no such column; {hint(column, names)}")
        found = pa.concat_tables(tables, promote_options="permissive").to_pandas()
        return found[found["case"] < stop]

    def rows_of(self, case: int) -> pd.DataFrame | None:
        """The rows of one case; None if they are not there or damaged."""
        if not isinstance(self.inspect(case // self.chunk), PartInfo):
            return None
        table = pq.ParquetFile(self.path(case // self.chunk)).read()
        return table.filter(pc.field("case") == case).to_pandas()

    def set_aside(self, index: int) -> Path:
        """Rename a damaged part; returns its new path."""
        path = self.path(index)
        aside = path.with_suffix(".corrupt")
        path.replace(aside)
        return aside

    def write_table(self, path: Path) -> None:
        """Write the table of all parts, reading them one at a time.

        Raises
        ------
        GyrocalError
            A column does not hold the same kind of value in all parts.
        OSError
            The table cannot be written; none is left behind, or the one that was there before.
        """
        schema = self._schema()
        with replacing(path) as file, pq.ParquetWriter(file, schema, write_page_checksum=True) as writer:
            for table in _regrouped(self._tables(schema), schema):
                writer.write_table(table, row_group_size=ROW_GROUP)

    def _schema(self) -> pa.Schema:
        """Columns of the table: those of the parts, in order of appearance."""
        schema = pa.schema([])
        for index in range(len(self)):
            part = pq.read_schema(self.path(index)).remove_metadata()
            if part != schema:
                try:
                    schema = pa.unify_schemas([schema, part], promote_options="permissive")
                except pa.ArrowException as error:
                    raise GyrocalError(
                        f"{self.path(index)}: a column is of another kind than in earlier parts: {error}"
                    ) from None
        return schema

    def _tables(self, schema: pa.Schema) -> Iterator[pa.Table]:
        for index in range(len(self)):
            with pq.ParquetFile(self.path(index), page_checksum_verification=True) as file:
                table = file.read().replace_schema_metadata(None)
            yield pa.concat_tables([schema.empty_table(), table], promote_options="permissive")


def _regrouped(tables: Iterable[pa.Table], schema: pa.Schema) -> Iterator[pa.Table]:
    """The same rows in tables of ROW_GROUP rows each but the last."""
    held = schema.empty_table()
    for table in tables:
        held = pa.concat_tables([held, table])
        while held.num_rows >= ROW_GROUP:
            yield held.slice(0, ROW_GROUP).combine_chunks()
            held = held.slice(ROW_GROUP)
    if held.num_rows:
        yield held.combine_chunks()
