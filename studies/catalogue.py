"""The studies a user can name, and running one: engine, report, files."""

import importlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from gyrocal import InputError
from studies.montecarlo import engine
from studies.montecarlo.backends import Name
from studies.montecarlo.study import load_config
from studies.report import entry as report
from studies.report.console import progress
from studies.report.entry import Entry

MODULES = {
    "paper": "studies.natanson.paper_tables",
    "psi": "studies.calibration.psi",
    "iterations": "studies.calibration.iterations",
    "timestep": "studies.calibration.timestep",
    "consistency": "studies.calibration.consistency",
    "observability": "studies.calibration.maneuvers_needed",
    "noise": "studies.calibration.noise",
    "estimators": "studies.calibration.estimators",
    "alignment": "studies.estimation.alignment",
    "references": "studies.estimation.references",
    "onboard": "studies.estimation.onboard",
    "blind": "studies.validation.blind",
    "flight": "studies.natanson.flight_diagnosis",
    "real": "studies.validation.real_gyro",
    "heads": "studies.robertson.heads",
}


def entry(name: str) -> Entry:
    """The study of a name.

    Raises
    ------
    InputError
        There is none of that name.
    """
    if name not in MODULES:
        raise InputError(f"{name}: no such study; there are {', '.join(MODULES)}")
    found = importlib.import_module(MODULES[name]).ENTRY
    assert isinstance(found, Entry)
    return found


@dataclass(frozen=True)
class Where:
    """How and where a study runs, none of which changes its rows."""

    backend: Name = "loky"
    jobs: int | None = None
    scheduler: str | None = None
    keep: Collection[int] = ()
    retry_failed: bool = False


def run(
    name: str,
    folder: Path,
    changes: Mapping[str, Any],
    console: Console,
    config: Path | None = None,
    where: Where | None = None,
) -> engine.Outcome:
    """Run a study to its end and write and show its report.

    Parameters
    ----------
    name : of the study
    folder : where rows and report are written; a part of the same study that is there is resumed
    changes : settings by dotted path, over those of the file config
    console : for the report
    """
    chosen, where = entry(name), where or Where()
    if name == "blind":  # three processes of its own
        from studies.validation import blind

        return blind.run(folder, changes, console, config, where.jobs)
    settings = load_config(chosen.study, config, changes)
    outcome = engine.run(
        chosen.study,
        settings,
        folder,
        backend=where.backend,
        jobs=where.jobs,
        scheduler=where.scheduler,
        keep=where.keep,
        retry_failed=where.retry_failed,
        progress=partial(progress, quiet=console.quiet),
    )
    rows = outcome.load()
    good = rows[rows["error"] == ""].reset_index(drop=True)
    if good.empty:
        raise InputError(f"{folder}: every case failed, the first one with {rows['error'].iloc[0]}")
    made = chosen.report(settings, good)
    report.write(made, f"Study {name}: {chosen.summary}", folder)
    report.show(made, console)
    return outcome


def rerun(name: str, folder: Path, changes: Mapping[str, Any], case: int, config: Path | None = None) -> engine.Rerun:
    """Repeat one case of a study and keep its recording."""
    chosen = entry(name)
    return engine.rerun(chosen.study, load_config(chosen.study, config, changes), case, folder)
