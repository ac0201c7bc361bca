"""Running cases: a worker is handed a `Task` and hands back a `Result`, all of it plain text and numbers.

A case that raises is a row with its error, and a traceback in the result. A worker's warnings, which nobody would see, are
counted.

With a limit of its time a case runs in a child process of its worker, which ends itself at the limit whatever the case does.
The timer is a thread in C (`faulthandler`). It also ends compiled code that never gives the interpreter back, and writes where
the case was. The child is kept for the next cases and ends with its worker.
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


def run_cases(task: Task, kinds: dict[str, str] | None = None) -> Result:
    """Run the cases of a task, one after the other; `kinds`, what each column holds, is that of earlier cases, and grows."""
    study = find(task.study, task.folder)
    config = _parse_config(study, task.config)
    kinds = {} if kinds is None else kinds
    rows: list[dict[str, Any]] = []
    tracebacks: dict[int, str] = {}
    with ONE_AT_A_TIME, run_single_threaded() as messages:
        if task.limit_s:
            singles = (replace(task, cases=range(case, case + 1)) for case in task.cases)
            return merge_results(_run_limited(single, kinds) for single in singles)
        made_with = describe_provenance(study)  # before the cases, while what was imported is young
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
    """Result of a single case that was ended at its limit, and where it was; without a trace it has killed its worker."""
    (case,) = task.cases
    error = f"TimeLimit: took longer than {task.limit_s:g} s" if trace else "WorkerDied: killed its worker"
    died = "The process that ran this case alone ended without an answer: a signal, os._exit, or no memory left.\n"
    return Result([{"case": case, "error": error}], {case: f"{error}\n\n{trace or died}"})


def merge_results(results: Iterable[Result]) -> Result:
    """One result from several."""
    whole = Result([], {})
    for result in results:
        tracebacks, warnings = whole.tracebacks | result.tracebacks, whole.warnings + result.warnings
        whole = Result(
            whole.rows + result.rows, tracebacks, whole.cpu_s + result.cpu_s, warnings, result.made_with or whole.made_with
        )
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


class _Child:
    """A process that runs single cases for this one."""

    def __init__(self) -> None:
        self.pipe, theirs = Pipe()
        self.trace = tempfile.TemporaryFile("w+")  # noqa: SIM115  # open as long as the child
        files = (theirs.fileno(), self.trace.fileno())
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-c", f"from studies.montecarlo.cases import serve; serve{files}"],
            pass_fds=files,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(place or os.getcwd() for place in sys.path)},
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
        result, found = self.pipe.recv()
        kinds |= found
        return result

    def end(self) -> str:
        """End the process; returns where it was at the limit, empty if it did not reach it."""
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
    """End the child of this process, if there is one; returns where it was at the limit."""
    return _children.pop().end() if _children else ""


def serve(pipe: int, trace: int) -> None:
    """Be a child: run each case that comes through the pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(EOFError, ConnectionError), Connection(pipe) as worker:
        while True:
            task, kinds = worker.recv()
            describe_provenance(find(task.study, task.folder))  # is no part of the case's time
            worker.send(None)
            faulthandler.dump_traceback_later(task.limit_s, exit=True, file=trace)
            result = run_cases(replace(task, limit_s=0.0), kinds)
            faulthandler.cancel_dump_traceback_later()
            worker.send((result, kinds))
