"""The limit of a case's time: its worker runs it in a child process, which ends itself at the limit whatever the case does.

The timer is a thread in C (`faulthandler`). It also ends compiled code that never gives the interpreter back, and writes where
the case was. The child is kept for the next cases and ends with its worker.
"""

import faulthandler
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection

from studies.montecarlo.cases import Result, Task, build_failed_result, build_killed_result, run_cases
from studies.montecarlo.manifest import describe_provenance
from studies.montecarlo.study import find

GRACE_S = 10.0  # beyond the limit, after which the worker itself ends a child that did not


class _Child:
    """A process that runs single cases for this one."""

    def __init__(self) -> None:
        self.pipe, theirs = Pipe()
        self.trace = tempfile.TemporaryFile("w+")  # noqa: SIM115  # open as long as the child
        files = (theirs.fileno(), self.trace.fileno())
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-c", f"from studies.montecarlo.time_limit import serve; serve{files}"],
            pass_fds=files,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(place or os.getcwd() for place in sys.path)},
            stdin=subprocess.DEVNULL,
        )
        theirs.close()

    def run(self, task: Task, kinds: dict[str, str], note: Callable[[int], object]) -> Result:
        """Run the case of a task and note its begin; `EOFError` if the child ends before it, or does not end it in time."""
        self.pipe.send((task, kinds))
        self.pipe.recv()  # the study is imported
        note(task.cases.start)
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


def run_limited(task: Task, kinds: dict[str, str], note: Callable[[int], object]) -> Result:
    """Run the single case of a task in a child process: a case that takes longer than the limit, or kills the child, failed.

    Parameters
    ----------
    task, kinds : as of `run_cases`
    note : is told the case as it begins
    """
    if not _children:
        _children.append(_Child())
    try:
        return _children[0].run(task, kinds, note)
    except (EOFError, ConnectionError):
        if not (trace := end_child()):
            return build_killed_result(task)
        return build_failed_result(task, f"TimeLimit: took longer than {task.limit_s:g} s", trace)
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
            result = run_cases(replace(task, limit_s=0.0, watch=""), kinds)
            faulthandler.cancel_dump_traceback_later()
            worker.send((result, kinds))
