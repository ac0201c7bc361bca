"""The Monte Carlo engine: runs the cases of a study, which can be stopped, resumed and repeated bit for bit.

Case i draws from children of ``SeedSequence(entropy, spawn_key=(i,))`` alone, so its row is the same on every backend,
resumed, or repeated by `rerun`, bit for bit. The folder of a study holds

- ``manifest.json``: configuration, hashes of it and of the source files, versions, machine, seeds, backend, times, failures. It
  is written when a run starts and when it ends
- ``parts/``: the rows of finished cases (`studies.montecarlo.store`); what makes a study resumable
- ``failures/``: a traceback for each failed case
- ``cases/``: recordings of single cases, on demand
- ``table.parquet``: all rows in the order of the cases, once all are there

A case that raises or kills its worker is a row with its error; everything else goes on.

The course of a case: `run` makes a `studies.montecarlo.session.Session`, which hands tasks of some cases each to the backend
(`studies.montecarlo.backends.Executor.results`); a worker runs them (`studies.montecarlo.cases.run_cases`), and the session
stores the rows that come back as a part.
"""

import fcntl
import json
import logging
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from pydantic import ValidationError

from gyrocal import save
from gyrocal.errors import GyrocalError, InputError
from studies.montecarlo.backends import Name, open_backend
from studies.montecarlo.cases import Task, run_cases, run_single_threaded
from studies.montecarlo.criteria import StoppingRule
from studies.montecarlo.manifest import MANIFEST, collect_versions, describe_provenance, list_changes
from studies.montecarlo.session import Session
from studies.montecarlo.store import ANOTHER_FOLDER, Parts, build_table
from studies.montecarlo.study import (
    GridConfig,
    Streams,
    Study,
    StudyConfig,
    find,
    find_study_folder,
    hash_config,
    resolve_config,
)

logger = logging.getLogger(__name__)

TABLE = "table.parquet"  # of all rows

Display = Callable[[str, int], AbstractContextManager[Callable[[int], None]]]


@dataclass(frozen=True)
class Outcome:
    """A finished study."""

    folder: Path  # of the study
    table: Path  # of all rows, a Parquet file
    cases: int  # their number
    resumed: int  # number of cases found finished in the folder
    failures: dict[int, str]  # error of each failed case
    warnings: dict[str, int]  # how often each warning was given in this run
    wall_s: float  # duration of this run
    cpu_s: float  # CPU time of all cases, including earlier runs
    manifest: dict[str, Any]  # contents of the folder's manifest, without the files

    def load(self, columns: list[str] | None = None) -> pd.DataFrame:
        """Load the table, or some columns of it."""
        return pd.read_parquet(self.table, columns=columns)

    def check(self) -> None:
        """Raise `GyrocalError` if a case failed, for results that need them all."""
        if self.failures:
            case, error = next(iter(self.failures.items()))
            raise GyrocalError(f"{len(self.failures)} of {self.cases} cases failed, the first one case {case}: {error}")

    def summary(self) -> str:
        """Summarise the cases, failures and times in one line."""
        resumed = f" ({self.resumed} of them from an earlier run)" if self.resumed else ""
        kinds = Counter(error.partition(":")[0] for error in self.failures.values())
        counts = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common(3))
        failed = f"{len(self.failures)} failed ({counts}; see {self.folder / 'failures'})" if self.failures else "none failed"
        criterion = ""
        if until := self.manifest.get("until"):
            answer = "met" if until["met"] else "NOT met"
            criterion = f", {until['asked']} is {answer}: {until['half_width']:.3g} {until['values']}"
        return f"{self.cases} cases{resumed}, {failed}{criterion}; {self.wall_s:.1f} s, {self.cpu_s:.1f} s of CPU"


@dataclass(frozen=True)
class Rerun:
    """A case repeated: its rows, traceback if it failed, folder of its recording if the study keeps one.

    `same` is whether the rows are those of the study in the folder, bit for bit; None if that has no such case.
    """

    rows: pd.DataFrame
    traceback: str
    recording: Path | None
    same: bool | None


def show_no_progress(label: str, total: int) -> AbstractContextManager[Callable[[int], None]]:
    """Show no progress."""
    return nullcontext(lambda count: None)


def run(
    study: Study,
    config: StudyConfig,
    folder: Path,
    *,
    backend: Name = "loky",
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Display = show_no_progress,
    retry_failed: bool = False,
    until: StoppingRule | None = None,
    limit_s: float = 0.0,
) -> Outcome:
    """Run a study, or the cases of it that are missing, and write its table.

    Parameters
    ----------
    study : what to run
    config : its configuration
    folder : where it is written; if it holds a part of the same study, the run resumes it
    backend : where the cases run, see `studies.montecarlo.backends`
    jobs : workers; by default as many as there are cores
    scheduler : address of a dask scheduler
    progress : (label, cases left) to a context of a function that takes the number of further cases ended; for example
        ``studies.report.console.show_progress``
    retry_failed : run failed cases of earlier runs again
    until : stop as soon as this is met; the configuration's number of cases is then the most there may be
    limit_s : time after which a case is ended and has failed; none by default

    Raises
    ------
    InputError
        The configuration cannot be used, or the folder holds another study or rows that were made otherwise.
    StudyInterrupted
        Ctrl-C; what has ended is kept.
    """
    task_for, ready, about = _prepare(study, config)
    if until and (isinstance(ready, GridConfig) or (ready.sampler == "lhs" and ready.dispersions)):
        raise InputError(f"study {study.name}: --until needs cases of which the first ones are a sample, not a grid or lhs")
    folder = Path(folder)
    with open_study_folder(folder):
        earlier = _load_earlier_manifest(about, folder)
        parts = Parts(folder, config.cases, about["config_sha256"])
        about |= collect_versions(["distributed"] if backend == "dask" else [])
        about |= {"backend": backend, "jobs": None, "limit_s": limit_s}
        session = Session(parts, about, earlier, describe_provenance(study))
        missing = session.find_missing_cases(retry_failed)
        resumed = session.done
        with session.record_ending():
            session.write("running")
            if missing:
                workers, count = open_backend(backend, run_cases, jobs, scheduler), sum(map(len, missing))
                with run_single_threaded() as messages, workers, progress(study.name, count) as advance:
                    compute = partial(session.run_cases, workers, partial(task_for, limit_s=limit_s), advance)
                    session.finish(compute, missing, until)
                session.count(messages)
            else:
                session.finish(lambda cases: None, missing, until)
            parts.write_table(folder / TABLE, session.cases)
            manifest = session.write("complete")
    return Outcome(
        folder=folder,
        table=folder / TABLE,
        cases=session.cases,
        resumed=min(resumed, session.cases),
        failures=dict(sorted(session.failures.items())),
        warnings=dict(session.warnings),
        wall_s=manifest["wall_s"],
        cpu_s=session.cpu_s,
        manifest=manifest,
    )


def rerun(study: Study, config: StudyConfig, case: int, folder: Path) -> Rerun:
    """Repeat one case in this process and keep its recording in ``folder/cases``.

    Raises `InputError` if there is no such case, or the folder holds another study.

    Parameters
    ----------
    study, config, folder : as given to `run`
    case : number of the case
    """
    task_for, ready, about = _prepare(study, config)
    if not 0 <= case < config.cases:
        raise InputError(f"case {case}: the study has the cases 0 to {config.cases - 1}")
    folder = Path(folder)
    earlier = _load_earlier_manifest(about, folder)
    # First, since the case may end this process.
    recording = _keep(study, ready, case, folder) if study.recording else None
    result = run_cases(task_for(range(case, case + 1)))
    rows = build_table(result.rows).to_pandas()
    before = Parts(folder, config.cases, about["config_sha256"]).read_case_rows(case) if earlier else None
    return Rerun(rows, result.tracebacks.get(case, ""), recording, None if before is None else _is_same_table(before, rows))


def load_stored_config(study: Study, folder: Path) -> StudyConfig | None:
    """Load the configuration, as given, of the study in a folder; None without one that this study can have."""
    manifest = read_study_manifest(folder)
    try:
        return study.config.model_validate_json(json.dumps(manifest["config"])) if manifest else None
    except (KeyError, ValidationError):
        return None


def read_study_manifest(folder: Path) -> dict[str, Any] | None:
    """Read the manifest of the study in a folder; None without one, `InputError` if it is no study's."""
    path = folder / MANIFEST
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        _ = manifest["config_sha256"], range(manifest["cases"])
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"{path}: is not the manifest of a Monte Carlo study; choose another folder") from None
    return dict(manifest)


def _prepare(study: Study, config: StudyConfig) -> tuple[Callable[..., Task], StudyConfig, dict[str, Any]]:
    """Return a maker of tasks from ranges of cases, the resolved configuration, and its entries in the manifest.

    That is the configuration as given, the resolved scenario, and the hash of both.
    """
    folder = find_study_folder(study)
    if find(study.name, folder) != study:
        raise InputError(f"study {study.name}: what stands there is not the study of that name")
    if type(config) is not study.config:
        raise InputError(f"study {study.name}: needs a {study.config.__name__}, not a {type(config).__name__}")
    ready = resolve_config(config)
    text, stated = ready.model_dump_json(), config.model_dump(mode="json")
    if not isinstance(config.scenario, str):
        stated["scenario"] = config.scenario.title
    scenario = ready.model_dump(mode="json")["scenario"]
    about = {"study": study.name, "config": stated, "scenario": scenario, "config_sha256": hash_config(study, ready)}
    return partial(Task, study.name, text, folder=folder), study.config.model_validate_json(text), about


def _load_earlier_manifest(about: Mapping[str, Any], folder: Path) -> dict[str, Any] | None:
    """Load the manifest of the same study in the folder; None without one, `InputError` if of another study."""
    earlier = read_study_manifest(folder)
    if earlier is None or earlier["config_sha256"] == about["config_sha256"]:
        return earlier
    settings = [{"study": description.get("study"), **description.get("config", {})} for description in (earlier, about)]
    # With the same settings the content of a scenario file differs, or the order of the dispersions.
    orders = [list(config.get("dispersions", {})) for config in settings]
    content = [
        {"scenario": description.get("scenario"), "order": order}
        for description, order in zip((earlier, about), orders, strict=True)
    ]
    changes = list_changes(*settings) or list_changes(*content)
    raise InputError(f"{folder}: holds a study with another configuration ({changes}); {ANOTHER_FOLDER}")


def _is_same_table(before: pd.DataFrame, now: pd.DataFrame) -> bool:
    """Check that two tables of a case are equal; columns that only other cases have are empty."""
    only_before = before.drop(columns=list(now), errors="ignore")
    return set(now) <= set(before) and bool(only_before.isna().all(axis=None)) and before[list(now)].equals(now)


def _keep(study: Study, config: StudyConfig, case: int, folder: Path) -> Path | None:
    """Save the recording of a case; None, with a message, if it cannot be made."""
    assert study.recording is not None
    path = folder / "cases" / f"case-{case:06d}"
    try:
        with run_single_threaded():
            recording = study.recording(config, case, Streams(config.entropy, case))
    except Exception as error:
        logger.warning("case %d: no recording, %s: %s", case, type(error).__name__, error)
        return None
    save(recording, path)
    return path


@contextmanager
def open_study_folder(folder: Path) -> Iterator[None]:
    """Make the folder and lock it for this run, or raise `InputError`; the lock ends with the process in any case."""
    folder.mkdir(parents=True, exist_ok=True)
    # Without following a link or truncating a file: nothing is written to the lock file.
    with os.fdopen(os.open(folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666), "w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(f"{folder}: another run is at work in this folder; wait for it or choose another folder") from None
        yield
