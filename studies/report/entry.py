"""Report of a study: checks, tables and figures computed from its rows, written to its folder and shown."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from studies.montecarlo.files import write_csv, write_text
from studies.montecarlo.statistics import compute_quantile, compute_tolerance_interval
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
        """Return the check of a name."""
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
        write_csv(folder / f"{name}.csv", table.data, SIGNIFICANT_DIGITS)
        lines.append(rendered.format_markdown(table.title, table.get_shown_data(), table.note, table.formats))
    for name, draw in report.figures.items():
        draw(folder / f"{name}.svg")
        lines += [f"![{name}]({name}.svg)", ""]
    write_text(folder / "report.md", "\n".join(lines))


def show(report: Report, console: Console) -> None:
    """Print tables, then checks, so that the checks stay in view."""
    for table in report.tables.values():
        rendered.print_table(console, table.title, table.get_shown_data(), table.note, table.formats)
    if report.checks:
        rendered.print_table(console, CHECKS, rendering.format_checks(report.checks))
    for sentence in _format_findings(report):
        console.print(sentence, highlight=False, markup=False)


def _format_findings(report: Report) -> list[str]:
    """List the findings and the meanings of the checks as Markdown items."""
    return [f"- {sentence}" for sentence in (*report.findings, *rendering.list_meanings(report.checks))]


# ---- the default report of a study ---------------------------------------------------------------------------------------

QUANTILES = {"p05": 0.05, "median": 0.5, "p95": 0.95}


def report_columns(config: Any, rows: pd.DataFrame) -> Report:
    """Report mean, standard error, spread and quantiles of each numeric column, and the counts of each text."""
    note = (
        "Rows have a value, missing ones none. Of truth values the mean is a share. Infinite values count in the quantiles; a "
        "column with them has no mean, standard error and spread."
    )
    tables = {"columns": Table(f"Columns, {rows['case'].nunique()} cases that did not fail", _summarise_numbers(rows), note)}
    texts = rows.select_dtypes(exclude=["number", "bool"]).drop(columns=list(RESERVED), errors="ignore")
    counts = [
        texts[name].value_counts().rename_axis("value").reset_index(name="rows").assign(column=str(name)).head(20)
        for name in texts
    ]
    if counts:
        table = pd.concat(counts, ignore_index=True)[["column", "value", "rows"]]
        tables["texts"] = Table("Texts, the most frequent of each column", table)
    return Report(tables)


COUNTS = ("rows", "missing", "infinite")


def _select_numbers(rows: pd.DataFrame, kinds: Any) -> pd.DataFrame:
    """Select the numeric columns; an empty column counts as numeric."""
    empty = [name for name in rows if rows[name].isna().all()]
    return rows.astype(dict.fromkeys(empty, float)).select_dtypes(kinds).drop(columns=list(RESERVED), errors="ignore")


def _summarise_numbers(rows: pd.DataFrame) -> pd.DataFrame:
    """Compute the statistics of each numeric column; the standard error is that of the means of cases."""
    lines = []
    for name, values in _select_numbers(rows, ["number", "bool"]).astype(float).items():
        present = values.dropna()
        infinite = int(np.isinf(present).sum())
        line = {"column": name, "rows": len(present), "missing": len(values) - len(present), "infinite": infinite}
        # The rows of a case are not independent.
        case_means = present.groupby(rows["case"]).mean() if not infinite else present.head(0)
        error = float(case_means.std(ddof=1) / np.sqrt(len(case_means))) if len(case_means) > 1 else np.nan
        mean, deviation = (np.nan, np.nan) if infinite else (present.mean(), present.std(ddof=1))
        line |= {"mean": mean, "standard_error": error, "spread": deviation}
        lines.append(line | {key: compute_quantile(present, probability) for key, probability in QUANTILES.items()})
    return pd.DataFrame(lines, columns=["column", *COUNTS, "mean", "standard_error", "spread", *QUANTILES])


def build_tolerance_table(rows: pd.DataFrame) -> Table:
    """Build the median and tolerance interval of each numeric column of a study's good rows, a row a case."""
    lines = []
    for name, values in _select_numbers(rows, ["number"]).astype(float).items():
        present = values.dropna()
        if not str(name).startswith(DISPERSED):
            low, high = compute_tolerance_interval(present)
            line = {"column": name, "cases": len(present), "missing": len(values) - len(present)}
            infinite, median = int(np.isinf(present).sum()), compute_quantile(present, 0.5)
            lines.append(line | {"infinite": infinite, "median": median, "low": low, "high": high})
    note = (
        "Low to high holds 95 % of all cases that do not fail and have a value, with 95 % confidence, whatever the "
        "distribution. Missing cases have no value; an end that reaches infinite values is infinite."
    )
    columns = ["column", "cases", "missing", "infinite", "median", "low", "high"]
    return Table("Tolerance intervals", pd.DataFrame(lines, columns=columns), note)
