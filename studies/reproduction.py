"""The reproduction of a paper: a study's rows, tables and figures with the flight's values, a page of them, and a summary."""

import json
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd
from rich.console import Console

from gyrocal.errors import GyrocalError
from studies.montecarlo import engine
from studies.montecarlo.backends import open_backend
from studies.montecarlo.files import write_csv, write_json, write_text
from studies.montecarlo.manifest import WORK, describe_provenance, hash_bytes, write_manifest
from studies.montecarlo.study import Study, StudyConfig, hash_config, resolve_config
from studies.report import tables as render
from studies.report.console import show_progress
from studies.report.panels import Draw
from studies.report.tables import SIGNIFICANT_DIGITS, Table

T = TypeVar("T")


def call_all(calls: Sequence[Callable[[], T]], jobs: int) -> list[T]:
    """Make independent calls of functions that a worker can import, in worker processes if there are several."""
    call: Any = _call  # in place of the function that runs the cases of a study
    numbered: Any = enumerate(calls)  # in place of the tasks of a study
    results: dict[int, Any] = {}
    with open_backend("loky" if jobs > 1 else "serial", call, jobs) as workers:
        finished: Iterator[Any] = workers.results(numbered)
        for (index, _), result in finished:
            results[index] = result
    if any(result is None for result in results.values()):
        raise GyrocalError("a worker process was killed; run the same command again, with fewer --jobs if memory was short")
    return [results[index] for index in range(len(calls))]


def _call(task: tuple[int, Callable[[], T]]) -> T:
    return task[1]()


def get_work_folder(folder: Path, study: Study, config: StudyConfig) -> Path:
    """Return the folder of a study whose rows are not kept, inside the folder of its output.

    Each configuration, source code and machine has its own, so that unfinished rows of another one cannot interfere.
    """
    identity = [hash_config(study, resolve_config(config)), describe_provenance(study)]
    return folder / WORK / hash_bytes(json.dumps(identity, sort_keys=True).encode())[:12]


@dataclass
class Reproduction:
    """Tables, figures and summary that a reproduction collects."""

    console: Console  # for progress and the tables that are shown
    jobs: int = 1  # worker processes; the results do not depend on it
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)  # by the names of their CSV files
    figures: dict[str, tuple[str, Draw]] = field(default_factory=dict)  # titles and drawing functions, by file names
    summary: dict[str, Any] = field(default_factory=dict)  # for ``summary.json``
    begun: float = field(default_factory=time.monotonic)  # when, s

    def run(self, study: Study, config: StudyConfig, folder: Path) -> engine.Outcome:
        """Run the study whose rows the paper is reproduced from; none of its cases may fail."""
        display = partial(show_progress, quiet=self.console.quiet)
        work = get_work_folder(folder, study, config)
        backend: Any = "loky" if self.jobs > 1 else "serial"
        outcome = engine.run(study, config, work, backend=backend, jobs=self.jobs, progress=display)
        outcome.check()
        return outcome

    def publish(
        self, outcome: engine.Outcome, folder: Path, page: str, head: Sequence[str], page_tables: Sequence[Table], **about: Any
    ) -> None:
        """Write tables, figures, the summary, the page of head, shown tables and figures, and the manifest; show the tables.

        Entries of the manifest that differ from those of the study are in `about`.
        """
        for name, data in self.tables.items():
            write_csv(folder / f"{name}.csv", data, SIGNIFICANT_DIGITS)
        figure_lines: list[str] = []
        for name, (title, draw) in self.figures.items():
            draw(folder / f"{name}.svg")
            figure_lines += [f"## {title}", "", f"![{title}]({name}.svg)", ""]
        sections = [render.format_markdown(table.title, table.data, table.note) for table in page_tables]
        write_text(folder / page, "\n".join([*head, *sections, *figure_lines]))
        write_json(folder / "summary.json", self.summary)
        for table in page_tables:
            render.print_table(self.console, table.title, table.data, table.note)
        wall_s = round(time.monotonic() - self.begun, 2)
        write_manifest(folder, outcome.manifest | about | {"wall_s": wall_s})
        shutil.rmtree(folder / WORK)
        self.console.print(f"Written to {folder} in {wall_s:.0f} s.", highlight=False)
