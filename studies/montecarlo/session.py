"""One run of a study: which chunks are missing, storing each as it ends, and what is said when the run ends early."""

import errno
import logging
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager

from gyrocal.errors import GyrocalError
from studies.montecarlo.backends import Backend
from studies.montecarlo.cases import Result, Task, killed, merged
from studies.montecarlo.folder import Progress, Record
from studies.montecarlo.store import PartInfo, Parts, StorageError, write_atomic

logger = logging.getLogger(__name__)


class Interrupted(GyrocalError):  # noqa: N818  # an event, not a fault
    """The study was stopped; the message says how far it is and that the same command resumes it."""

    exit_status = 130  # as shells have it for what Ctrl-C ended


class Session:
    """The chunks of one run and what is known of them."""

    def __init__(self, parts: Parts, task_for: Callable[[range], Task]) -> None:
        self.parts = parts
        self.task_for = task_for
        self.progress = Progress()

    def count(self, warnings: Mapping[str, int]) -> None:
        """Add to the run's warnings; each is logged when it is first met."""
        for text, count in warnings.items():
            if text not in self.progress.warnings:
                logger.warning(text)
            self.progress.warnings[text] = self.progress.warnings.get(text, 0) + count

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
        return missing

    def finish(self, workers: Backend, missing: Iterable[int], advance: Callable[[int], None]) -> None:
        """Run the missing parts; a chunk whose worker died is run case by case."""
        index_of = {self.parts.range(index): index for index in missing}
        for task, result in workers.results(map(self.task_for, index_of)):
            index = index_of[task.cases]
            self._store(index, self._one_by_one(workers, task) if result is None else result)
            advance(len(task.cases))

    def _one_by_one(self, workers: Backend, task: Task) -> Result:
        singles = (self.task_for(range(case, case + 1)) for case in task.cases)
        return merged(task, [workers.alone(single) or killed(single) for single in singles])

    def _store(self, index: int, result: Result) -> None:
        """Store a part; its tracebacks first, so that a part that is there is complete."""
        folder = self.parts.folder / "failures"
        for case in self.parts.range(index):
            path = folder / f"case-{case:06d}.txt"
            if case in result.tracebacks:
                write_atomic(path, result.tracebacks[case].encode())
            else:
                path.unlink(missing_ok=True)  # it failed in an earlier run
        write_atomic(self.parts.path(index), result.part)
        self._add(index, result.failures, result.cpu_s)
        self.count(result.warnings)

    def _add(self, index: int, failures: Mapping[int, str], cpu_s: float) -> None:
        self.progress.done += len(self.parts.range(index))
        self.progress.failures.update(failures)
        self.progress.cpu_s += cpu_s


@contextmanager
def ending(record: Record, session: Session, begun: float) -> Iterator[None]:
    """Whatever ends a run early is written down, and said in one line if it is not the program's fault."""
    try:
        yield
    except BaseException as error:
        record.run["wall_s"] = round(time.monotonic() - begun, 3)
        record.write("interrupted", session.progress)
        safe = f"{session.progress.done} of {session.parts.cases} cases are finished and kept in {session.parts.folder}"
        if isinstance(error, KeyboardInterrupt):
            raise Interrupted(f"interrupted; {safe}; the same command resumes") from None
        if isinstance(error, StorageError):
            cause = error.__cause__
            full = isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT)
            how = "free some space, and the same command resumes" if full else "the same command resumes"
            raise StorageError(f"{error}; {safe}; {how}") from None
        raise
