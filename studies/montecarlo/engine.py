"""The Monte Carlo engine: runs a study's cases, thousands of them, so that they can be stopped, resumed, repeated and trusted.

Case i draws from children of ``SeedSequence(entropy, spawn_key=(i,))`` alone, so its row is the same on every backend,
resumed, or repeated by `rerun`, bit for bit. The folder of a study holds

- ``manifest.json``: configuration, hashes of it and of the source files, versions, machine, seeds, backend, times, failures. It
  is written when a run starts and when it ends
- ``parts/``: the rows of finished cases (`studies.montecarlo.store`); what makes a study resumable
- ``failures/``: a traceback for each failed case
- ``cases/``: recordings of single cases, on demand
- ``table.parquet``: all rows in the order of the cases, once all are there

A case that raises or kills its worker is a row with its error; everything else goes on.
"""

import fcntl
import json
import logging
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pandas as pd
from pydantic import ValidationError

from gyrocal import save
from gyrocal.errors import GyrocalError, InputError
from studies.montecarlo.backends import Executor, Name, SchedulerLostError, open_backend
from studies.montecarlo.cases import Result, Task, build_ended_result, merge_results, run_cases, run_single_threaded
from studies.montecarlo.criteria import StoppingRule, list_checkpoints
from studies.montecarlo.files import write_bytes
from studies.montecarlo.manifest import MANIFEST, collect_versions, describe_provenance, list_changes, write_manifest
from studies.montecarlo.store import ANOTHER_FOLDER, PartInfo, Parts, build_table
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

SEED_FORMULA = "SeedSequence(entropy, spawn_key=(case, *name.encode()))"

Display = Callable[..., AbstractContextManager[Callable[[int], None]]]


class StudyInterrupted(GyrocalError):  # noqa: N818  # an event, not a fault
    """Ctrl-C stopped the study; the message says how far it is and that the same command resumes it."""

    exit_status = 130  # as shells have it


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
    cpu_s: float  # CPU time of all cases, in whatever run they were computed
    manifest: dict[str, Any]  # what the folder's manifest says, without the files

    def load(self, columns: list[str] | None = None) -> pd.DataFrame:
        """The table, or some columns of it."""
        return pd.read_parquet(self.table, columns=columns)

    def check(self) -> None:
        """Raise `GyrocalError` if a case failed, for results that need them all."""
        if self.failures:
            case, error = next(iter(self.failures.items()))
            raise GyrocalError(f"{len(self.failures)} of {self.cases} cases failed, the first one case {case}: {error}")

    def summary(self) -> str:
        """One line: how many cases, failures, and the time they took."""
        resumed = f" ({self.resumed} of them from an earlier run)" if self.resumed else ""
        kinds = Counter(error.partition(":")[0] for error in self.failures.values())
        which = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common(3))
        failed = f"{len(self.failures)} failed ({which}; see {self.folder / 'failures'})" if self.failures else "none failed"
        met = ""
        if until := self.manifest.get("until"):
            answer = "met" if until["met"] else "NOT met"
            met = f", {until['asked']} is {answer}: {until['half_width']:.3g} {until['values']}"
        return f"{self.cases} cases{resumed}, {failed}{met}; {self.wall_s:.1f} s, {self.cpu_s:.1f} s of CPU"


@dataclass(frozen=True)
class Rerun:
    """A case repeated: its rows, traceback if it failed, folder of its recording if the study keeps one.

    `same` is whether the rows are those of the study in the folder, bit for bit; None if that has no such case.
    """

    rows: pd.DataFrame
    traceback: str
    recording: Path | None
    same: bool | None


def show_no_progress(label: str, total: int, *, running: object) -> AbstractContextManager[Callable[[int], None]]:
    """No progress."""
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
    """Run a study, or what is left of it, and write its table.

    Parameters
    ----------
    study : what to run
    config : its configuration
    folder : where it is written; if it holds a part of the same study, that is resumed
    backend : where the cases run, see `studies.montecarlo.backends`
    jobs : workers; by default as many as there are cores
    scheduler : address of a dask scheduler
    progress : (label, cases left, and as `running` what lists the cases that run with their ages in s) to a context with a
        function that is told how many more have ended; for example ``studies.report.console.show_progress``
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
        session = _Session(parts, about, earlier, describe_provenance(study))
        missing = session.find_missing_cases(retry_failed)
        resumed = session.done
        table = folder / "table.parquet"
        with session.record_ending():
            session.write("running")
            if missing:
                workers = open_backend(backend, run_cases, jobs, scheduler)
                with TemporaryDirectory(prefix="gyrocal-") as watch, run_single_threaded() as messages, workers:
                    watched, running = partial(task_for, limit_s=limit_s, watch=watch), partial(workers.list_running, watch)
                    with progress(study.name, sum(map(len, missing)), running=running) as advance:
                        session.finish(partial(session.run_cases, workers, watched, advance), missing, until)
                session.count(messages)
            else:
                session.finish(lambda cases: None, missing, until)
            parts.write_table(table, session.cases)
            manifest = session.write("complete")
    failures, warnings = dict(sorted(session.failures.items())), dict(session.warnings)
    ran = session.cases, min(resumed, session.cases), failures, warnings, manifest["wall_s"], session.cpu_s
    return Outcome(folder, table, *ran, manifest)


def rerun(study: Study, config: StudyConfig, case: int, folder: Path) -> Rerun:
    """Repeat one case in this process and keep its recording in ``folder/cases``.

    An `InputError` if there is no such case, or the folder holds another study.

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
    """Configuration of the study that a folder holds, as it was given; None without one that this study can have."""
    found = read_study_manifest(folder)
    try:
        return study.config.model_validate_json(json.dumps(found["config"])) if found else None
    except (KeyError, ValidationError):
        return None


def read_study_manifest(folder: Path) -> dict[str, Any] | None:
    """Manifest of the study in a folder, None if there is none; `InputError` if it is none of a study."""
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
    """Return a maker of tasks from ranges of cases, the resolved configuration, and what the manifest says of both.

    That is the configuration as given, the resolved scenario, and the hash of both.
    """
    folder = find_study_folder(study)
    if find(study.name, folder) != study:
        raise InputError(f"study {study.name}: what stands there is not the study of that name")
    if type(config) is not study.config:
        raise InputError(f"study {study.name}: needs a {study.config.__name__}, not a {type(config).__name__}")
    ready = resolve_config(config)
    text, given = ready.model_dump_json(), config.model_dump(mode="json")
    if not isinstance(config.scenario, str):
        given["scenario"] = config.scenario.title
    scenario = ready.model_dump(mode="json")["scenario"]
    about = {"study": study.name, "config": given, "scenario": scenario, "config_sha256": hash_config(study, ready)}
    return partial(Task, study.name, text, folder=folder), study.config.model_validate_json(text), about


def _load_earlier_manifest(about: Mapping[str, Any], folder: Path) -> dict[str, Any] | None:
    """Manifest of the same study in the folder, None if there is none; `InputError` if it is of another study."""
    found = read_study_manifest(folder)
    if found is None or found["config_sha256"] == about["config_sha256"]:
        return found
    settings = [{"study": one.get("study"), **one.get("config", {})} for one in (found, about)]
    # With the same settings the content of a scenario file differs, or the order of the dispersions.
    orders = [list(config.get("dispersions", {})) for config in settings]
    content = [{"scenario": one.get("scenario"), "order": order} for one, order in zip((found, about), orders, strict=True)]
    what = list_changes(*settings) or list_changes(*content)
    raise InputError(f"{folder}: holds a study with another configuration ({what}); {ANOTHER_FOLDER}")


def _is_same_table(before: pd.DataFrame, now: pd.DataFrame) -> bool:
    """Whether two tables of a case hold the same; columns that only other cases have are empty."""
    empty = before.drop(columns=list(now), errors="ignore")
    return set(now) <= set(before) and bool(empty.isna().all(axis=None)) and before[list(now)].equals(now)


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
    """Make the folder and hold it for this run, or raise `InputError`; the lock ends with the process, however that ends."""
    folder.mkdir(parents=True, exist_ok=True)
    # Neither through a link nor emptying what is there: nothing is written to it.
    with os.fdopen(os.open(folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666), "w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(f"{folder}: another run is at work in this folder; wait for it or choose another folder") from None
        yield


class _Session:
    """One run of a study in its folder: what the manifest says of it, what is done, and what failed."""

    def __init__(self, parts: Parts, about: Mapping[str, Any], earlier: Mapping[str, Any] | None, made_with: Any) -> None:
        self.parts, self.before, self.made_with, self.cases = parts, earlier or {}, made_with, parts.cases
        self.begun = time.monotonic()
        self.about = {**about, **made_with}
        self.done, self.cpu_s = 0, 0.0
        self.failures: dict[int, str] = {}
        self.warnings: Counter[str] = Counter()

    def count(self, warnings: Mapping[str, int]) -> None:
        """Add to the run's warnings; each is logged when it is first met."""
        for text in warnings:
            if text not in self.warnings:
                logger.warning(text)
        self.warnings.update(warnings)

    def find_missing_cases(self, retry_failed: bool) -> list[range]:
        """The cases that are still to be computed, part by part."""
        self.parts.remove_temporary()
        missing = []
        for cases in self.parts.list_ranges():
            info = self.parts.inspect(cases)
            if isinstance(info, str):
                self.count({f"{self.parts.path(cases.start)} is damaged ({info}) and is computed again": 1})
            if not isinstance(info, PartInfo) or (retry_failed and info.failures):
                missing.append(cases)
            else:
                self._add(cases, *info)
        self.about["resumed"] = self.done
        if self.done and self.before:
            self._check_provenance(bool(missing))
        return missing

    def _check_provenance(self, more: bool) -> None:
        """Refuse finished rows of other source code, and more rows than those on another machine."""
        before = {name: self.before.get(name) for name in self.made_with}
        elsewhere = list_changes(before["machine"] or {}, self.made_with["machine"])
        if before["sources"] != self.made_with["sources"]:
            files = list_changes(before["sources"], self.made_with["sources"], values=False) if before["sources"] else ""
            how = f"before {files or 'the source code'} changed"
        elif elsewhere and more:
            how = f"elsewhere ({elsewhere})"
        else:
            self.about |= before  # a run that makes no rows leaves what made them
            return
        raise InputError(f"{self.parts.folder}: {self.done} finished cases were computed {how}; {ANOTHER_FOLDER}")

    def finish(self, run_missing: Callable[[list[range]], None], missing: list[range], until: StoppingRule | None) -> None:
        """Run the missing cases, or as many as the criterion asks for; the study ends with these."""
        for stop in list_checkpoints(self.cases, self.parts.size) if until else [self.cases]:
            now = [cases for cases in missing if cases.stop <= stop]
            missing = missing[len(now) :]
            if now:
                run_missing(now)
            if until is None:
                return
            table, columns = self.parts.table(stop), list(dict.fromkeys(["case", "error", until.column]))
            rows = (table.select(columns) if until.column in table.column_names else table).to_pandas()
            width, values = until.half_width(rows), until.describe_values(rows)
            self.about["until"] = {"asked": str(until), "half_width": width, "values": values, "met": width < until.limit}
            if width < until.limit:
                self.cases = self.done = stop
                self.failures = {case: error for case, error in self.failures.items() if case < stop}
                return

    def run_cases(
        self, workers: Executor, task_for: Callable[..., Task], advance: Callable[[int], None], missing: list[range]
    ) -> None:
        """Run cases; those of a task whose worker died are run again, each alone."""
        died = []
        try:
            for task, result in workers.results(map(task_for, missing)):
                if result is None:
                    died.append(task)
                else:
                    self._store(task.cases, result)
                    advance(len(task.cases))
            for task in died:
                singles = [task_for(range(case, case + 1)) for case in task.cases]
                alone = (result or build_ended_result(single) for single, result in workers.results(singles, alone=True))
                self._store(task.cases, merge_results(alone))
                advance(len(task.cases))
        finally:
            self.about["jobs"] = workers.jobs

    def _store(self, cases: range, result: Result) -> None:
        """Store a part; its tracebacks first, so that a part that is there is complete."""
        if result.made_with not in (None, self.made_with):
            differs = list_changes(self.made_with["machine"], result.made_with["machine"])
            files = list_changes(self.made_with["sources"], result.made_with["sources"], values=False)
            raise InputError(f"a worker differs ({differs or files}); make them alike, or undo what was edited during the run")
        for case in cases:
            path = self.parts.folder / "failures" / f"case-{case:06d}.txt"
            if case in result.tracebacks:
                write_bytes(path, result.tracebacks[case].encode())
            else:
                path.unlink(missing_ok=True)  # it failed in an earlier run
        self.parts.write(cases, result.rows, result.cpu_s)
        self._add(cases, result.failures, result.cpu_s)
        self.count(result.warnings)

    def _add(self, cases: range, failures: Mapping[int, str], cpu_s: float) -> None:
        self.done += len(cases)
        self.failures.update(failures)
        self.cpu_s += cpu_s

    def write(self, status: str) -> dict[str, Any]:
        """Write the manifest, and return it without the hashes."""
        document = self.about | {
            "cases": self.cases,
            "seeds": {"entropy": self.about["config"]["entropy"], "stream": SEED_FORMULA},
            "status": status,
            "wall_s": round(time.monotonic() - self.begun, 3),
            "cpu_s": round(self.cpu_s, 3),
            "done": self.done,
            "failed": len(self.failures),
            "failures": {str(case): self.failures[case] for case in sorted(self.failures)},
            "warnings": dict(self.warnings),
        }
        write_manifest(self.parts.folder, document, complete=status == "complete")
        return document

    @contextmanager
    def record_ending(self) -> Iterator[None]:
        """Whatever ends the run early is written down, and said in one line if it is not the program's fault."""
        try:
            yield
        except BaseException as error:
            with suppress(OSError):  # a full disk must not hide how the run ended
                self.write("interrupted")
            safe = f"{self.done} of {self.parts.cases} cases are finished and kept in {self.parts.folder}"
            if isinstance(error, KeyboardInterrupt):
                raise StudyInterrupted(f"interrupted; {safe}; the same command resumes") from None
            if isinstance(error, SchedulerLostError):
                raise SchedulerLostError(f"{error}; {safe}; start it again there, and the same command resumes") from None
            if isinstance(error, OSError):
                where, why = error.filename or self.parts.folder, error.strerror or error
                raise InputError(f"{where}: {why}; {safe}; the same command resumes") from None
            raise
