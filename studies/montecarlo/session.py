"""One run of a study in its folder: what is missing, storing each chunk as it ends, the manifest, and how the run ends.

The manifest is written when a run starts and when it ends. It lists every run that worked on the study: one that was killed
stays there as "running", and one with other versions of the program can be seen.
"""

import errno
import fcntl
import json
import logging
import os
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from gyrocal.errors import GyrocalError, InputError
from studies.montecarlo.backends import Executor, SchedulerLostError
from studies.montecarlo.cases import Result, Task, build_killed_result, merge_results
from studies.montecarlo.files import write_bytes
from studies.montecarlo.manifest import MANIFEST, collect_versions, write_manifest
from studies.montecarlo.provenance import list_changes
from studies.montecarlo.store import PartInfo, Parts

logger = logging.getLogger(__name__)

SEED_FORMULA = "SeedSequence(entropy, spawn_key=(case, *name.encode()))"


class StudyInterrupted(GyrocalError):  # noqa: N818  # an event, not a fault
    """The study was stopped; the message says how far it is and that the same command resumes it.

    Attributes
    ----------
    exit_status : as shells have it for what a signal ended, 130 for Ctrl-C
    """

    def __init__(self, message: str, number: int = signal.SIGINT) -> None:
        super().__init__(message)
        self.exit_status = 128 + number


class _StopSignal(KeyboardInterrupt):
    """A signal that is to end the run as Ctrl-C does."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


class StorageError(InputError):
    """The folder of a study cannot be written; what was finished before is safe."""


@contextmanager
def open_study_folder(folder: Path) -> Iterator[None]:
    """Make the folder and hold it for this run; the lock goes with the process, however that ends.

    Raises
    ------
    InputError
        Another process holds it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # Neither through a link nor emptying what is there: nothing is written to it.
    with os.fdopen(os.open(folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666), "w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(f"{folder}: another run is at work in this folder; wait for it or choose another folder") from None
        yield


@contextmanager
def handle_stop_signals() -> Iterator[None]:
    """SIGTERM and SIGHUP raise what Ctrl-C does, once; one that is ignored, as under nohup, stays so."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may say what signals do
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    before = {number: handler for number, handler in before.items() if handler not in (signal.SIG_IGN, None)}

    def tell(number: int, frame: object) -> None:
        for one in before:
            signal.signal(one, signal.SIG_IGN)
        raise _StopSignal(number)

    try:
        for number in before:
            signal.signal(number, tell)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def read_study_manifest(folder: Path) -> dict[str, Any] | None:
    """Manifest of the study in a folder, None if there is none.

    Raises
    ------
    InputError
        It is no manifest of a study.
    """
    path = folder / MANIFEST
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        _ = manifest["config_sha256"], range(manifest["chunk"]), range(manifest["cases"])
        _ = [(run["commit"], run["python"]) for run in manifest["runs"]]
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"{path}: is not the manifest of a Monte Carlo study; choose another folder") from None
    return dict(manifest)


class Session:
    """One run of a study.

    Parameters
    ----------
    parts : the parts of the study, in its folder
    task_for : makes a task of a range of cases
    about : what the manifest says of the study: its name, configuration, hash …, as plain values
    earlier : the manifest of earlier runs
    backend : where the cases run
    made_with : source code and machine of this run
    mix : whether its rows may stand beside rows made with others

    Attributes
    ----------
    run : this run's entry in the manifest
    done : cases that have ended and are stored
    failures : error of each failed case
    cpu_s : CPU time of the stored cases
    warnings : how often each warning was given in this run
    """

    def __init__(
        self,
        parts: Parts,
        task_for: Callable[[range], Task],
        about: Mapping[str, Any],
        earlier: Mapping[str, Any] | None,
        backend: str,
        made_with: dict[str, Any],
        mix: bool = False,
    ) -> None:
        self.parts, self.task_for, self.before, self.made_with, self.mix = parts, task_for, earlier or {}, made_with, mix
        self.begun = time.monotonic()
        installed = collect_versions(["distributed"] if backend == "dask" else [])
        self.about = {**about, **installed, **made_with}
        status = {"status": "running", "backend": backend, "jobs": None, "resumed": 0, "wall_s": 0.0}
        self.run = {**status, **installed, "machine": made_with["machine"]}
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
        """The cases that are still to be computed, part by part; damaged parts are set aside."""
        self.parts.remove_temporary()
        missing = []
        for index in range(len(self.parts)):
            info, cases = self.parts.inspect(index), self.parts.list_cases(index)
            if isinstance(info, str):
                aside = self.parts.set_aside(index)
                self.count({f"{self.parts.path(index)} is damaged ({info}); set aside as {aside.name} and computed again": 1})
            if not isinstance(info, PartInfo) or (retry_failed and info.failures):
                missing.append(cases)
            else:
                self._add(cases, info.failures, info.cpu_s)
        self.run["resumed"] = self.done
        self._compare(bool(missing))
        return missing

    def _compare(self, more: bool) -> None:
        """Refuse finished rows, and more of them, that this program, here, would make otherwise.

        Raises
        ------
        InputError
            The source code has changed, or rows are to be computed and the machine is another one.
        """
        if not self.done or not self.before:
            return
        before = {name: self.before.get(name) for name in self.made_with}
        if not more:  # this run makes no rows: what made them stays in the manifest
            self.about |= before
        edited = before["source_sha256"] != self.made_with["source_sha256"]
        elsewhere = list_changes(before["machine"] or {}, self.made_with["machine"]) if more else ""
        finished = f"{self.parts.folder}: {self.done} finished cases were computed"
        if not edited and not elsewhere:
            return
        if self.mix:
            self.count({f"{finished} with other source code or on another machine, and are kept as they are": 1})
        elif edited:
            raise InputError(f"{finished} before the source code changed; choose another folder, or keep them with --mix")
        else:
            raise InputError(f"{finished} elsewhere ({elsewhere}); choose another folder, or go on with --mix")

    def finish(self, workers: Executor, missing: list[range], advance: Callable[[int], None]) -> None:
        """Run the missing cases; a chunk whose worker died is run again, each case alone."""
        died = []
        for task, result in workers.results(map(self.task_for, missing)):
            if result is None:
                died.append(task)
            else:
                self._store(task.cases, result)
                advance(len(task.cases))
        for task in died:
            singles = [self.task_for(range(case, case + 1)) for case in task.cases]
            alone = (result or build_killed_result(single) for single, result in workers.results(singles, alone=True))
            self._store(task.cases, merge_results(alone))
            advance(len(task.cases))

    def end_at(self, cases: int) -> None:
        """The study has enough with so many cases: what it is, and its parts, are from now on of these."""
        self.parts = replace(self.parts, cases=cases)
        self.about |= {"cases": cases, "config": self.about["config"] | {"cases": cases}}
        self.done = cases
        self.failures = {case: error for case, error in self.failures.items() if case < cases}

    def _store(self, cases: range, result: Result) -> None:
        """Store a part; its tracebacks first, so that a part that is there is complete."""
        if result.made_with not in (None, self.made_with) and not self.mix:
            differs = list_changes(self.made_with["machine"], result.made_with["machine"]) or "its source code"
            raise InputError(f"a worker differs ({differs}); make them alike, or go on with --mix")
        for case in cases:
            path = self.parts.folder / "failures" / f"case-{case:06d}.txt"
            if case in result.tracebacks:
                write_bytes(path, result.tracebacks[case].encode())
            else:
                path.unlink(missing_ok=True)  # it failed in an earlier run
        self.parts.write(cases.start // self.parts.chunk, result.rows, result.cpu_s)
        self._add(cases, result.failures, result.cpu_s)
        self.count(result.warnings)

    def _add(self, cases: range, failures: Mapping[int, str], cpu_s: float) -> None:
        self.done += len(cases)
        self.failures.update(failures)
        self.cpu_s += cpu_s

    @property
    def wall_s(self) -> float:
        """Elapsed time of the run, s."""
        return time.monotonic() - self.begun

    def write(self, status: str) -> dict[str, Any]:
        """Write the manifest, and return it without the hashes."""
        self.run |= {"status": status, "wall_s": round(self.wall_s, 3)}
        document = self.about | {
            "seeds": {"entropy": self.about["config"]["entropy"], "stream": SEED_FORMULA},
            **{name: self.run[name] for name in ("status", "backend", "jobs", "wall_s")},
            "cpu_s": round(self.cpu_s, 3),
            "done": self.done,
            "failed": len(self.failures),
            "failures": {str(case): self.failures[case] for case in sorted(self.failures)},
            "warnings": dict(self.warnings),
            "runs": [*self.before.get("runs", []), self.run],
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
                number = getattr(error, "number", signal.SIGINT)
                how = "" if number == signal.SIGINT else f" by {signal.Signals(number).name}"
                raise StudyInterrupted(f"interrupted{how}; {safe}; the same command resumes", number) from None
            if isinstance(error, SchedulerLostError):
                raise SchedulerLostError(f"{error}; {safe}; start it again there, and the same command resumes") from None
            if isinstance(error, OSError):
                full = error.errno in (errno.ENOSPC, errno.EDQUOT)
                how = "free some space, and the same command resumes" if full else "the same command resumes"
                where, why = error.filename or self.parts.folder, error.strerror or error
                raise StorageError(f"{where}: {why}; {safe}; {how}") from None
            raise
