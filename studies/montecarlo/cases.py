"""Running cases: what a worker does with a range of case numbers.

A worker is handed a `Task`, all of it plain text and numbers, and hands back a `Result`: the rows, and a record of what
happened, since a worker's log and warnings would be seen by nobody. A case that raises is a row with its error, and a traceback
in the record.

While cases run, their process is calm (`studies.montecarlo.calm`): one BLAS thread, and warnings counted.
"""

import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from studies.montecarlo.calm import calm
from studies.montecarlo.provenance import made_with
from studies.montecarlo.study import DISPERSED, RESERVED, Streams, Study, StudyConfig, dispersed_values, find

LONGEST_ERROR = 500  # characters of an error in a row
KILLED = "WorkerDied: killed its worker"
INT64 = range(-(2**63), 2**63)


@dataclass(frozen=True)
class Task:
    """Cases to run.

    Attributes
    ----------
    study : name of the study
    config : its resolved configuration as JSON
    cases : numbers of the cases
    folder : where the study's module is, if it is a single file; else empty
    """

    study: str
    config: str
    cases: range
    folder: str = ""


@dataclass(frozen=True)
class Result:
    """What became of a task.

    Attributes
    ----------
    rows : of its cases; a failed case is one with its error
    tracebacks : text for each failed case's file
    cpu_s : CPU time of the cases
    warnings : how often each warning was given
    made_with : the worker's `made_with`; None if it died
    """

    rows: list[dict[str, Any]]
    tracebacks: dict[int, str]
    cpu_s: float = 0.0
    warnings: Counter[str] = field(default_factory=Counter)
    made_with: dict[str, Any] | None = None

    @property
    def failures(self) -> dict[int, str]:
        """Error of each failed case."""
        return {row["case"]: row["error"] for row in self.rows if row["error"]}


class Stopped(Exception):  # noqa: N818  # an event, not a fault
    """The study is being stopped; what the task has done is dropped."""


def run_cases(task: Task, stopped: Callable[[], bool] = lambda: False) -> Result:
    """Run the cases of a task, one after the other.

    Parameters
    ----------
    task : what to run
    stopped : asked before each case whether to give up; raises `Stopped` if so
    """
    study = find(task.study, task.folder)
    config = _config(study, task.config)
    rows: list[dict[str, Any]] = []
    kinds: dict[str, str] = {}
    tracebacks: dict[int, str] = {}
    with calm() as messages:
        # In a thread beside others, the process' CPU time is not this task's alone.
        clock = time.process_time if threading.current_thread() is threading.main_thread() else time.thread_time
        start = clock()
        for case in task.cases:
            if stopped():
                raise Stopped
            try:
                rows += _case_rows(study, config, case, kinds)
            except (Exception, SystemExit) as error:
                tracebacks[case] = "".join(traceback.format_exception(error))
                rows.append({"case": case, "error": _one_line(error)})
        return Result(rows, tracebacks, clock() - start, messages, made_with(study))


def killed(task: Task) -> Result:
    """Result of a single case whose worker died of it."""
    (case,) = task.cases
    text = f"{KILLED}\n\nThe process that ran this case alone ended without an answer: a signal, os._exit, or no memory left.\n"
    return Result([{"case": case, "error": KILLED}], {case: text})


def merged(results: Iterable[Result]) -> Result:
    """One result from several."""
    whole = Result([], {})
    for one in results:
        tracebacks, warnings = whole.tracebacks | one.tracebacks, whole.warnings + one.warnings
        whole = Result(whole.rows + one.rows, tracebacks, whole.cpu_s + one.cpu_s, warnings, one.made_with or whole.made_with)
    return whole


@lru_cache(maxsize=4)
def _config(study: Study, text: str) -> StudyConfig:
    """The configuration for a study as it is now: one that was edited and imported anew is another one."""
    return study.config.model_validate_json(text)


def _case_rows(study: Study, config: StudyConfig, case: int, kinds: dict[str, str]) -> list[dict[str, Any]]:
    """The rows of one case; kinds remembers what each column holds."""
    drawn = {DISPERSED + path: value for path, value in dispersed_values(config, case).items()}
    made = study.case(config, case, Streams(config.entropy, case))
    rows = [made] if isinstance(made, Mapping) else list(made)
    if not rows:
        raise ValueError("the study returned no row for this case")
    return [{"case": case, "error": "", **drawn, **_plain(row, drawn, kinds)} for row in rows]


def _plain(row: Mapping[str, Any], drawn: Mapping[str, float], kinds: dict[str, str]) -> dict[str, Any]:
    plain = {}
    for name, value in row.items():
        if not isinstance(name, str) or name in RESERVED or name in drawn:
            raise TypeError(f"a study's row cannot have a column {name!r}")
        item = value.item() if isinstance(value, np.generic) else value
        kind = _kind(item)
        if kind is None or (kind == "number" and isinstance(item, int) and item not in INT64):
            raise TypeError(f"column {name}: a number, truth value, text or None is expected, not {value!r:.60}")
        if kind != "nothing" and kinds.setdefault(name, kind) != kind:
            raise TypeError(f"column {name}: {kind} in this case, {kinds[name]} in another")
        plain[name] = item
    return plain


def _kind(value: object) -> str | None:
    for kind, types in (("nothing", type(None)), ("truth value", bool), ("number", (int, float)), ("text", str)):
        if isinstance(value, types):
            return kind
    return None


def _one_line(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"[:LONGEST_ERROR]
