"""Running cases: a worker is handed a `Task` and hands back a `Result`, all of it plain text and numbers.

A case that raises is a row with its error, and a traceback in the result. A worker's warnings, which nobody would see, are
counted.
"""

import os
import threading
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from studies.montecarlo.manifest import describe_provenance
from studies.montecarlo.study import DISPERSED, RESERVED, Streams, Study, StudyConfig, draw_case_values, find

LONGEST_ERROR = 500  # characters of an error in a row
KILLED = "WorkerDied: killed its worker"
INT64 = range(-(2**63), 2**63)
KINDS: dict[type, str] = {type(None): "nothing", bool: "truth value", int: "number", float: "number", str: "text"}
# A worker of a cluster may have several threads, while the settings below are those of the process.
ONE_AT_A_TIME = threading.Lock()


@dataclass(frozen=True)
class Task:
    """Cases to run: name of the study, its resolved configuration as JSON, case numbers, folder of a study that is a file.

    `limit_s` is the longest time of a case, 0 without a limit, and `watch` the folder in which a process notes its case.
    """

    study: str
    config: str
    cases: range
    folder: str = ""
    limit_s: float = 0.0
    watch: str = ""


@dataclass(frozen=True)
class Result:
    """What became of a task: its rows, failed cases with tracebacks, CPU time, warnings, and what the worker is made with."""

    rows: list[dict[str, Any]]
    tracebacks: dict[int, str]
    cpu_s: float = 0.0
    warnings: Counter[str] = field(default_factory=Counter)
    made_with: dict[str, Any] | None = None

    @property
    def failures(self) -> dict[int, str]:
        """Error of each failed case."""
        return {row["case"]: row["error"] for row in self.rows if row["error"]}


@contextmanager
def run_single_threaded() -> Iterator[Counter[str]]:
    """Make the process the same wherever a case runs: one BLAS thread, and warnings counted; yields how often each was given.

    With more threads BLAS may split a sum otherwise, and bits differ. A warning that a filter of the process turned into an
    error would be a failed case in this place alone.
    """
    messages: Counter[str] = Counter()

    def count(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        messages[f"{category.__name__}: {' '.join(str(message).split())}"] += 1

    with warnings.catch_warnings(), threadpool_limits(1):
        warnings.simplefilter("always")
        warnings.showwarning = count
        yield messages


@contextmanager
def _note_cases(folder: str) -> Iterator[Callable[[int], object]]:
    """Yield a function that notes which case begins, in a file of this process; nothing without a folder."""
    if not folder:
        yield lambda case: None
        return
    Path(folder).mkdir(exist_ok=True)
    path = Path(folder, str(os.getpid()))
    with path.open("wb", buffering=0) as file:
        yield lambda case: os.pwrite(file.fileno(), b"%-20d" % case, 0)
    path.unlink(missing_ok=True)


def list_running_cases(folder: str) -> dict[int, float]:
    """List the cases that processes of this machine have noted in a folder, with their ages in s."""
    found = {}
    for path in Path(folder).glob("*"):
        with suppress(OSError, ValueError):
            os.kill(int(path.name), 0)  # one that was killed has left its file
            found[int(path.read_text())] = time.time() - path.stat().st_mtime
    return found


def run_cases(task: Task, kinds: dict[str, str] | None = None) -> Result:
    """Run the cases of a task, one after the other; `kinds`, what each column holds, is that of earlier cases, and grows."""
    study = find(task.study, task.folder)
    config = _parse_config(study, task.config)
    kinds = {} if kinds is None else kinds
    rows: list[dict[str, Any]] = []
    tracebacks: dict[int, str] = {}
    with ONE_AT_A_TIME, _note_cases(task.watch) as note, run_single_threaded() as messages:
        if task.limit_s:
            from studies.montecarlo.time_limit import run_limited

            singles = (replace(task, cases=range(case, case + 1)) for case in task.cases)
            return merge_results(run_limited(one, kinds, note) for one in singles)
        made_with = describe_provenance(study)  # before the cases, while what was imported is young
        start = time.process_time()
        for case in task.cases:
            note(case)
            try:
                rows += _compute_case_rows(study, config, case, kinds)
            except (Exception, SystemExit) as error:
                tracebacks[case] = "".join(traceback.format_exception(error))
                text = f"{type(error).__name__}: {' '.join(str(error).split())}"
                rows.append({"case": case, "error": text[:LONGEST_ERROR]})
        return Result(rows, tracebacks, time.process_time() - start, messages, made_with)


def build_failed_result(task: Task, error: str, text: str) -> Result:
    """Result of a single case that was ended, with what is known of it."""
    (case,) = task.cases
    return Result([{"case": case, "error": error}], {case: f"{error}\n\n{text}"})


def build_killed_result(task: Task) -> Result:
    """Result of a single case whose worker died of it."""
    text = "The process that ran this case alone ended without an answer: a signal, os._exit, or no memory left.\n"
    return build_failed_result(task, KILLED, text)


def merge_results(results: Iterable[Result]) -> Result:
    """One result from several."""
    whole = Result([], {})
    for one in results:
        tracebacks, warnings = whole.tracebacks | one.tracebacks, whole.warnings + one.warnings
        whole = Result(whole.rows + one.rows, tracebacks, whole.cpu_s + one.cpu_s, warnings, one.made_with or whole.made_with)
    return whole


@lru_cache(maxsize=4)
def _parse_config(study: Study, text: str) -> StudyConfig:
    """The configuration for a study as it is now: one that was edited and imported anew is another one."""
    return study.config.model_validate_json(text)


def _compute_case_rows(study: Study, config: StudyConfig, case: int, kinds: dict[str, str]) -> list[dict[str, Any]]:
    """The rows of one case; kinds remembers what each column holds."""
    drawn = {DISPERSED + path: value for path, value in draw_case_values(config, case).items()}
    made = study.case(config, case, Streams(config.entropy, case))
    rows = [made] if isinstance(made, Mapping) else list(made)
    if not rows:
        raise ValueError("the study returned no row for this case")
    return [{"case": case, "error": "", **drawn, **_convert_row(row, drawn, kinds)} for row in rows]


def _convert_row(row: Mapping[str, Any], drawn: Mapping[str, float], kinds: dict[str, str]) -> dict[str, Any]:
    plain = {}
    for name, value in row.items():
        if not isinstance(name, str) or name in RESERVED or name in drawn:
            raise TypeError(f"a study's row cannot have a column {name!r}")
        item = value.item() if isinstance(value, np.generic) else value
        kind = KINDS.get(type(item))
        if kind is None or (kind == "number" and isinstance(item, int) and item not in INT64):
            raise TypeError(f"column {name}: a number, truth value, text or None is expected, not {value!r:.60}")
        if kind != "nothing" and kinds.setdefault(name, kind) != kind:
            raise TypeError(f"column {name}: {kind} in this case, {kinds[name]} in another")
        plain[name] = item
    return plain
