"""What a study reports: checks, tables and figures made from its rows, written beside them and shown."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console

from studies.montecarlo.files import write_csv, write_text
from studies.montecarlo.study import Study
from studies.report import checks as rendering
from studies.report import tables as rendered
from studies.report.checks import Check
from studies.report.panels import Draw
from studies.report.tables import SIGNIFICANT_DIGITS, Table

CHECKS = "What was found"


@dataclass(frozen=True)
class Report:
    """A study's findings."""

    tables: Mapping[str, Table]  # aggregates by a short name, which is that of the CSV file
    figures: Mapping[str, Draw] = field(default_factory=dict)  # what draws a figure to a path, by file name without ending
    checks: tuple[Check, ...] = ()  # what answers the study's question; first in everything shown, and ``checks.csv``
    findings: tuple[str, ...] = ()  # sentences of a study that has no checks

    def check(self, name: str) -> Check:
        """The check of a name."""
        return next(check for check in self.checks if check.name == name)


@dataclass(frozen=True)
class Entry:
    """A study in the catalogue."""

    study: Study  # what the engine runs
    summary: str  # one line for the list of studies
    report: Callable[[Any, pd.DataFrame], Report]  # (config, rows) to its report; rows of failed cases are left out


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
