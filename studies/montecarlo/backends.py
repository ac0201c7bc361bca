"""Backends: where the chunks of a study run.

Each is an `Executor`. It has a bounded window of tasks in flight, so that neither tasks nor results pile up however many there
are, and yields every task with its result as they end. A task whose worker died is yielded with None; such a task and those
that shared its fate can be tried again alone.

- ``serial``: in this thread.
- ``threads``: in threads of this process; for studies that spend their time outside the interpreter lock.
- ``loky``: in worker processes of this machine, kept warm for the next study.
- ``dask``: on a cluster, by its scheduler's address, or else on a cluster of processes started here. Its workers must be able
  to import the study. Nothing else is asked of them, no common file system either.
"""

import asyncio
import contextlib
import logging
import os
import queue
import signal
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from functools import partial
from itertools import islice
from multiprocessing import resource_tracker
from typing import Any, Literal, TypeVar

import joblib
from joblib.externals.loky import get_reusable_executor
from joblib.externals.loky.process_executor import BrokenProcessPool, ShutdownExecutorError

from gyrocal.errors import GyrocalError, InputError
from studies.montecarlo.cases import Result, Task

Name = Literal["serial", "threads", "loky", "dask"]
T = TypeVar("T")

IDLE_S = 60.0  # after which a warm worker ends
FOLLOW_S = 0.5  # how often a worker looks whether its parent is alive
CONNECT_S = 4.0  # to a scheduler
WORKERS_S = 30.0  # for its first worker
RETRIES = 2  # of a dask task that a connection or a lost worker's result failed
# What ends the study, and is left to the parent where a terminal or a batch system sends it to every process.
ENDING = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
IGNORE_INTERRUPTS = """import signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
signal.signal(signal.SIGHUP, signal.SIG_IGN)
"""  # run in dask's workers as they start, which their nanny may end by SIGTERM
PER_WORKER = 2  # tasks in flight per worker: one that runs, one that waits


class Executor:
    """Where tasks run; a backend says how one is handed out, what became of it, and how to let go of the workers.

    Attributes
    ----------
    run : what to do with a task; importable in a worker
    jobs : tasks that run at a time
    """

    def __init__(self, run: Any, jobs: int, scheduler: str | None = None) -> None:
        self.run, self.jobs = run, jobs

    def submit(self, task: Task) -> Any:
        """Hand a task out; returns its future."""
        raise NotImplementedError

    def wait(self, futures: Collection[Any]) -> Iterable[Any]:
        """Those of the futures that have ended, at least one."""
        return wait(futures, return_when=FIRST_COMPLETED).done

    def result(self, future: Any) -> Result | None:
        """Result of a future that has ended; None if its worker died."""
        result: Result = future.result()
        return result

    def window(self) -> int:
        """Most tasks that are handed out at a time."""
        return PER_WORKER * self.jobs

    def close(self, finished: bool) -> None:
        """Let go of the workers; if not finished, stop what they are doing."""

    def results(self, tasks: Iterable[Task], alone: bool = False) -> Iterator[tuple[Task, Result | None]]:
        """Run tasks, each alone if asked for; yields each as it ends, with its result, or None if its worker died."""
        for task, future in windowed(tasks, (lambda: 1) if alone else self.window, self.submit, self.wait):
            yield task, self.result(future)


def open_backend(name: Name, run: Any, jobs: int | None = None, scheduler: str | None = None) -> Executor:
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
    if name not in BACKENDS:
        raise InputError(f"{name}: there is no such backend; there are serial, threads, loky and dask")
    return BACKENDS[name](run, jobs or joblib.cpu_count(), scheduler)


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


class _Serial(Executor):
    def __init__(self, run: Any, jobs: int, scheduler: str | None = None) -> None:
        super().__init__(run, 1)

    def submit(self, task: Task) -> Future[Result]:
        future: Future[Result] = Future()
        future.set_result(self.run(task))
        return future

    def window(self) -> int:
        return 1


class _Threads(Executor):
    def __init__(self, run: Any, jobs: int, scheduler: str | None = None) -> None:
        self.stopped = threading.Event()
        super().__init__(partial(run, stopped=self.stopped.is_set), jobs)
        self.pool = ThreadPoolExecutor(jobs)

    def submit(self, task: Task) -> Future[Result]:
        return self.pool.submit(self.run, task)

    def close(self, finished: bool) -> None:
        # A thread cannot be stopped from outside; it gives up before its next case.
        self.stopped.set()
        self.pool.shutdown(cancel_futures=True)


def _start_worker() -> None:
    """Leave Ctrl-C, which the terminal sends to every process, and its kin to the parent, and end when that was killed."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_follow, args=(os.getppid(),), daemon=True).start()


def _follow(parent: int) -> None:
    never = threading.Event()
    while os.getppid() == parent:
        never.wait(FOLLOW_S)
    os._exit(1)


@contextlib.contextmanager
def _held_back() -> Iterator[None]:
    """What would end the study waits, also for the processes that are started meanwhile."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Loky(Executor):
    def __init__(self, run: Any, jobs: int, scheduler: str | None = None) -> None:
        super().__init__(run, jobs)
        # Started together with the first worker, this helper would (in Python 3.11) let Ctrl-C through to it.
        with _held_back():
            resource_tracker.ensure_running()

    def _pool(self) -> Any:
        return get_reusable_executor(max_workers=self.jobs, timeout=IDLE_S, initializer=_start_worker)

    def submit(self, task: Task) -> Future[Result]:
        # Workers that are started here inherit that Ctrl-C is held back, and are safe from it before `_start_worker`.
        with _held_back():
            # The pool may be found broken only now; asked for again it is a new one.
            for _ in range(self.jobs):
                with contextlib.suppress(BrokenProcessPool, ShutdownExecutorError):
                    return self._pool().submit(self.run, task)
            return self._pool().submit(self.run, task)

    def result(self, future: Future[Result]) -> Result | None:
        try:
            return future.result()
        except (BrokenProcessPool, ShutdownExecutorError):
            return None

    def close(self, finished: bool) -> None:
        if not finished:
            pool = self._pool()
            # Told to kill its workers, the pool forgets its tasks, but not their numbers, and then looks up the next number in
            # vain: an error in its thread, in joblib 1.6. Without numbers that wait there is nothing to look up.
            with contextlib.suppress(AttributeError, queue.Empty):
                while True:
                    pool._work_ids.get_nowait()
            pool.shutdown(wait=True, kill_workers=True)


def _knock(distributed: Any, address: str) -> None:
    """Shake hands with a scheduler; a client that meets none would log, and wait once more when it is thrown away.

    Raises
    ------
    InputError
        Nobody answers, or somebody who is no scheduler, or the address is none.
    """

    async def shake() -> None:
        comm = await distributed.comm.connect(address, timeout=CONNECT_S)
        await comm.close()

    def run() -> str:
        try:
            asyncio.run(asyncio.wait_for(shake(), CONNECT_S))
        except Exception as error:  # a port of something else answers anything
            return " ".join(str(error).split()) or type(error).__name__
        return ""

    # In a thread of its own: where there is an event loop, as in a notebook, no second one may run.
    with ThreadPoolExecutor(1) as thread:
        fault = thread.submit(run).result()
    if fault:
        raise InputError(f"dask scheduler {address!r}: {fault}; give it as tcp://HOST:PORT, and see that it runs")


class _Dask(Executor):
    def __init__(self, run: Any, jobs: int, scheduler: str | None = None) -> None:
        super().__init__(run, jobs)
        try:
            import dask
            import distributed
        except ImportError:
            raise InputError('--backend dask needs the extra: pip install "gyrocal[dask]"') from None
        self.distributed = distributed
        if scheduler is not None:
            _knock(distributed, scheduler)
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
            self.client.wait_for_workers(1, timeout=WORKERS_S)
        except (OSError, TimeoutError, ValueError) as error:
            self.resources.close()
            raise InputError(f"dask scheduler {scheduler!r}: {' '.join(str(error).split())}") from None
        except BaseException:
            self.resources.close()
            raise
        self.window()

    def window(self) -> int:
        # Workers of a cluster come and go.
        self.jobs = max(1, sum(self.client.nthreads().values()))
        return super().window()

    def submit(self, task: Task) -> Any:
        # Not pure: a cluster may still know the result that an earlier version of the study gave.
        return self.client.submit(self.run, task, pure=False, retries=RETRIES)

    def wait(self, futures: Collection[Any]) -> Iterable[Any]:
        with self.client.as_current():
            done: Iterable[Any] = self.distributed.wait(futures, return_when="FIRST_COMPLETED").done
        return done

    def result(self, future: Any) -> Result | None:
        try:
            result: Result = future.result()
            return result
        except self.distributed.scheduler.KilledWorker:
            return None
        except (self.distributed.comm.core.CommClosedError, self.distributed.client.FutureCancelledError) as error:
            raise GyrocalError(f"the dask scheduler is gone ({error}); run the same command to resume") from None
        finally:
            future.release()

    def close(self, finished: bool) -> None:
        self.resources.close()


BACKENDS: dict[str, type[Executor]] = {"serial": _Serial, "threads": _Threads, "loky": _Loky, "dask": _Dask}


def call_all(calls: Sequence[Callable[[], T]], jobs: int, done: Callable[[int], None] = lambda count: None) -> list[T]:
    """Make independent calls, in worker processes if there are several; their results, in the order of the calls.

    Parameters
    ----------
    calls : partials of functions that a worker can import, the longest first
    jobs : worker processes
    done : told of each call that has ended
    """
    workers = open_backend("loky" if jobs > 1 else "serial", _call, jobs)
    found: dict[int, Any] = {}
    try:
        numbered: Any = enumerate(calls)  # in place of the tasks of a study
        ended: Iterator[Any] = workers.results(numbered)
        for (place, _), result in ended:
            found[place] = result
            done(1)
    finally:
        workers.close(len(found) == len(calls))
    if any(result is None for result in found.values()):
        raise GyrocalError("a worker process was killed; run the same command again, with fewer --jobs if memory was short")
    return [found[place] for place in range(len(calls))]


def _call(task: tuple[int, Callable[[], T]]) -> T:
    return task[1]()
