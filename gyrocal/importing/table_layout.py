"""Layout of a text table: encoding, separator, decimal sign, header and first row of values, found from the file itself.

Each separator splits the first lines into fields. The separator with the most numbers in rows of one length is that of the
table. The table begins at the first row of that length with no words in its columns of numbers. The header is the row above it,
without a comment's prefix. A row of units between the two is skipped. Two header rows, groups above elements, are joined:

    Time (s);Orientation;;;;Gyroscope;;
    ;W;X;Y;Z;X;Y;Z

The name of a column then is that of its group, which lasts until the next group, and that of the element: "Gyroscope X".
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import re
from collections import Counter
from importlib import import_module
from itertools import islice, pairwise
from pathlib import Path
from typing import IO, NamedTuple
from zipfile import ZipFile

from gyrocal.errors import InputError

SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", r"\s+": "spaces"}
HEAD_LINES = 400  # read to find the layout; preambles of loggers have at most some dozens
COMMENT = re.compile(r"\s*(#|//|%+)\s*")
# As C's printf writes it on several systems, such as -nan(ind), -1.#IND and 1.#QNAN0 on Windows.
NOT_A_NUMBER = re.compile(r"[-+]?(nan(\(\w*\))?|inf(inity)?|\d\.#(ind|[qs]nan|inf)\d*)", re.IGNORECASE)
NUMBER = re.compile(rf"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|{NOT_A_NUMBER.pattern}", re.IGNORECASE)
DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
DATE_OR_TIME = re.compile(r"\d{4}-\d\d-\d\d([T ].*)?|\d{1,2}:\d\d:\d\d(\.\d*)?")
# Units as loggers write them below names, with or without brackets.
UNIT_PATTERN = re.compile(
    r"[\[(]?(-|1|none|[mµun]?s(ec(onds?)?)?|(m?rad|m?deg(rees?)?|°|arcsec)(/(s(ec)?|h(r)?))?|dps|rad s\^?-1"
    r"|[cm]?m(/s(\^?2|²)?)?|m s\^?-[12]|m?g|[µum]?T|m?G(auss)?|[kM]?Hz|m?V|°?C|degC|K|[hk]?Pa|m?bar|counts?|lsb|%)[\])]?",
    re.IGNORECASE,
)
COMPRESSIONS = {b"\x1f\x8b": "gzip", b"PK\x03\x04": "zip", b"BZh": "bz2", b"\xfd7zXZ": "lzma"}  # by their first bytes
BOMS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


class TableLayout(NamedTuple):
    """Encoding, separator and first line of the values of a table, and the names of its columns."""

    encoding: str  # this, separator and decimal as `pandas.read_csv` takes them
    separator: str
    decimal: str
    names: list[str]  # of the columns; their numbers from 1 where the table has no header
    first_line: int  # of the values, from 0
    notes: list[str]  # on the layout; empty for commas below a header in the first line


def find_layout(path: Path) -> TableLayout:
    """Find the layout of a table from its first lines."""
    encoding = detect_encoding(path)
    with open_table(path) as file:
        text = io.TextIOWrapper(file, encoding=encoding, errors="replace", newline="")
        lines = [line.rstrip("\r\n") for line in islice(text, HEAD_LINES)]
    if not any(map(str.strip, lines)):
        raise InputError(f"{path}: no rows")
    splits = [_SplitLines(separator, lines) for separator in SEPARATORS]
    split = max(splits, key=lambda candidate: (candidate.score, candidate.fields))
    names, notes = split.name_columns()
    decimal = "," if split.has_decimal_comma() else "."
    if split.separator != ",":
        notes.append(f"fields are separated by {SEPARATORS[split.separator]}")
    if decimal == ",":
        notes.append("a comma is the decimal sign")
    if encoding not in ("utf-8", "utf-8-sig"):
        notes.append(f"the text is {encoding.upper()}")
    return TableLayout(encoding, split.separator, decimal, names, split.start, notes)


def open_table(path: Path) -> IO[bytes]:
    """Open a table for reading, unpacked if its first bytes are those of gzip, zip, bz2 or xz."""
    with path.open("rb") as file:
        head = file.read(8)
    kind = next((name for magic, name in COMPRESSIONS.items() if head.startswith(magic)), None)
    if kind is None:
        return path.open("rb")
    if kind != "zip":
        opened: IO[bytes] = import_module(kind).open(path, "rb")
        return opened
    archive = ZipFile(path)
    names = [name for name in archive.namelist() if not name.endswith("/") and not name.startswith("__MACOSX/")]
    if len(names) != 1:
        raise InputError(f"{path}: holds {len(names)} files, {', '.join(names[:4])}…: unpack it and give one table")
    return archive.open(names[0])


def detect_encoding(path: Path) -> str:
    """Detect the encoding by the byte-order mark or the zeros of UTF-16 in Western text; otherwise UTF-8 or Windows-1252."""
    with open_table(path) as file:
        head = file.read(1 << 16)
    for mark, name in BOMS.items():
        if head.startswith(mark):
            return name
    for offset, name in ((1, "utf-16-le"), (0, "utf-16-be")):
        sample = head[offset:4096:2]
        if sample and sample.count(0) > 0.9 * len(sample):
            return name
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


class _SplitLines:
    """The first lines of a file, split at one separator."""

    def __init__(self, separator: str, lines: list[str]) -> None:
        self.separator = separator
        self.commented = [COMMENT.match(line) is not None for line in lines]
        self.rows = self._split([COMMENT.sub("", line, count=1) for line in lines])
        plain = [row for row, comment in zip(self.rows, self.commented, strict=True) if not comment]
        lengths = Counter(len(row) for row in plain if any(map(self._is_value, row)))
        self.fields = max((length for length in lengths if length > 1), key=lambda length: lengths[length] * length, default=0)
        table = [row for row in plain if len(row) == self.fields]
        # A column of numbers has at least as many numbers as words; a column of text labels is none.
        values = [sum(self._is_value(row[k]) for row in table) for k in range(self.fields)]
        words = [sum(self._is_word(row[k]) for row in table) for k in range(self.fields)]
        self.numeric = [k for k in range(self.fields) if values[k] >= max(words[k], 1)]
        fitting = [k for k, row in enumerate(self.rows) if not self.commented[k] and self._is_table_row(row)]
        filled = [k for k, row in enumerate(self.rows) if any(row)]
        # A row of numbers within a preamble, such as Motive's identifiers, is followed by a row of words.
        following = dict(pairwise(filled))
        begins = [k for k in fitting if following.get(k, fitting[-1]) in fitting]
        self.start = (begins or fitting or [filled[0] + 1])[0]
        self.score = sum(values) - sum(words) if fitting else -math.inf
        if not fitting:
            self.fields = len(self.rows[self.start - 1]) if self.start else 0

    def _split(self, lines: list[str]) -> list[list[str]]:
        """Split lines into cells without blanks around them."""
        if self.separator == r"\s+":
            return [line.split() for line in lines]
        # Each line by itself: a quote that is not closed ends with its line.
        return [[cell.strip() for cell in next(csv.reader([line], delimiter=self.separator), [])] for line in lines]

    def _is_value(self, cell: str) -> bool:
        return bool(
            NUMBER.fullmatch(cell) or DATE_OR_TIME.fullmatch(cell) or (self.separator != "," and DECIMAL_COMMA.fullmatch(cell))
        )

    def _is_word(self, cell: str) -> bool:
        return bool(cell) and not self._is_value(cell)

    def _is_table_row(self, row: list[str]) -> bool:
        """Whether a row belongs to the table: it has numbers, and no words, in the columns of numbers."""
        if len(row) != self.fields or any(self._is_word(row[k]) for k in self.numeric):
            return False
        return any(self._is_value(row[k]) for k in self.numeric)

    def has_decimal_comma(self) -> bool:
        """Whether the values have commas, and no points, as decimal signs."""
        cells = [row[k] for row in self.rows if self._is_table_row(row) for k in self.numeric]
        return any(DECIMAL_COMMA.fullmatch(cell) for cell in cells) and self.separator != ","

    def name_columns(self) -> tuple[list[str], list[str]]:
        """Return the names of the columns, and notes on the lines that they are from."""
        above = [k for k in range(self.start) if any(self.rows[k])]
        notes: list[str] = []

        def is_header(k: int) -> bool:
            return len(self.rows[k]) >= self.fields or (2 * len(self.rows[k]) > self.fields > 2 and k == above[0])

        units = ""
        if len(above) > 1 and is_header(above[-1]) and is_header(above[-2]) and self._holds_units(above[-1]):
            units = f", line {above.pop() + 1} holds units"
        if not above or not is_header(above[-1]):
            place = f"; values begin in line {self.start + 1}" if self.start else ""
            notes.append(f"the table has no header: its {self.fields} columns are named by their numbers from 1{place}")
            return [str(k + 1) for k in range(self.fields)], notes
        line = above[-1]
        names = self.rows[line]
        upper = self.rows[above[-2]] if len(above) > 1 else []
        if self._holds_groups(upper, names):
            names = join_headers(upper, names)
            notes.append(f"lines {above[-2] + 1} and {line + 1} are the header, groups above elements{units}")
        else:
            names = join_headers([""] * len(names), names)
            if line != 0 or units:
                notes.append(f"line {line + 1} is the header{units}; values begin in line {self.start + 1}")
        return names, notes

    def _holds_units(self, k: int) -> bool:
        """Whether most cells of a row are units."""
        cells = [cell for cell in self.rows[k] if cell]
        return bool(cells) and sum(UNIT_PATTERN.fullmatch(cell) is not None for cell in cells) > 0.6 * len(cells)

    def _holds_groups(self, upper: list[str], names: list[str]) -> bool:
        """Whether a row names groups of the columns below it: it or the row of names has blanks or repeated names."""
        if self.separator == r"\s+" or len(upper) != len(names) or sum(map(bool, names)) < 2:
            return False
        if not any(upper) or any(map(self._is_value, upper)):
            return False
        return any(len(set(row)) < len(row) or not all(row) for row in (upper, names))


def join_headers(groups: list[str], elements: list[str]) -> list[str]:
    """Join two header rows; a column without a name is named by its number, a second one of one name gets a suffix."""
    names: list[str] = []
    group = ""
    for k, (group_name, element) in enumerate(zip(groups, elements, strict=True), 1):
        group = group_name or group
        name = f"{group} {element}".strip() if element else group_name or f"column {k}"
        count = sum(name == earlier or earlier.startswith(f"{name}.") for earlier in names)
        names.append(f"{name}.{count}" if count else name)
    return names
