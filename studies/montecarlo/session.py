"""One run of a study in its folder: missing cases, their results, the end of the run, and the manifest."""

import logging
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from gyrocal.errors import GyrocalError, InputError
from studies.montecarlo.backends import Executor, SchedulerLostError
from studies.montecarlo.cases import Result, Task, build_ended_result, merge_results
from studies.montecarlo.criteria import StoppingRule, list_checkpoints
from studies.montecarlo.files import write_bytes
from studies.montecarlo.manifest import list_changes, write_manifest
from studies.montecarlo.store import ANOTHER_FOLDER, PartInfo, Parts

logger = logging.getLogger(__name__)

SEED_FORMULA = "SeedSequence(entropy, spawn_key=(case, *name.encode()))"


class StudyInterrupted(GyrocalError):  # noqa: N818  # an event, not a fault
    """Ctrl-C stopped the study; the message gives its progress and that the same command resumes it."""

    exit_status = 130  # as shells have it


class Session:
    """One run of a study in its folder: its entries in the manifest, finished cases and failed cases."""

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
        """Find the cases that are still to be computed, part by part."""
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

    def _check_provenance(self, has_missing: bool) -> None:
        """Raise `InputError` for finished rows of other source code, and for missing rows on another machine."""
        before = {name: self.before.get(name) for name in self.made_with}
        machine_changes = list_changes(before["machine"] or {}, self.made_with["machine"])
        if before["sources"] != self.made_with["sources"]:
            files = list_changes(before["sources"], self.made_with["sources"], values=False) if before["sources"] else ""
            reason = f"before {files or 'the source code'} changed"
        elif machine_changes and has_missing:
            reason = f"elsewhere ({machine_changes})"
        else:
            self.about |= before  # a run without new rows keeps the provenance of the old ones
            return
        raise InputError(f"{self.parts.folder}: {self.done} finished cases were computed {reason}; {ANOTHER_FOLDER}")

    def finish(self, run_missing: Callable[[list[range]], None], missing: list[range], until: StoppingRule | None) -> None:
        """Run the missing cases, or as many as the criterion needs; the study ends with these."""
        for stop in list_checkpoints(self.cases, self.parts.size) if until else [self.cases]:
            due = [cases for cases in missing if cases.stop <= stop]
            missing = missing[len(due) :]
            if due:
                run_missing(due)
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
            machine = list_changes(self.made_with["machine"], result.made_with["machine"])
            files = list_changes(self.made_with["sources"], result.made_with["sources"], values=False)
            raise InputError(f"a worker differs ({machine or files}); make them alike, or undo what was edited during the run")
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
        """Count finished cases, with their failures and CPU time."""
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
        """Record the early end of a run in the manifest, and report it in one line unless it is the program's fault."""
        try:
            yield
        except BaseException as error:
            with suppress(OSError):  # a full disk must not hide how the run ended
                self.write("interrupted")
            progress = f"{self.done} of {self.parts.cases} cases are finished and kept in {self.parts.folder}"
            if isinstance(error, KeyboardInterrupt):
                raise StudyInterrupted(f"interrupted; {progress}; the same command resumes") from None
            if isinstance(error, SchedulerLostError):
                raise SchedulerLostError(f"{error}; {progress}; start it again there, and the same command resumes") from None
            if isinstance(error, OSError):
                file, why = error.filename or self.parts.folder, error.strerror or error
                raise InputError(f"{file}: {why}; {progress}; the same command resumes") from None
            raise
