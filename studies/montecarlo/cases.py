"""Running cases: a worker receives a `Task` and returns a `Result`, both of plain text and numbers.

A case that raises is a row with its error, and a traceback in the result. A worker's warnings, which nobody would see, are
counted.

With a time limit a case runs in a child process of its worker, which ends itself at the limit whatever the case does. The timer
is a thread in C (`faulthandler`). It also ends compiled code that never returns to the interpreter, and writes a traceback. The
child is kept for the next cases and ends with its worker.
"""

import faulthandler
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from studies.montecarlo.manifest import describe_provenance
from studies.montecarlo.study import DISPERSED, RESERVED, Streams, Study, StudyConfig, draw_case_values, find

LONGEST_ERROR = 500  # characters of an error in a row
GRACE_S = 10.0  # beyond the limit of a case, after which the worker itself ends a child that did not
INT64 = range(-(2**63), 2**63)
KINDS: dict[type, str] = {type(None): "nothing", bool: "truth value", int: "number", float: "number", str: "text"}
# A worker of a cluster may have several threads, while the settings below are those of the process.
ONE_AT_A_TIME = threading.Lock()


@dataclass(frozen=True)
class Task:
    """Cases to run: name of the study, its resolved configuration as JSON, case numbers, folder of a study that is a file.

    `limit_s` is the longest time of a case, 0 without a limit.
    """

    study: str
    config: str
    cases: range
    folder: str = ""
    limit_s: float = 0.0


@dataclass(frozen=True)
class Result:
    """Result of a task: its rows, tracebacks of failed cases, CPU time, warnings, and the worker's sources and machine."""

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
    """Run with one BLAS thread and with warnings counted, the same in every process; yields the counts.

    With more threads BLAS may split a sum differently, and bits differ. A warning that a filter of the process turns into an
    error would make a case fail in this process alone.
    """
    messages: Counter[str] = Counter()

    def count(message: Warning | str, category: type[Warning], *position: Any, **further: Any) -> None:
        messages[f"{category.__name__}: {' '.join(str(message).split())}"] += 1

    with warnings.catch_warnings(), threadpool_limits(1):
        warnings.simplefilter("always")
        warnings.showwarning = count
        yield messages


def run_cases(task: Task, kinds: dict[str, str] | None = None) -> Result:
    """Run the cases of a task in order; `kinds`, the type of each column, holds those of earlier cases and is updated."""
    study = find(task.study, task.folder)
    config = _parse_config(study, task.config)
    kinds = {} if kinds is None else kinds
    rows: list[dict[str, Any]] = []
    tracebacks: dict[int, str] = {}
    with ONE_AT_A_TIME, run_single_threaded() as messages:
        if task.limit_s:
            singles = (replace(task, cases=range(case, case + 1)) for case in task.cases)
            return merge_results(_run_limited(single, kinds) for single in singles)
        made_with = describe_provenance(study)  # before the cases, soon after the sources were imported
        start = time.process_time()
        for case in task.cases:
            try:
                rows += _compute_case_rows(study, config, case, kinds)
            except (Exception, SystemExit) as error:
                tracebacks[case] = "".join(traceback.format_exception(error))
                text = f"{type(error).__name__}: {' '.join(str(error).split())}"
                rows.append({"case": case, "error": text[:LONGEST_ERROR]})
        return Result(rows, tracebacks, time.process_time() - start, messages, made_with)


def build_ended_result(task: Task, trace: str = "") -> Result:
    """Build the result of a case ended at its limit, with its traceback; without one it has killed its worker."""
    (case,) = task.cases
    error = f"TimeLimit: took longer than {task.limit_s:g} s" if trace else "WorkerDied: killed its worker"
    death = "The process that ran this case alone ended without an answer: a signal, os._exit, or no memory left.\n"
    return Result([{"case": case, "error": error}], {case: f"{error}\n\n{trace or death}"})


def merge_results(results: Iterable[Result]) -> Result:
    """Merge several results into one."""
    merged = Result([], {})
    for result in results:
        tracebacks, warnings = merged.tracebacks | result.tracebacks, merged.warnings + result.warnings
        merged = Result(
            merged.rows + result.rows, tracebacks, merged.cpu_s + result.cpu_s, warnings, result.made_with or merged.made_with
        )
    return merged


@lru_cache(maxsize=4)
def _parse_config(study: Study, text: str) -> StudyConfig:
    """Parse the configuration for a study; the cache distinguishes a study that was edited and imported again."""
    return study.config.model_validate_json(text)


def _compute_case_rows(study: Study, config: StudyConfig, case: int, kinds: dict[str, str]) -> list[dict[str, Any]]:
    """Compute the rows of one case; kinds holds the type of each column."""
    dispersed_values = {DISPERSED + path: value for path, value in draw_case_values(config, case).items()}
    returned = study.case(config, case, Streams(config.entropy, case))
    rows = [returned] if isinstance(returned, Mapping) else list(returned)
    if not rows:
        raise ValueError("the study returned no row for this case")
    return [{"case": case, "error": "", **dispersed_values, **_convert_row(row, dispersed_values, kinds)} for row in rows]


def _convert_row(row: Mapping[str, Any], dispersed_values: Mapping[str, float], kinds: dict[str, str]) -> dict[str, Any]:
    """Convert a study's row to plain values; `TypeError` for a reserved column or another type than in earlier rows."""
    plain = {}
    for name, value in row.items():
        if not isinstance(name, str) or name in RESERVED or name in dispersed_values:
            raise TypeError(f"a study's row cannot have a column {name!r}")
        item = value.item() if isinstance(value, np.generic) else value
        kind = KINDS.get(type(item))
        if kind is None or (kind == "number" and isinstance(item, int) and item not in INT64):
            raise TypeError(f"column {name}: a number, truth value, text or None is expected, not {value!r:.60}")
        if kind != "nothing" and kinds.setdefault(name, kind) != kind:
            raise TypeError(f"column {name}: {kind} in this case, {kinds[name]} in another")
        plain[name] = item
    return plain


class _Child:
    """A process that runs single cases for this one."""

    def __init__(self) -> None:
        """Start the process with one end of a pipe, and a file for its traceback."""
        self.pipe, theirs = Pipe()
        self.trace = tempfile.TemporaryFile("w+")  # noqa: SIM115  # open as long as the child
        files = (theirs.fileno(), self.trace.fileno())
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-c", f"from studies.montecarlo.cases import serve; serve({files[0]}, {files[1]})"],
            pass_fds=files,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(folder or os.getcwd() for folder in sys.path)},
            stdin=subprocess.DEVNULL,
        )
        theirs.close()

    def run(self, task: Task, kinds: dict[str, str]) -> Result:
        """Run the case of a task; `EOFError` if the child ends before it, or does not end it in time."""
        self.pipe.send((task, kinds))
        self.pipe.recv()  # the study is imported
        if not self.pipe.poll(task.limit_s + GRACE_S):
            self.trace.write(f"No answer {GRACE_S:g} s after the limit.\n")
            raise EOFError
        result, kinds_of_child = self.pipe.recv()
        kinds |= kinds_of_child
        return result

    def end(self) -> str:
        """End the process; returns its traceback at the limit, empty if it did not reach it."""
        self.process.kill()
        self.process.wait()
        self.pipe.close()
        with self.trace as file:
            file.seek(0)
            return file.read()


_children: list[_Child] = []  # of this process, one at most


def _run_limited(task: Task, kinds: dict[str, str]) -> Result:
    """Run a single case in a child process: one that takes longer than the limit, or kills the child, failed."""
    if not _children:
        _children.append(_Child())
    try:
        return _children[0].run(task, kinds)
    except (EOFError, ConnectionError):
        return build_ended_result(task, end_child())
    except BaseException:
        end_child()
        raise


def end_child() -> str:
    """End the child of this process, if there is one; returns its traceback at the limit."""
    return _children.pop().end() if _children else ""


def serve(pipe: int, trace: int) -> None:
    """Run each case that comes through the pipe, as a child process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(EOFError, ConnectionError), Connection(pipe) as worker:
        while True:
            task, kinds = worker.recv()
            describe_provenance(find(task.study, task.folder))  # before the case's time starts
            worker.send(None)
            faulthandler.dump_traceback_later(task.limit_s, exit=True, file=trace)
            result = run_cases(replace(task, limit_s=0.0), kinds)
            faulthandler.cancel_dump_traceback_later()
            worker.send((result, kinds))
