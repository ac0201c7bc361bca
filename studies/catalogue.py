"""The studies a user can name, and running one: engine, report, files."""

import importlib
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from gyrocal import InputError
from studies.montecarlo import engine
from studies.montecarlo.manifest import write_manifest
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
    "wide": "studies.validation.wide.report",
    "compare": "studies.validation.compare_check",
    "flight": "studies.natanson.flight_diagnosis",
    "real": "studies.validation.real_gyro",
    "heads": "studies.robertson.heads",
    "import": "studies.validation.imports",
    "sentinel2a": "studies.validation.sentinel2a",
}


def entry(name: str) -> Entry:
    """The study of a name.

    Raises
    ------
    InputError
        There is none of that name, or it is about an effect that has been taken out.
    """
    if name not in MODULES:
        raise InputError(f"{name}: no such study; there are {', '.join(MODULES)}")
    try:
        found = importlib.import_module(MODULES[name]).ENTRY
    except ImportError as error:
        raise InputError(f"study {name} cannot be loaded: {error}") from error
    assert isinstance(found, Entry)
    return found


def summary(name: str) -> str:
    """What a study shows, or why it cannot be loaded."""
    try:
        return entry(name).summary
    except InputError as error:
        return str(error)


def run(
    name: str,
    folder: Path,
    changes: Mapping[str, Any],
    console: Console,
    config: Path | None = None,
    **options: Any,
) -> engine.Outcome:
    """Run a study to its end and write and show its report.

    Parameters
    ----------
    name : of the study
    folder : where rows and report are written; a part of the same study that is there is resumed
    changes : settings by dotted path, over those of the file config
    console : for the report
    options : how and where it runs, as of `engine.run`; none of them changes its rows
    """
    chosen = entry(name)
    if name == "blind":  # three processes of its own
        from studies.validation import blind

        return blind.run(folder, changes, console, config, options.get("jobs"))
    settings = load_config(chosen.study, config, changes)
    outcome = engine.run(chosen.study, settings, folder, progress=partial(progress, quiet=console.quiet), **options)
    rows = outcome.load()
    good = rows[rows["error"] == ""].reset_index(drop=True)
    if good.empty:
        raise InputError(f"{folder}: every case failed, the first one with {rows['error'].iloc[0]}")
    made = chosen.report(settings, good)
    report.write(made, f"Study {name}: {chosen.summary}", folder)
    write_manifest(folder, outcome.manifest)
    report.show(made, console)
    return outcome


def rerun(name: str, folder: Path, changes: Mapping[str, Any], case: int, config: Path | None = None) -> engine.Rerun:
    """Repeat one case of a study and keep its recording."""
    chosen = entry(name)
    return engine.rerun(chosen.study, load_config(chosen.study, config, changes), case, folder)
