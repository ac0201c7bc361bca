"""What a study reports: checks, tables and figures made from its rows, written beside them and shown."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from studies.montecarlo.files import write_csv, write_text
from studies.montecarlo.statistics import compute_tolerance_interval
from studies.montecarlo.study import DISPERSED, RESERVED, Study
from studies.report import checks as rendering
from studies.report import tables as rendered
from studies.report.checks import Check
from studies.report.panels import Draw
from studies.report.tables import SIGNIFICANT_DIGITS, Table

CHECKS = "What was found"


@dataclass(frozen=True)
class Report:
    """A study's findings.

    Attributes
    ----------
    tables : aggregates by a short name, which is that of the CSV file
    figures : what draws a figure to a path, by file name without ending
    checks : what answers the study's question; first in everything shown, and ``checks.csv``
    findings : sentences of a study that has no checks
    """

    tables: Mapping[str, Table]
    figures: Mapping[str, Draw] = field(default_factory=dict)
    checks: tuple[Check, ...] = ()
    findings: tuple[str, ...] = ()

    def check(self, name: str) -> Check:
        """The check of a name."""
        return next(check for check in self.checks if check.name == name)


@dataclass(frozen=True)
class Entry:
    """A study in the catalogue.

    Attributes
    ----------
    study : what the engine runs
    summary : one line for the list of studies
    report : (config, rows) to its report; rows of failed cases are left out
    """

    study: Study
    summary: str
    report: Callable[[Any, pd.DataFrame], Report]


def write(report: Report, title: str, folder: Path) -> None:
    """Write checks and tables as Markdown and, each by its name, as CSV, the figures as SVG."""
    lines = [f"# {title}", "", *_format_findings(report), ""]
    if report.checks:
        write_csv(folder / "checks.csv", rendering.build_check_frame(report.checks), SIGNIFICANT_DIGITS)
        lines.append(rendered.format_markdown(CHECKS, rendering.format_checks(report.checks)))
    for name, table in report.tables.items():
        write_csv(folder / f"{name}.csv", table.data, table.digits)
        lines.append(rendered.format_markdown(table.title, table.get_shown_data(), table.note, table.formats))
    for name, draw in report.figures.items():
        draw(folder / f"{name}.svg")
        lines += [f"![{name}]({name}.svg)", ""]
    write_text(folder / "report.md", "\n".join(lines))


def show(report: Report, console: Console) -> None:
    """Print tables, then checks, so that these are what stays in view."""
    for table in report.tables.values():
        rendered.print_table(console, table.title, table.get_shown_data(), table.note, table.formats)
    if report.checks:
        rendered.print_table(console, CHECKS, rendering.format_checks(report.checks))
    for sentence in _format_findings(report):
        console.print(sentence, highlight=False, markup=False)


def _format_findings(report: Report) -> list[str]:
    return [f"- {sentence}" for sentence in (*report.findings, *rendering.list_meanings(report.checks))]


# ---- a study without a report of its own ----------------------------------------------------------------------------------

QUANTILES = {"p05": 0.05, "median": 0.5, "p95": 0.95}


def report_columns(config: Any, rows: pd.DataFrame) -> Report:
    """Mean, its standard error, spread and quantiles of each numeric column, and the counts of each text."""
    tables = {
        "columns": Table(
            f"Columns, {rows['case'].nunique()} cases", _summarise_numbers(rows), "Of truth values the mean is a share."
        )
    }
    texts = rows.select_dtypes(exclude=["number", "bool"]).drop(columns=list(RESERVED), errors="ignore")
    counts = [
        texts[name].value_counts().rename_axis("value").reset_index(name="rows").assign(column=str(name)).head(20)
        for name in texts
    ]
    if counts:
        table = pd.concat(counts, ignore_index=True)[["column", "value", "rows"]]
        tables["texts"] = Table("Texts, the most frequent of each column", table)
    return Report(tables)


def _summarise_numbers(rows: pd.DataFrame) -> pd.DataFrame:
    numbers = rows.select_dtypes(["number", "bool"]).drop(columns=list(RESERVED), errors="ignore").astype(float)
    lines = []
    for name, values in numbers.items():
        found = values[np.isfinite(values)]
        # The rows of a case are not independent.
        each = found.groupby(rows["case"]).mean()
        error = float(each.std(ddof=1) / np.sqrt(len(each))) if len(each) > 1 else np.nan
        line = {"column": name, "rows": len(found), "mean": found.mean(), "standard_error": error, "spread": found.std(ddof=1)}
        lines.append(line | {key: found.quantile(share) for key, share in QUANTILES.items()})
    return pd.DataFrame(lines, columns=["column", "rows", "mean", "standard_error", "spread", *QUANTILES])


def build_tolerance_table(rows: pd.DataFrame) -> Table:
    """Median and tolerance interval of each numeric column of a study's good rows; of a case with several rows their mean."""
    lines = []
    for name, values in rows.select_dtypes("number").drop(columns=list(RESERVED), errors="ignore").items():
        each = values[np.isfinite(values)].astype(float).groupby(rows["case"]).mean()
        if len(each) and not str(name).startswith(DISPERSED):
            low, high = compute_tolerance_interval(each)
            lines.append({"column": name, "cases": len(each), "median": each.median(), "low": low, "high": high})
    note = (
        "Low to high holds 95 % of all cases that do not fail, with 95 % confidence, whatever the distribution. "
        "It needs 93 cases. Of a case with several rows their mean counts."
    )
    return Table("Tolerance intervals", pd.DataFrame(lines, columns=["column", "cases", "median", "low", "high"]), note)
