"""Backends: where the chunks of a study run.

Each hands tasks out with a bounded window in flight, so that neither tasks nor results pile up however many there are, and
yields every task with its result as they end. A task whose worker died is yielded with None; such a task and those that
shared its fate can be tried again alone.

- ``serial``: in this thread.
- ``threads``: in threads of this process; for studies that spend their time outside the interpreter lock.
- ``loky``: in worker processes of this machine, kept warm for the next study.
- ``dask``: on a cluster, by its scheduler's address, or else on a cluster of processes started here. Its workers must be able
  to import the study. Nothing else is asked of them, no common file system either.
"""

import contextlib
import logging
import os
import signal
import threading
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from functools import partial
from itertools import islice
from multiprocessing import resource_tracker
from typing import Any, Literal, Protocol, TypeVar

import joblib
from joblib.externals.loky import get_reusable_executor
from joblib.externals.loky.process_executor import BrokenProcessPool, ProcessPoolExecutor, ShutdownExecutorError

from gyrocal.errors import GyrocalError, InputError
from studies.montecarlo.cases import Result, Task

Name = Literal["serial", "threads", "loky", "dask"]
Run = Callable[[Task], Result]
Done = tuple[Task, Result | None]
T = TypeVar("T")

IDLE_S = 60.0  # after which a warm worker ends
FOLLOW_S = 0.5  # how often a worker looks whether its parent is alive
CONNECT_S = 30.0
RETRIES = 2  # of a dask task that a connection or a lost worker's result failed
IGNORE_INTERRUPTS = "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"  # run in dask's workers as they start
PER_WORKER = 2  # tasks in flight per worker: one that runs, one that waits


class Backend(Protocol):
    """Where tasks run.

    Attributes
    ----------
    jobs : tasks that run at a time
    """

    jobs: int

    def results(self, tasks: Iterable[Task]) -> Iterator[Done]:
        """Run tasks; yields each with its result, or None if its worker died, in the order in which they end."""

    def alone(self, task: Task) -> Result | None:
        """Run one task while its worker does nothing else; None if the worker died of it."""

    def close(self, finished: bool) -> None:
        """Let go of the workers; if not finished, stop what they are doing."""


def open_backend(name: Name, run: Any, jobs: int | None = None, scheduler: str | None = None) -> Backend:
    """Start a backend.

    Parameters
    ----------
    name : of the backend
    run : what to do with a task; importable in a worker
    jobs : workers; by default as many as there are cores
    scheduler : address of a dask scheduler

    Raises
    ------
    InputError
        There is no such backend, dask is not installed, or the scheduler does not answer or has no workers.
    """
    if scheduler is not None and name != "dask":
        raise InputError(f"--scheduler is for --backend dask, not {name}")
    jobs = jobs or joblib.cpu_count()
    if name == "dask":
        return _Dask(run, jobs, scheduler)
    backends: dict[str, Callable[[], Backend]] = {
        "serial": lambda: _Serial(run),
        "threads": lambda: _Threads(run, jobs),
        "loky": lambda: _Loky(run, jobs),
    }
    if name not in backends:
        raise InputError(f"{name}: there is no such backend; there are {', '.join(backends)} and dask")
    return backends[name]()


def windowed(
    tasks: Iterable[T],
    window: Callable[[], int],
    submit: Callable[[T], Any],
    wait_any: Callable[[Collection[Any]], Iterable[Any]],
) -> Iterator[tuple[T, Any]]:
    """Keep up to `window` tasks in flight; yields each with its future when that has ended.

    Parameters
    ----------
    tasks : what to run; taken one by one as there is room
    window : most tasks that are in flight or ended and not yet taken; asked again each time
    submit : starts a task and returns its future
    wait_any : waits for at least one of the futures and returns those that ended
    """
    waiting = iter(tasks)
    flying: dict[Any, T] = {}
    while True:
        for task in islice(waiting, max(0, window() - len(flying))):
            flying[submit(task)] = task
        if not flying:
            return
        for future in wait_any(list(flying)):
            yield flying.pop(future), future


def _wait_any(futures: Collection[Future[Result]]) -> Iterable[Future[Result]]:
    return wait(futures, return_when=FIRST_COMPLETED).done


class _Serial:
    jobs = 1

    def __init__(self, run: Run) -> None:
        self.alone = run

    def results(self, tasks: Iterable[Task]) -> Iterator[Done]:
        return ((task, self.alone(task)) for task in tasks)

    def close(self, finished: bool) -> None:
        pass


class _Threads:
    def __init__(self, run: Any, jobs: int) -> None:
        self.jobs = jobs
        self.stopped = threading.Event()
        self.alone = partial(run, stopped=self.stopped.is_set)
        self.pool = ThreadPoolExecutor(jobs)

    def results(self, tasks: Iterable[Task]) -> Iterator[Done]:
        for task, future in windowed(tasks, lambda: PER_WORKER * self.jobs, partial(self.pool.submit, self.alone), _wait_any):
            yield task, future.result()

    def close(self, finished: bool) -> None:
        # A thread cannot be stopped from outside; it gives up before its next case.
        self.stopped.set()
        self.pool.shutdown(cancel_futures=True)


def _start_worker() -> None:
    """Leave Ctrl-C, which the terminal sends to every process, to the parent, and end when that was killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_follow, args=(os.getppid(),), daemon=True).start()


def _submitted(pool: Any, run: Run, task: Task) -> Future[Result]:
    """Hand out a task; workers it starts inherit that Ctrl-C is held back, and are safe from it before `_start_worker`."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        future: Future[Result] = pool.submit(run, task)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return future


def _follow(parent: int) -> None:
    never = threading.Event()
    while os.getppid() == parent:
        never.wait(FOLLOW_S)
    os._exit(1)


class _Loky:
    def __init__(self, run: Run, jobs: int) -> None:
        self.jobs = jobs
        self.run = run
        self.single: Any = None
        # Started together with the first worker, this helper would (in Python 3.11) let Ctrl-C through to it.
        resource_tracker.ensure_running()

    def _pool(self) -> Any:
        return get_reusable_executor(max_workers=self.jobs, timeout=IDLE_S, initializer=_start_worker)

    def results(self, tasks: Iterable[Task]) -> Iterator[Done]:
        for task, future in windowed(tasks, lambda: PER_WORKER * self.jobs, self._submit, _wait_any):
            try:
                yield task, future.result()
            except (BrokenProcessPool, ShutdownExecutorError):
                yield task, None

    def _submit(self, task: Task) -> Future[Result]:
        # The pool may be found broken only now; asked for again it is a new one.
        for _ in range(self.jobs):
            with contextlib.suppress(BrokenProcessPool, ShutdownExecutorError):
                return _submitted(self._pool(), self.run, task)
        return _submitted(self._pool(), self.run, task)

    def alone(self, task: Task) -> Result | None:
        if self.single is None:
            self.single = ProcessPoolExecutor(max_workers=1, timeout=IDLE_S, initializer=_start_worker)
        try:
            return _submitted(self.single, self.run, task).result()
        except BrokenProcessPool:
            self.single.shutdown(kill_workers=True)
            self.single = None
            return None

    def close(self, finished: bool) -> None:
        if self.single is not None:
            self.single.shutdown(kill_workers=True)
        if not finished:
            self._pool().shutdown(wait=True, kill_workers=True)


class _Dask:
    def __init__(self, run: Run, jobs: int, scheduler: str | None) -> None:
        try:
            import dask
            import distributed
        except ImportError:
            raise InputError('--backend dask needs the extra: pip install "gyrocal[dask]"') from None
        self.run = run
        self.distributed = distributed
        self.resources = contextlib.ExitStack()
        try:
            if scheduler is None:
                # The first death of a worker must name the task: the second try is ours, one case at a time.
                self.resources.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": 0}))
                scheduler = self.resources.enter_context(
                    distributed.LocalCluster(
                        n_workers=jobs,
                        threads_per_worker=1,
                        processes=True,
                        dashboard_address="127.0.0.1:0",
                        silence_logs=logging.CRITICAL,
                        preload=[IGNORE_INTERRUPTS],
                    )
                )
            self.client = self.resources.enter_context(distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False))
            self.client.wait_for_workers(1, timeout=CONNECT_S)
        except (OSError, TimeoutError, ValueError) as error:
            self.resources.close()
            raise InputError(f"dask scheduler {scheduler}: {' '.join(str(error).split())}") from None
        except BaseException:
            self.resources.close()
            raise
        self.jobs = jobs
        self._window()

    def _window(self) -> int:
        # Workers of a cluster come and go.
        self.jobs = max(1, sum(self.client.nthreads().values()))
        return PER_WORKER * self.jobs

    def _submit(self, task: Task) -> Any:
        # Not pure: a cluster may still know the result that an earlier version of the study gave.
        return self.client.submit(self.run, task, pure=False, retries=RETRIES)

    def _wait_any(self, futures: Collection[Any]) -> Iterable[Any]:
        with self.client.as_current():
            return self.distributed.wait(futures, return_when="FIRST_COMPLETED").done

    def _result(self, future: Any) -> Result | None:
        try:
            return future.result()
        except self.distributed.scheduler.KilledWorker:
            return None
        except (self.distributed.comm.core.CommClosedError, self.distributed.client.FutureCancelledError) as error:
            raise GyrocalError(f"the dask scheduler is gone ({error}); run the same command to resume") from None
        finally:
            future.release()

    def results(self, tasks: Iterable[Task]) -> Iterator[Done]:
        for task, future in windowed(tasks, self._window, self._submit, self._wait_any):
            yield task, self._result(future)

    def alone(self, task: Task) -> Result | None:
        return self._result(self._submit(task))

    def close(self, finished: bool) -> None:
        self.resources.close()
