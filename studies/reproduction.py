"""The reproduction of a paper: a study's rows, tables and figures beside the flight's values, one page of them, a summary."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console

from studies.montecarlo import engine
from studies.montecarlo.files import write_csv, write_json, write_text
from studies.montecarlo.study import Study, StudyConfig
from studies.report import tables as render
from studies.report.console import show_progress
from studies.report.panels import Draw
from studies.report.tables import Table


@dataclass
class Reproduction:
    """What a reproduction gathers on its way.

    Attributes
    ----------
    console : for progress and the tables that are shown
    jobs : worker processes; the results do not depend on it
    tables : by the names of their files; one without a title is not on the page
    figures : what draws them, and their titles, by the names of their files; one without a title is not on the page
    summary : for ``summary.json``
    begun : when, s
    """

    console: Console
    jobs: int = 1
    tables: dict[str, Table] = field(default_factory=dict)
    figures: dict[str, tuple[str, Draw]] = field(default_factory=dict)
    summary: dict[str, Any] = field(default_factory=dict)
    begun: float = field(default_factory=time.monotonic)

    def run(self, study: Study, config: StudyConfig, folder: Path) -> engine.Outcome:
        """Run the study whose rows the paper is reproduced from; none of its cases may fail."""
        display = partial(show_progress, quiet=self.console.quiet)
        work = engine.get_work_folder(folder, study, config)
        backend: Any = "loky" if self.jobs > 1 else "serial"
        outcome = engine.run(study, config, work, backend=backend, jobs=self.jobs, progress=display)
        outcome.check()
        return outcome

    def add(self, name: str, title: str, data: pd.DataFrame, **more: Any) -> pd.DataFrame:
        """Keep a table; what else it has is as of `Table`."""
        self.tables[name] = Table(title, data, **more)
        return data

    def show(self, *names: str) -> None:
        """Print tables."""
        for table in map(self.tables.__getitem__, names):
            render.print_table(self.console, table.title, table.get_shown_data(), table.note, table.formats)

    def format_section(self, name: str) -> str:
        """A table for the page."""
        table = self.tables[name]
        return render.format_markdown(table.title, table.get_shown_data(), table.note, table.formats)

    def write(self, folder: Path, page: str, head: Sequence[str], closing: Sequence[str] = ()) -> None:
        """Write tables, figures, the summary, and the page: its head, the tables, closing lines, the figures."""
        for name, table in self.tables.items():
            write_csv(folder / f"{name}.csv", table.data, table.digits)
        shown = [self.format_section(name) for name, table in self.tables.items() if table.title]
        drawn: list[str] = []
        for name, (title, draw) in self.figures.items():
            draw(folder / f"{name}.svg")
            drawn += [f"## {title}", "", f"![{title}]({name}.svg)", ""] if title else []
        write_text(folder / page, "\n".join([*head, *shown, *closing, *drawn]))
        write_json(folder / "summary.json", self.summary)

    def publish(self, outcome: engine.Outcome, folder: Path, **about: Any) -> None:
        """Write the manifest; `about` is what it says differently from that of the study."""
        wall_s = round(time.monotonic() - self.begun, 2)
        engine.finish_folder(outcome, folder, **about, wall_s=wall_s)
        self.console.print(f"Written to {folder} in {wall_s:.0f} s.", highlight=False)
