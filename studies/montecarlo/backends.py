"""Backends: where the tasks of a study run.

Each is an `Executor`. It has a bounded window of tasks in flight, so that neither tasks nor results accumulate, and yields
every task with its result as they end. A task whose worker died is yielded with None; it and the other tasks of that worker can
be tried again alone.

- ``serial``: in this thread.
- ``loky``: in worker processes of this machine, kept warm for the next study.
- ``dask``: on a cluster, by its scheduler's address. Its workers only need to be able to import the study; no common file
  system is needed.
"""

import asyncio
import contextlib
import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ThreadPoolExecutor, wait
from itertools import islice
from multiprocessing import resource_tracker
from typing import Any, Literal, Self

import joblib
from joblib.externals.loky import get_reusable_executor
from joblib.externals.loky.process_executor import BrokenProcessPool, ShutdownExecutorError

from gyrocal.errors import GyrocalError, InputError
from studies.montecarlo.cases import Result, Task, end_child

Name = Literal["serial", "loky", "dask"]
Run = Callable[[Task], Result]

IDLE_S = 60.0  # after which a warm worker ends
FOLLOW_S = 0.5  # between two checks of a worker that its parent is alive
CONNECT_S = 4.0  # to a scheduler
WORKERS_S = 30.0  # for its first worker
RETRIES = 2  # of a dask task that a connection or a lost worker's result failed
COUNT_S = 1.0  # between two counts of the workers of a cluster
PER_WORKER = 2  # tasks in flight per worker: one that runs, one that waits


class SchedulerLostError(GyrocalError):
    """The scheduler of a cluster ended or cannot be reached any more."""


class Executor:
    """Runs tasks, here in this thread; `jobs` run at a time, and `deaths` are errors of a task whose worker died."""

    def __init__(self, run: Run, jobs: int = 1) -> None:
        self.run, self.jobs = run, jobs
        self.deaths: tuple[type[Exception], ...] = ()

    def submit(self, task: Task) -> Future[Result]:
        """Submit a task; returns its future."""
        future: Future[Result] = Future()
        future.set_result(self.run(task))
        return future

    def window(self) -> int:
        """Return the largest number of tasks in flight."""
        return 1

    def close(self, finished: bool) -> None:
        """Release the workers; if not finished, stop them."""
        end_child()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        self.close(finished=kind is None)

    def results(self, tasks: Iterable[Task], alone: bool = False) -> Iterator[tuple[Task, Result | None]]:
        """Run tasks, one at a time if `alone`; yields each as it ends, with its result, or None if its worker died."""
        waiting, in_flight = iter(tasks), dict[Future[Result], Task]()
        while True:
            free = (1 if alone else self.window()) - len(in_flight)
            for task in islice(waiting, max(0, free)):
                in_flight[self.submit(task)] = task
            if not in_flight:
                return
            for future in wait(in_flight, return_when=FIRST_COMPLETED).done:
                try:
                    result = future.result()
                except self.deaths:
                    result = None
                yield in_flight.pop(future), result


def open_backend(name: Name, run: Run, jobs: int | None = None, scheduler: str | None = None) -> Executor:
    """Start a backend, which is a context manager.

    Parameters
    ----------
    name : of the backend
    run : what to do with a task; importable in a worker
    jobs : workers of this machine; by default as many as there are cores
    scheduler : address of a dask scheduler
    """
    if (scheduler is not None) != (name == "dask"):
        raise InputError("--backend dask and --scheduler tcp://HOST:PORT go together; one machine needs neither")
    if name == "serial":
        return Executor(run)
    if name == "loky":
        return _Loky(run, jobs or joblib.cpu_count())
    if name == "dask":
        return _Dask(run, str(scheduler))
    raise InputError(f"{name}: there is no such backend; there are serial, loky and dask")


def _start_worker() -> None:
    """Ignore Ctrl-C, which the terminal sends to every process, and end when the parent was killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_follow, args=(os.getppid(),), daemon=True).start()


def _follow(parent: int) -> None:
    """End this process when its parent has ended."""
    while os.getppid() == parent:
        time.sleep(FOLLOW_S)
    os._exit(1)


@contextlib.contextmanager
def _delay_interrupt() -> Iterator[None]:
    """Delay Ctrl-C, also for the processes that are started meanwhile."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Loky(Executor):
    def __init__(self, run: Run, jobs: int) -> None:
        super().__init__(run, jobs)
        self.deaths = (BrokenProcessPool, ShutdownExecutorError)
        # Started together with the first worker, this helper would (in Python 3.11) let Ctrl-C through to it.
        with _delay_interrupt():
            resource_tracker.ensure_running()

    def _pool(self) -> Any:
        return get_reusable_executor(max_workers=self.jobs, timeout=IDLE_S, initializer=_start_worker)

    def submit(self, task: Task) -> Future[Result]:
        # Workers that are started here inherit that Ctrl-C is held back, and are safe from it before `_start_worker`.
        with _delay_interrupt():
            # The pool may turn out to be broken only now; the next call of _pool returns a new one.
            for _ in range(self.jobs):
                with contextlib.suppress(*self.deaths):
                    return self._pool().submit(self.run, task)
            return self._pool().submit(self.run, task)

    def window(self) -> int:
        return PER_WORKER * self.jobs

    def close(self, finished: bool) -> None:
        if not finished:
            pool = self._pool()
            # In joblib 1.6 a pool that kills its workers clears its tasks, but not their queued numbers, and then fails to look
            # up the next number: an error in its thread. Emptying the queue first avoids this.
            with contextlib.suppress(AttributeError, queue.Empty):
                while True:
                    pool._work_ids.get_nowait()
            pool.shutdown(wait=True, kill_workers=True)


class _Dask(Executor):
    def __init__(self, run: Run, scheduler: str) -> None:
        super().__init__(run)
        try:
            import distributed
        except ImportError:
            raise InputError('--backend dask needs the extra: pip install "gyrocal[dask]"') from None
        self.deaths, self.scheduler = (distributed.scheduler.KilledWorker,), scheduler
        self.quiet = contextlib.ExitStack()
        _check_scheduler(distributed, scheduler)
        # A lost scheduler is reported in one line, here; the client would log a traceback for each of its connections.
        for name in ("distributed", "distributed.client"):
            self.quiet.enter_context(distributed.utils.silence_logging_cmgr("CRITICAL", name))
        try:
            self.client = distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False)
            self.client.wait_for_workers(1, timeout=WORKERS_S)
        except BaseException as error:
            self.close(finished=False)
            if isinstance(error, OSError | TimeoutError | ValueError):
                raise InputError(f"dask scheduler {scheduler!r}: {' '.join(str(error).split())}") from None
            raise
        # Not pure: a cluster may still hold the result of an earlier version of the study.
        self.pool = self.client.get_executor(pure=False, retries=RETRIES)
        self.counted_at = -COUNT_S
        self.window()

    def window(self) -> int:
        # Workers of a cluster come and go. They are not counted for every task, since the answer lists each of them.
        if time.monotonic() - self.counted_at >= COUNT_S:
            try:
                self.jobs = max(1, sum(self.client.nthreads().values()))
            except (OSError, TimeoutError):
                raise self._build_lost_error() from None
            self.counted_at = time.monotonic()
        return PER_WORKER * self.jobs

    def submit(self, task: Task) -> Future[Result]:
        future: Future[Result] = self.pool.submit(self.run, task)
        return future

    def results(self, tasks: Iterable[Task], alone: bool = False) -> Iterator[tuple[Task, Result | None]]:
        try:
            yield from super().results(tasks, alone)
        except Exception as error:
            # A client that loses its scheduler cancels all tasks.
            if isinstance(error, CancelledError) or self.client.status != "running":
                raise self._build_lost_error() from None
            raise

    def _build_lost_error(self) -> SchedulerLostError:
        return SchedulerLostError(f"dask scheduler {self.scheduler!r}: the connection is lost")

    def close(self, finished: bool) -> None:
        with self.quiet:
            if hasattr(self, "client"):
                self.client.close()


def _check_scheduler(distributed: Any, address: str) -> None:
    """Connect to a scheduler once; a client without one would log, and wait once more when it is closed."""

    async def shake() -> None:
        comm = await distributed.comm.connect(address, timeout=CONNECT_S)
        await comm.close()

    # In a separate thread: a thread with an event loop, as in a notebook, cannot run a second one.
    with ThreadPoolExecutor(1) as thread:
        error = thread.submit(lambda: asyncio.run(asyncio.wait_for(shake(), CONNECT_S))).exception()
    if error:  # any type: the port may belong to another program
        fault = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"dask scheduler {address!r}: {fault}; give it as tcp://HOST:PORT, and see that it runs")
