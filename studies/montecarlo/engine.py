"""The Monte Carlo engine: runs a study's cases, thousands of them, so that they can be stopped, resumed, repeated and trusted.

    outcome = run(STUDY, load_config(STUDY, changes={"cases": 10_000}), Path("results/noise"))
    table = outcome.load()

Case i draws from children of ``SeedSequence(entropy, spawn_key=(i,))`` alone, so its row is the same on every backend,
resumed, or repeated by `rerun`, bit for bit. The folder of a study holds

- ``manifest.json``: configuration, hashes of it and of the source code, versions, machine, seeds, backend, times, failures
- ``parts/``: the rows of each finished chunk (`studies.montecarlo.store`); what makes a study resumable
- ``failures/``: a traceback for each failed case
- ``cases/``: recordings of single cases, on demand
- ``table.parquet``: all rows in the order of the cases, once all are there

A case that raises or kills its worker is a row with its error; everything else goes on.
"""

import json
import logging
import shutil
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from pydantic import ValidationError

from gyrocal import save
from gyrocal.errors import GyrocalError, InputError
from studies.montecarlo.backends import Executor, Name, open_backend
from studies.montecarlo.cases import Task, run_cases, run_single_threaded
from studies.montecarlo.manifest import WORK, hash_bytes, write_manifest
from studies.montecarlo.provenance import describe_provenance, list_changes
from studies.montecarlo.session import Session, StudyInterrupted, handle_stop_signals, open_study_folder, read_study_manifest
from studies.montecarlo.stopping_rule import StoppingRule, list_checkpoints
from studies.montecarlo.store import Parts, build_table
from studies.montecarlo.study import (
    Streams,
    Study,
    StudyConfig,
    find,
    find_study_folder,
    hash_config,
    is_extendable,
    resolve_config,
)

__all__ = [
    "Name",
    "Outcome",
    "Rerun",
    "Streams",
    "Study",
    "StudyConfig",
    "StudyInterrupted",
    "rerun",
    "run",
    "show_no_progress",
]

logger = logging.getLogger(__name__)

LARGEST_CHUNK = 64  # cases
CHUNKS = 128  # that a study has at least, if it has so many cases

Display = Callable[[str, int], AbstractContextManager[Callable[[int], None]]]


@dataclass(frozen=True)
class Outcome:
    """A finished study.

    Attributes
    ----------
    folder : of the study
    table : its table, a Parquet file
    cases : number of cases
    resumed : of them, those found finished in the folder
    failures : error of each failed case
    warnings : how often each warning was given in this run
    wall_s : duration of this run
    cpu_s : CPU time of all cases, in whatever run they were computed
    manifest : what the folder's manifest says, without the files
    """

    folder: Path
    table: Path
    cases: int
    resumed: int
    failures: dict[int, str]
    warnings: dict[str, int]
    wall_s: float
    cpu_s: float
    manifest: dict[str, Any]

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
        failed = (
            f", {len(self.failures)} failed ({which}; see {self.folder / 'failures'})" if self.failures else ", none failed"
        )
        until = self.manifest.get("until")
        met = f", {until['asked']} is {'met' if until['met'] else 'NOT met'}: {until['half_width']:.3g}" if until else ""
        return f"{self.cases} cases{resumed}{failed}{met}; {self.wall_s:.1f} s, {self.cpu_s:.1f} s of CPU"


@dataclass(frozen=True)
class Rerun:
    """A case repeated.

    Attributes
    ----------
    rows : its rows
    traceback : of its failure; empty if it succeeded
    recording : folder with its recording; None if the study keeps none
    same : whether the rows are those of the study in the folder, bit for bit; None if that has no such case
    """

    rows: pd.DataFrame
    traceback: str
    recording: Path | None
    same: bool | None


def show_no_progress(label: str, total: int) -> AbstractContextManager[Callable[[int], None]]:
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
    chunk: int | None = None,
    progress: Display = show_no_progress,
    keep: Collection[int] = (),
    retry_failed: bool = False,
    until: StoppingRule | None = None,
    mix: bool = False,
) -> Outcome:
    """Run a study, or what is left of it, and write its table.

    Parameters
    ----------
    study : what to run
    config : its configuration
    folder : where it is written; if it holds a part of the same study, that is resumed, and if it holds the same study with
        fewer cases, only the others are computed
    backend : where the cases run, see `studies.montecarlo.backends`
    jobs : workers; by default as many as there are cores
    scheduler : address of a dask scheduler
    chunk : cases that are handed out and stored together; changes nothing in the table
    progress : (label, cases left) to a context with a function that is told how many more have ended; for example
        ``functools.partial(studies.report.console.show_progress, console)``
    keep : cases whose recordings are kept
    retry_failed : run failed cases of earlier runs again
    until : stop as soon as this is met; the configuration's number of cases is then the most there may be
    mix : let rows stand beside those of an earlier run with other source code, or on another machine

    Raises
    ------
    InputError
        The configuration cannot be used, the folder holds another study or rows that were made otherwise, or it cannot be
        written (`StorageError`).
    Interrupted
        Ctrl-C, SIGTERM or SIGHUP; what has ended is kept.
    """
    task_for, ready = _prepare(study, config)
    if keep and study.recording is None:
        raise InputError(f"study {study.name}: has no recordings to keep")
    for case in keep:
        _check_case(config, case)
    if until and not is_extendable(study, ready):
        raise InputError(f"study {study.name}: --until needs rows that do not depend on the number of cases")
    folder = Path(folder)
    with open_study_folder(folder), handle_stop_signals():
        document = describe_configuration(study, config)
        earlier = _load_earlier_manifest(document, folder)
        document["chunk"] = _choose_chunk_size(config.cases, chunk, earlier, folder)
        parts = Parts(folder, config.cases, document["chunk"], document["config_sha256"])
        session = Session(parts, task_for, document, earlier, backend, describe_provenance(study), mix)
        missing = session.find_missing_cases(retry_failed)
        resumed = session.done
        table = folder / "table.parquet"
        with session.record_ending():
            session.write("running")
            if missing:
                with run_single_threaded() as messages, _open_executor(backend, jobs, scheduler) as workers:
                    try:
                        with progress(study.name, sum(map(len, missing))) as advance:
                            _finish(session, workers, missing, advance, until)
                    finally:
                        session.run["jobs"] = workers.jobs
                session.count(messages)
            elif until:
                _finish(session, None, missing, lambda count: None, until)
            for case in keep:
                _keep(study, ready, case, folder)
            session.parts.write_table(table)
            manifest = session.write("complete")
    return Outcome(
        folder=folder,
        table=table,
        cases=manifest["cases"],
        resumed=min(resumed, manifest["cases"]),
        failures=dict(sorted(session.failures.items())),
        warnings=dict(session.warnings),
        wall_s=session.wall_s,
        cpu_s=session.cpu_s,
        manifest=manifest,
    )


def _finish(
    session: Session, workers: Executor | None, missing: list[range], advance: Callable[[int], None], until: StoppingRule | None
) -> None:
    """Run the missing cases, or as many as the criterion asks for; the study ends with these."""
    parts = session.parts
    for stop in list_checkpoints(parts.cases, parts.chunk) if until else [parts.cases]:
        now = [cases for cases in missing if cases.stop <= stop]
        missing = missing[len(now) :]
        if workers and now:
            session.finish(workers, now, advance)
        if until is None:
            return
        width = until.half_width(parts.values(until.column, stop))
        session.about["until"] = {"asked": str(until), "half_width": width, "met": width < until.limit}
        if width < until.limit:
            session.end_at(stop)
            return


def _load_earlier_manifest(document: Mapping[str, Any], folder: Path) -> dict[str, Any] | None:
    """Manifest of the same study in the folder, with as many cases or fewer; None if there is none.

    Raises
    ------
    InputError
        The folder holds another study, or one that cannot be continued.
    """
    found = read_study_manifest(folder)
    if found is None:
        return None
    before, cases = found["cases"], document["cases"]
    if found["config_sha256"] == document["config_sha256"] and before <= cases:
        return found
    settings = ({"study": one.get("study"), **one.get("config", {}), "cases": None} for one in (found, document))
    scenarios = ({"scenario": one.get("scenario")} for one in (found, document))
    why = "it cannot have fewer" if before > cases else "its rows depend on the number of cases"
    number = f"cases: {before} → {cases}, and {why}" if before != cases else "the order of the dispersions"
    what = list_changes(*settings) or list_changes(*scenarios) or number
    raise InputError(f"{folder}: holds a study with another configuration ({what}); choose another folder")


def _choose_chunk_size(cases: int, wanted: int | None, earlier: Mapping[str, Any] | None, folder: Path) -> int:
    """Cases of a chunk: what the folder's parts have, else what is wanted, else what suits the number of cases.

    Raises
    ------
    InputError
        The folder's parts are of another size, or the size is not positive.
    """
    if wanted is not None and wanted < 1:
        raise InputError(f"chunk {wanted}: must be at least one case")
    if earlier is None:
        return wanted or min(LARGEST_CHUNK, -(-cases // CHUNKS))
    if wanted not in (None, earlier["chunk"]):
        raise InputError(f"{folder}: its parts hold {earlier['chunk']} cases each, not {wanted}; leave --chunk out to resume")
    return int(earlier["chunk"])


def get_work_folder(folder: Path, study: Study, config: StudyConfig) -> Path:
    """Return the folder of a study whose rows are not kept, inside the folder of its output.

    Of each configuration, source code and machine its own, so that what another one left unfinished is never in the way.
    """
    made = [hash_config(study, resolve_config(config)), config.cases, describe_provenance(study)]
    return Path(folder) / WORK / hash_bytes(json.dumps(made, sort_keys=True).encode())[:12]


def finish_folder(outcome: Outcome, folder: Path, **about: Any) -> None:
    """Write the manifest of what was made of a study's rows, and remove the `get_work_folder` of the folder.

    Parameters
    ----------
    outcome : of the study
    folder : every result in it is hashed
    about : what the manifest says differently from the study's own, as plain values
    """
    write_manifest(folder, outcome.manifest | about)
    shutil.rmtree(Path(folder) / WORK)


def load_stored_config(study: Study, folder: Path) -> StudyConfig | None:
    """Configuration of the study that a folder holds, as it was given; None without one that this study can have."""
    found = read_study_manifest(folder)
    try:
        return study.config.model_validate_json(json.dumps(found["config"])) if found else None
    except (KeyError, ValidationError):
        return None


def rerun(study: Study, config: StudyConfig, case: int, folder: Path) -> Rerun:
    """Repeat one case in this process and keep its recording in ``folder/cases``.

    Parameters
    ----------
    study, config, folder : as given to `run`
    case : number of the case

    Raises
    ------
    InputError
        There is no such case, or the folder holds another study.
    """
    task_for, ready = _prepare(study, config)
    _check_case(config, case)
    folder = Path(folder)
    document = describe_configuration(study, config)
    manifest = _load_earlier_manifest(document, folder)
    # First, since the case may end this process.
    recording = _keep(study, ready, case, folder) if study.recording else None
    result = run_cases(task_for(range(case, case + 1)))
    rows = build_table(result.rows).to_pandas()
    same = None
    if manifest:
        before = Parts(folder, config.cases, manifest["chunk"], document["config_sha256"]).read_case_rows(case)
        same = None if before is None else _is_same_table(before, rows)
    return Rerun(rows, result.tracebacks.get(case, ""), recording, same)


def _prepare(study: Study, config: StudyConfig) -> tuple[Callable[[range], Task], StudyConfig]:
    """Return a maker of tasks from ranges of cases, and the resolved configuration."""
    folder = find_study_folder(study)
    if find(study.name, folder) != study:
        raise InputError(f"study {study.name}: what stands there is not the study of that name")
    if type(config) is not study.config:
        raise InputError(f"study {study.name}: needs a {study.config.__name__}, not a {type(config).__name__}")
    ready = resolve_config(config)
    text = ready.model_dump_json()
    return lambda cases: Task(study.name, text, cases, folder), study.config.model_validate_json(text)


def _check_case(config: StudyConfig, case: int) -> None:
    if not 0 <= case < config.cases:
        raise InputError(f"case {case}: the study has the cases 0 to {config.cases - 1}")


def describe_configuration(study: Study, config: StudyConfig) -> dict[str, Any]:
    """Describe a study for the manifest: its configuration as given, the resolved scenario, and the hash of both."""
    ready = resolve_config(config)
    given = config.model_dump(mode="json")
    if not isinstance(config.scenario, str):
        given["scenario"] = config.scenario.title
    scenario = ready.model_dump(mode="json")["scenario"]
    sha256 = hash_config(study, ready)
    return {"study": study.name, "config": given, "scenario": scenario, "config_sha256": sha256, "cases": config.cases}


def _is_same_table(before: pd.DataFrame, now: pd.DataFrame) -> bool:
    """Whether two tables of a case hold the same; columns that only other cases have are empty."""
    if not set(now) <= set(before):
        return False
    empty = [name for name in before if name not in now]
    return bool(before[empty].isna().all(axis=None)) and before[list(now)].equals(now)


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
def _open_executor(name: Name, jobs: int | None, scheduler: str | None) -> Iterator[Executor]:
    backend = open_backend(name, run_cases, jobs, scheduler)
    finished = False
    try:
        yield backend
        finished = True
    finally:
        backend.close(finished)
