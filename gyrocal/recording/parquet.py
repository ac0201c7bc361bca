"""Tables of a recording as Parquet, with a check for damage on reading.

Pages carry checksums, but the metadata with their places, contents and numbers of rows do not: one wrong byte there can
exchange two columns. The file therefore also states the SHA-256 of the table's contents. A file of another program may state
neither; then its numbers of rows must at least agree.
"""

import hashlib
from pathlib import Path
from typing import BinaryIO

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

CONTENT = b"gyrocal.sha256"


def write(frame: pd.DataFrame, file: BinaryIO) -> None:
    """Write a table with checksums, its index left out."""
    table = pa.Table.from_pandas(frame, preserve_index=False)
    table = table.replace_schema_metadata({**(table.schema.metadata or {}), CONTENT: hash_table(table)})
    pq.write_table(table, file, write_page_checksum=True)


def read(path: Path) -> pd.DataFrame:
    """Read a table.

    A `ValueError` if it does not hold what it states or has two columns of one name; an `OSError` or `pyarrow.ArrowException`
    if it is no Parquet file, or a page has another checksum than it states.
    """
    with pq.ParquetFile(path, page_checksum_verification=True) as file:
        about, table = file.metadata, file.read()
    counted = sum(about.row_group(k).num_rows for k in range(about.num_row_groups))
    stated = (table.schema.metadata or {}).get(CONTENT)
    if not about.num_rows == counted == table.num_rows or (stated is not None and stated != hash_table(table)):
        raise ValueError("it is damaged: it does not hold the rows that were written")
    twice = sorted({name for name in table.column_names if table.column_names.count(name) > 1})
    if twice:
        raise ValueError(f"column {', '.join(twice)} is there more than once")
    return table.to_pandas()


def hash_table(table: pa.Table) -> bytes:
    """Compute the SHA-256 of the names, types and values of a table's columns, in hexadecimal."""
    hashed = hashlib.sha256()
    for name, column in zip(table.column_names, table.columns, strict=True):
        hashed.update(repr(name).encode())
        if pa.types.is_primitive(column.type):  # independent of the division into chunks
            hashed.update(str(column.type).encode())
            hashed.update(pc.is_valid(column).to_numpy().tobytes())
            hashed.update(pc.drop_null(column).to_numpy().tobytes())
        else:  # text and the like, which have many types
            hashed.update(repr(column.to_pylist()).encode())
    return hashed.hexdigest().encode()
