"""The renderer of all tables: for the terminal, as Markdown and as CSV.

A CSV file holds the numbers under the columns' names. For people the numbers have as many digits as their column's format says,
or few, and the heading has the column's unit.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import floor, inf, isfinite, log10

import numpy as np
import pandas as pd
from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from studies.report.units import format_heading

NO_VALUE = "–"
# In CSV files. Between BLAS kernels and vector units numbers differ by some 1e-13 relative, and by 1e-8 where they are small
# differences of large numbers, such as the mean of errors. This seldom changes the sixth digit.
SIGNIFICANT_DIGITS = 6
FOLDED = 24  # characters: least width to which a narrow terminal folds a text


@dataclass(frozen=True)
class Table:
    """A table of a report."""

    title: str  # its content
    data: pd.DataFrame  # the numbers; written as CSV
    note: str = ""  # a sentence on how to read it
    # format of a column, such as ".3f", where few digits are not the right ones
    formats: Mapping[str, str] = field(default_factory=dict)
    # the form for people, where the table itself is long; or the columns they see
    shown: pd.DataFrame | list[str] | None = None

    def get_shown_data(self) -> pd.DataFrame:
        """Return the columns that are shown."""
        if self.shown is None:
            return self.data
        return self.data[self.shown] if isinstance(self.shown, list) else self.shown


def format_number(value: float, digits: int | None = None) -> str:
    """Format a number with `digits` decimals; by default in few characters, with an exponent if that is shorter."""
    if pd.isna(value):
        return NO_VALUE
    if digits is not None:
        return f"{value:.{digits}f}"
    if value == 0 or 1e-2 <= abs(value) < 1e5:
        return f"{value:.5g}"
    return f"{value:.2e}"


def format_to_sigma(value: float, sigma: float) -> str:
    """Format a value to two digits of its sigma; to nine significant digits without one."""
    return f"{value:.{min(max(1 - floor(log10(sigma)), 0), 12)}f}" if 0 < sigma < inf else f"{value:.9g}"


def format_short(value: float, digits: int = 2, sign: str = "") -> str:
    """Format a number to `digits` significant digits, without an exponent if it needs none."""
    return f"{float(f'{value:.{digits}g}'):{sign}g}"


def format_percent(probability: float) -> str:
    """Format a probability in percent, never rounded to certainty."""
    if not isfinite(probability):
        return NO_VALUE
    value = 100 * probability
    if value > 99.9:
        return "more than 99.9 %"
    if value < 0.1:
        return "less than 0.1 %"
    return f"{value:.1f} %" if value < 1 or value > 99 else f"{value:.0f} %"


def format_p_value(p: float) -> str:
    """Format a p-value with its relation: p = 0.012, p < 1e-99."""
    if not isfinite(p):
        return "p unknown"
    return "p < 1e-99" if p < 1e-99 else f"p = {p:.2g}"


def format_size(value: float, sigma: float, unit: str) -> str:
    """Format a size ± sigma and unit, to two digits of its sigma."""
    if not 0 < sigma < inf:
        return f"{value:.5g} {unit} (its error is not known)"
    if not isfinite(value):
        return f"unknown {unit}"
    if sigma < 1e-4 * abs(value):
        return f"{value:.6g} ± {sigma:.1g} {unit}"
    if max(abs(value), sigma) < 1e-3:
        power = floor(log10(max(abs(value), sigma)))
        value, sigma = value / 10.0**power, sigma / 10.0**power
        return f"({format_to_sigma(value, sigma)} ± {format_to_sigma(sigma, sigma)})e{power} {unit}"
    return f"{format_to_sigma(value, sigma)} ± {format_to_sigma(sigma, sigma)} {unit}"


def format_interval(value: float, interval: tuple[float, float], scale: float = 1.0, form: str = ".3g", unit: str = "") -> str:
    """Format a value with its interval in brackets, times a scale."""
    low, high = (f"{scale * end:{form}}" for end in interval)
    return f"{scale * value:{form}}{unit} ({low} to {high}{unit})"


def format_share(share: float | None, interval: tuple[float, float] | None) -> str:
    """Format a share with its interval in percent; empty without one."""
    return "" if share is None or interval is None else format_interval(share, interval, 100, ".0f", " %")


def join_items(items: Sequence[str], last: str) -> str:
    """Join items as in "A, b and c"."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {last} {items[-1]}"


def print_table(
    console: Console, title: str, table: pd.DataFrame, note: str = "", formats: Mapping[str, str] | None = None
) -> None:
    """Print a table; texts are folded, and columns that still do not fit into the terminal are named below it."""
    cells = list(format_cells(table, formats or {}))
    headings = [format_heading(str(column)) for column in table.columns]
    numeric = [pd.api.types.is_numeric_dtype(table[column]) for column in table.columns]
    widths = [max(map(cell_len, column)) for column in zip(headings, *cells, strict=True)]
    needed_widths = [3 + (width if is_number else min(width, FOLDED)) for width, is_number in zip(widths, numeric, strict=True)]
    count = max(1, int(np.searchsorted(np.cumsum(needed_widths), console.width - 1, side="right")))
    if count < len(headings):
        note = f"{note} Too wide for this terminal, and left out: {', '.join(headings[count:])}.".strip()
    out = RichTable(
        title=escape(title), caption=escape(note) or None, title_justify="left", caption_justify="left", header_style="bold"
    )
    for name, is_number, width in zip(headings[:count], numeric, widths, strict=False):
        out.add_column(escape(name), justify="right" if is_number else "left", no_wrap=is_number or width <= FOLDED)
    for row in cells:
        out.add_row(*(escape(cell) for cell in row[:count]))
    console.print(out)


def format_markdown(title: str, table: pd.DataFrame, note: str = "", formats: Mapping[str, str] | None = None) -> str:
    """Format a table as a Markdown section."""
    header = [format_heading(str(column)) for column in table.columns]
    lines = [f"## {title}", ""] + ([note, ""] if note else [])
    lines += ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    # A cell's own bars would end it, unless escaped.
    lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in format_cells(table, formats or {})]
    return "\n".join([*lines, ""])


def summarise_groups(
    rows: pd.DataFrame, keys: Sequence[str], line: Callable[[pd.DataFrame], Mapping[str, object]]
) -> pd.DataFrame:
    """Summarise each group of rows with the same keys, in their first order: the keys, and the fields of `line`."""
    groups = rows.groupby(list(keys), sort=False)
    return pd.DataFrame([{**dict(zip(keys, key, strict=True)), **line(part)} for key, part in groups])


def format_cells(table: pd.DataFrame, formats: Mapping[str, str]) -> Iterator[list[str]]:
    """Format the rows of a table as texts."""
    column_formats = [formats.get(str(column)) for column in table.columns]
    for row in table.itertuples(index=False):
        yield [format_cell(value, form) for value, form in zip(row, column_formats, strict=True)]


def format_cell(value: object, form: str | None) -> str:
    """Format a value as text; markup stays as it is."""
    if isinstance(value, str):
        return value
    if value is None:
        return NO_VALUE
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:{form}}" if form and not pd.isna(value) else format_number(value)
    return str(value)


def format_duration(seconds: float) -> str:
    """Format a time in s up to two minutes, in min up to five hours, or in h."""
    if seconds < 120:
        return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 18000 else f"{seconds / 3600:.1f} h"
