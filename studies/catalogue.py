"""The studies a user can name, and running one: engine, report, files."""

from __future__ import annotations

import importlib
import importlib.util
import sys
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from rich.console import Console

from gyrocal.errors import InputError, suggest_names
from studies.report.console import show_progress
from studies.report.junit import Verdict, convert_checks, write_junit

if TYPE_CHECKING:
    from studies.montecarlo import engine
    from studies.montecarlo.criteria import Answer, Requirement
    from studies.report.entry import Entry, Report

MODULES = {  # of the studies of the list
    "paper": "natanson.paper_tables",
    "psi": "calibration.psi",
    "iterations": "calibration.iterations",
    "timestep": "calibration.timestep",
    "consistency": "calibration.consistency",
    "observability": "calibration.maneuvers_needed",
    "noise": "calibration.noise",
    "withheld": "withheld.score",
    "flight": "natanson.flight_diagnosis",
    "real": "validation.real_gyro",
    "heads": "robertson.heads",
}
STUDY_NAMES = tuple(MODULES)
FEWEST_TOLERANCE_CASES = 93  # below which no interval holds 95 % of all cases with a confidence of 95 %
OWN_MODULES = MODULES | {"recovered": "validation.recovered"}  # with the study of the project's own baseline


def find_entry(name: str) -> Entry:
    """Find the study of a name, or of a file with a STUDY in it.

    Raises `InputError` if there is none of that name, if it cannot be loaded, or if the file holds no study.
    """
    if is_file(name):
        return load_study_file(Path(name))
    if name not in OWN_MODULES:
        raise InputError(f"{name}: no such study; {suggest_names(name, STUDY_NAMES)}")
    try:
        entry: Entry = importlib.import_module(f"studies.{OWN_MODULES[name]}").ENTRY
    except ImportError as error:
        raise InputError(f"study {name} cannot be loaded: {error}") from error
    return entry


def is_file(name: str) -> bool:
    """Check whether a name is the path of a file."""
    return name.endswith(".py") or "/" in name


def load_study_file(path: Path) -> Entry:
    """Load the ENTRY of a file, or its STUDY with a report on all columns, as a module of its name.

    Raises `InputError` if it cannot be imported, or holds no study or a study of another name.
    """
    from studies.montecarlo.study import Study
    from studies.report.entry import Entry, report_columns

    module = _import_file(path)
    entry = getattr(module, "ENTRY", None)
    study = getattr(module, "STUDY", None) if entry is None else entry.study
    if not isinstance(study, Study):
        raise InputError(f"{path}: has no STUDY; see docs/studies.md for an example")
    module_name, _, attribute = study.name.partition(":")
    if module_name != path.stem or getattr(module, attribute, None) != study:
        raise InputError(f'{path}: its STUDY is called {study.name!r}; call it "{path.stem}:STUDY"')
    summary = (module.__doc__ or path.stem).strip().splitlines()[0]
    return entry if isinstance(entry, Entry) else Entry(study, summary, report_columns)


def _import_file(path: Path) -> ModuleType:
    """Import a file as the module of its name; its folder is appended to Python's path, for modules beside it."""
    name, folder = path.stem, str(path.resolve().parent)
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    if not name.isidentifier():
        raise InputError(f"{path}: cannot be imported by this name; use letters, digits and underscores")
    if folder not in sys.path:
        sys.path.append(folder)
    importlib.invalidate_caches()
    try:
        spec = importlib.util.find_spec(name)
        if spec is None or spec.origin is None or Path(spec.origin).resolve() != path.resolve():
            raise InputError(f"{path}: another module is called {name}; give the file another name")
        return importlib.import_module(name)
    except InputError:
        raise
    except (Exception, SystemExit) as error:  # the file may run any code
        lines = [entry.lineno for entry in traceback.extract_tb(error.__traceback__) if Path(entry.filename).stem == name]
        place = f"{path}, line {lines[-1]}" if lines else str(path)
        raise InputError(f"{place}: {type(error).__name__}: {' '.join(str(error).split())}") from None


def describe_study(name: str) -> str:
    """Describe a study, or the reason why it cannot be loaded."""
    try:
        return find_entry(name).summary
    except InputError as error:
        return str(error)


def run(
    name: str,
    folder: Path,
    changes: Mapping[str, Any],
    console: Console,
    config: Path | None = None,
    junit: Path | None = None,
    requirements: Sequence[Requirement] = (),
    **options: Any,
) -> engine.Outcome:
    """Run a study to its end, or resume the one in the folder, and write and show its report.

    Changes are settings by dotted path, which replace those of the file config. Options are those of `engine.run`.
    """
    study_entry = find_entry(name)

    from studies.montecarlo import engine
    from studies.montecarlo.criteria import check_independent
    from studies.montecarlo.manifest import write_manifest
    from studies.montecarlo.study import load_config
    from studies.report import entry as report

    settings = load_config(study_entry.study, config, changes)
    if requirements:
        check_independent(settings, "--require")
    name = Path(name).stem
    outcome = engine.run(study_entry.study, settings, folder, progress=partial(show_progress, quiet=console.quiet), **options)
    answers = [requirement.judge(outcome.load()) for requirement in requirements]
    if answers:
        outcome = replace(outcome, manifest=outcome.manifest | {"requirements": [asdict(answer) for answer in answers]})
    result = build_report(study_entry, settings.model_copy(update={"cases": outcome.cases}), outcome, answers)
    report.write(result, f"Study {name}: {study_entry.summary}", folder)
    write_manifest(folder, outcome.manifest)
    report.show(result, console)
    if junit:
        write_junit(junit, f"gyrocal study {name}", str(folder), [*convert_checks(result.checks), *list_run_verdicts(outcome)])
    return outcome


def build_report(study_entry: Entry, settings: Any, outcome: engine.Outcome, answers: Sequence[Answer]) -> Report:
    """Build the report on the good rows of a run, with the answers to its requirements first and tolerance intervals last."""
    from studies.montecarlo.criteria import draws_independently
    from studies.report.checks import check_requirements
    from studies.report.entry import build_tolerance_table

    rows = outcome.load()
    good_rows = rows[rows["error"] == ""].reset_index(drop=True)
    if good_rows.empty:
        raise InputError(
            f"{outcome.folder}: every case failed, the first one with {rows['error'].iloc[0]}; {outcome.folder}/failures has "
            "the tracebacks, and --retry-failed runs the cases again"
        )
    try:
        result = study_entry.report(settings, good_rows)
    except Exception as error:
        error.add_note(
            f"The report failed; {outcome.table} has the rows. The same command makes the report again; "
            "after a change of the source code choose another --out."
        )
        raise
    is_row_a_case = good_rows["case"].is_unique and len(good_rows) >= FEWEST_TOLERANCE_CASES
    has_intervals = is_row_a_case and draws_independently(settings)
    return replace(
        result,
        tables={**result.tables, **({"tolerance": build_tolerance_table(good_rows)} if has_intervals else {})},
        checks=(*check_requirements(answers), *result.checks),
        findings=(*map(str, answers), *result.findings),
    )


def list_run_verdicts(outcome: engine.Outcome) -> list[Verdict]:
    """List failed cases and the criterion of --until as verdicts."""
    verdicts = [Verdict(f"case {case}", error) for case, error in outcome.failures.items()]
    if until := outcome.manifest.get("until"):
        verdicts.append(Verdict(until["asked"], "" if until["met"] else f"{until['half_width']:.3g} {until['values']}"))
    return verdicts


def rerun(name: str, folder: Path, changes: Mapping[str, Any], case: int, config: Path | None = None) -> engine.Rerun:
    """Repeat one case of a study and keep its recording; without settings, those of the study in the folder."""
    study = find_entry(name).study

    from studies.montecarlo import engine
    from studies.montecarlo.study import load_config

    stored_config = None if changes or config else engine.load_stored_config(study, folder)
    return engine.rerun(study, stored_config or load_config(study, config, changes), case, folder)
