"""What a study reports: tables and figures made from its rows, written beside them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from studies.montecarlo.study import Study
from studies.report import render

Draw = Callable[[Path], Path]


@dataclass(frozen=True)
class Report:
    """A study's findings.

    Attributes
    ----------
    findings : sentences that answer the study's question, with their numbers; first in everything shown
    tables : aggregates by title; each is shown and written
    figures : what draws a figure to a path, by file name without ending
    shown : by title, the form of a table for people where the table itself is long
    """

    findings: tuple[str, ...]
    tables: Mapping[str, pd.DataFrame]
    figures: Mapping[str, Draw] = field(default_factory=dict)
    shown: Mapping[str, pd.DataFrame] = field(default_factory=dict)


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
    """Write findings and tables as Markdown, each table as CSV, the figures as SVG."""
    lines = [f"# {title}", "", *(f"- {finding}" for finding in report.findings), ""]
    for number, (name, table) in enumerate(report.tables.items(), start=1):
        table.to_csv(folder / f"table{number}.csv", index=False, float_format="%.9g")
        lines.append(render.markdown(name, report.shown.get(name, table)))
    for name, draw in report.figures.items():
        draw(folder / f"{name}.svg")
        lines += [f"![{name}]({name}.svg)", ""]
    (folder / "report.md").write_text("\n".join(lines), encoding="utf-8")
