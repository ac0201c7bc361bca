"""One run of a study in its folder: what is missing, storing each chunk as it ends, the manifest, and how the run ends.

The manifest is written when a run starts and when it ends. It lists every run that worked on the study: one that was killed
stays there as "running", and one with other versions of the program can be seen.
"""

import errno
import fcntl
import json
import logging
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from gyrocal.errors import GyrocalError, InputError
from studies.montecarlo.backends import Executor
from studies.montecarlo.cases import Result, Task, killed, merged
from studies.montecarlo.files import write_bytes
from studies.montecarlo.manifest import MANIFEST, versions, write_manifest
from studies.montecarlo.store import PartInfo, Parts

logger = logging.getLogger(__name__)

SEEDS = "SeedSequence(entropy, spawn_key=(case, *name.encode()))"


class Interrupted(GyrocalError):  # noqa: N818  # an event, not a fault
    """The study was stopped; the message says how far it is and that the same command resumes it."""

    exit_status = 130  # as shells have it for what Ctrl-C ended


class StorageError(InputError):
    """The folder of a study cannot be written; what was finished before is safe."""


@contextmanager
def locked(folder: Path) -> Iterator[None]:
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


def known(folder: Path, config_sha256: str) -> dict[str, Any] | None:
    """Manifest of the same study in the folder, None if there is none.

    Raises
    ------
    InputError
        The folder holds another study.
    """
    path = folder / MANIFEST
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        found, _ = manifest["config_sha256"], range(manifest["chunk"])
        _ = [(run["commit"], run["python"]) for run in manifest["runs"]]
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"{path}: is not the manifest of a Monte Carlo study; choose another folder") from None
    if found != config_sha256:
        hashes = f"its hash is {found[:12]}, this one's {config_sha256[:12]}"
        raise InputError(f"{folder}: holds a study with another configuration ({hashes}); choose another folder")
    return dict(manifest)


class Session:
    """One run of a study.

    Parameters
    ----------
    parts : the parts of the study, in its folder
    task_for : makes a task of a range of cases
    about : what the manifest says of the study: its name, configuration, hash …, as plain values
    earlier : the manifest's entries of earlier runs
    backend : where the cases run

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
        earlier: list[dict[str, Any]],
        backend: str,
    ) -> None:
        self.parts, self.task_for, self.earlier = parts, task_for, earlier
        self.begun = time.monotonic()
        made_with = versions(["distributed"] if backend == "dask" else [])
        self.about = {**about, **made_with}
        self.run = {"status": "running", "backend": backend, "jobs": None, "resumed": 0, "wall_s": 0.0, **made_with}
        self.done, self.cpu_s = 0, 0.0
        self.failures: dict[int, str] = {}
        self.warnings: Counter[str] = Counter()
        if any(run[name] != made_with[name] for run in earlier for name in ("commit", "python")):
            mixed = f"{parts.folder}: earlier runs were of another version of the program; rows of both are mixed"
            self.count({mixed: 1})

    def count(self, warnings: Mapping[str, int]) -> None:
        """Add to the run's warnings; each is logged when it is first met."""
        for text in warnings:
            if text not in self.warnings:
                logger.warning(text)
        self.warnings.update(warnings)

    def survey(self, retry_failed: bool) -> list[int]:
        """Numbers of the parts that are still to be made; damaged ones are set aside."""
        self.parts.remove_temporary()
        missing = []
        for index in range(len(self.parts)):
            info = self.parts.inspect(index)
            if isinstance(info, str):
                aside = self.parts.set_aside(index)
                self.count({f"{self.parts.path(index)} is damaged ({info}); set aside as {aside.name} and computed again": 1})
            if not isinstance(info, PartInfo) or (retry_failed and info.failures):
                missing.append(index)
            else:
                self._add(index, info.failures, info.cpu_s)
        self.run["resumed"] = self.done
        return missing

    def finish(self, workers: Executor, missing: list[int], advance: Callable[[int], None]) -> None:
        """Run the missing parts; a chunk whose worker died is run again, each case alone."""
        index_of = {self.parts.range(index): index for index in missing}
        died = []
        for task, result in workers.results(map(self.task_for, index_of)):
            if result is None:
                died.append(task)
            else:
                self._store(index_of[task.cases], result)
                advance(len(task.cases))
        for task in died:
            singles = [self.task_for(range(case, case + 1)) for case in task.cases]
            alone = (result or killed(single) for single, result in workers.results(singles, alone=True))
            self._store(index_of[task.cases], merged(alone))
            advance(len(task.cases))

    def _store(self, index: int, result: Result) -> None:
        """Store a part; its tracebacks first, so that a part that is there is complete."""
        folder = self.parts.folder / "failures"
        for case in self.parts.range(index):
            path = folder / f"case-{case:06d}.txt"
            if case in result.tracebacks:
                write_bytes(path, result.tracebacks[case].encode())
            else:
                path.unlink(missing_ok=True)  # it failed in an earlier run
        self.parts.write(index, result.rows, result.cpu_s)
        self._add(index, result.failures, result.cpu_s)
        self.count(result.warnings)

    def _add(self, index: int, failures: Mapping[int, str], cpu_s: float) -> None:
        self.done += len(self.parts.range(index))
        self.failures.update(failures)
        self.cpu_s += cpu_s

    @property
    def wall_s(self) -> float:
        """How long the run has taken."""
        return time.monotonic() - self.begun

    def write(self, status: str) -> dict[str, Any]:
        """Write the manifest, and return it without the hashes."""
        self.run |= {"status": status, "wall_s": round(self.wall_s, 3)}
        document = self.about | {
            "seeds": {"entropy": self.about["config"]["entropy"], "stream": SEEDS},
            **{name: self.run[name] for name in ("status", "backend", "jobs", "wall_s")},
            "cpu_s": round(self.cpu_s, 3),
            "done": self.done,
            "failed": len(self.failures),
            "failures": {str(case): self.failures[case] for case in sorted(self.failures)},
            "warnings": dict(self.warnings),
            "runs": [*self.earlier, self.run],
        }
        write_manifest(self.parts.folder, document, complete=status == "complete")
        return document

    @contextmanager
    def ending(self) -> Iterator[None]:
        """Whatever ends the run early is written down, and said in one line if it is not the program's fault."""
        try:
            yield
        except BaseException as error:
            with suppress(OSError):  # a full disk must not hide how the run ended
                self.write("interrupted")
            safe = f"{self.done} of {self.parts.cases} cases are finished and kept in {self.parts.folder}"
            if isinstance(error, KeyboardInterrupt):
                raise Interrupted(f"interrupted; {safe}; the same command resumes") from None
            if isinstance(error, OSError):
                full = error.errno in (errno.ENOSPC, errno.EDQUOT)
                how = "free some space, and the same command resumes" if full else "the same command resumes"
                where, why = error.filename or self.parts.folder, error.strerror or error
                raise StorageError(f"{where}: {why}; {safe}; {how}") from None
            raise
