"""Tables for people: the paper's layout as text cells, for the terminal and for Markdown."""

from collections.abc import Sequence
from math import floor, inf, log10

import pandas as pd
from rich.console import Console
from rich.markup import escape
from rich.table import Table

NO_VALUE = "–"


def number(value: float, digits: int | None = None) -> str:
    """A number with so many decimals; without a count in few characters, with an exponent where that is shorter."""
    if pd.isna(value):
        return NO_VALUE
    if digits is not None:
        return f"{value:.{digits}f}"
    if value == 0 or 1e-2 <= abs(value) < 1e5:
        return f"{value:.5g}"
    return f"{value:.2e}"


def to_sigma(value: float, sigma: float) -> str:
    """A value to two digits of its sigma."""
    return f"{value:.{min(max(1 - floor(log10(sigma)), 0), 12)}f}" if 0 < sigma < inf else plain(value, sigma)


def plain(value: float, _: float) -> str:
    """A value whose sigma says nothing about its digits."""
    return f"{value:.9g}"


def cell(row: pd.Series, digits: int | None) -> str:
    """Mean ± standard deviation and, where it flew, the flight's value and its percentile."""
    text = f"{number(row['mean'], digits)} ± {number(row['std'], digits)}"
    if pd.isna(row["flight"]):
        return text
    return f"{number(row['flight'], digits)} | {text} | {row['flight_percentile']:.0f} %"


def paper_layout(
    table: pd.DataFrame, rows: Sequence[str], digits: int | None = 3, psi: str = "full", resampling: str = "skip"
) -> pd.DataFrame:
    """One column a step size, one row a cell of the paper's table.

    Parameters
    ----------
    table : tidy distribution table, as made by `studies.natanson.paper_tables`
    rows : columns that name a row
    """
    chosen = table.query("psi == @psi and resampling == @resampling")
    texts = chosen.assign(text=[cell(row, digits) for _, row in chosen.iterrows()])
    wide = texts.pivot_table(index=list(rows), columns="step_s", values="text", aggfunc="first", sort=False)
    wide.columns = [f"Δt = {step:g} s" for step in wide.columns]
    return wide.reset_index()


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return number(value)
    return str(value)


def terminal(console: Console, title: str, table: pd.DataFrame, note: str = "") -> None:
    """Print a table."""
    out = Table(
        title=escape(title), caption=escape(note) or None, title_justify="left", caption_justify="left", header_style="bold"
    )
    for column in table.columns:
        numeric = pd.api.types.is_numeric_dtype(table[column])
        out.add_column(str(column), justify="right" if numeric else "left", no_wrap=True)
    for row in table.itertuples(index=False):
        out.add_row(*(escape(_text(value)) for value in row))
    console.print(out)


def markdown(title: str, table: pd.DataFrame, note: str = "") -> str:
    """A Markdown section."""
    header = [str(column) for column in table.columns]
    lines = [f"## {title}", ""] + ([note, ""] if note else [])
    lines += ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    for row in table.itertuples(index=False):
        # A cell's own bars would end it, unless escaped.
        lines.append("| " + " | ".join(_text(value).replace("|", "\\|") for value in row) + " |")
    return "\n".join([*lines, ""])
