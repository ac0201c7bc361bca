import gc
import importlib.util
import json
import multiprocessing
import re
import socket
import time
from collections import Counter
from contextlib import contextmanager

import numpy as np
import pytest
import threadpoolctl

from gyrocal.errors import InputError
from studies.montecarlo import backends
from studies.montecarlo.cases import Task, run_single_threaded
from studies.montecarlo.engine import run
from studies.montecarlo.study import resolve_config
from tests.engine_studies import DRAWS, DrawsConfig, serve_dask

needs_dask = pytest.mark.skipif(not importlib.util.find_spec("distributed"), reason="dask is an optional extra")


def task(config: DrawsConfig, cases: range) -> Task:
    return Task(DRAWS.name, resolve_config(config).model_dump_json(), cases)


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """Bytes of the table of a serial run, one failed case in it."""
    config = DrawsConfig(cases=30, fail=(3,), label=True)
    return config, run(DRAWS, config, tmp_path_factory.mktemp("serial"), backend="serial").table.read_bytes()


@pytest.fixture(scope="module")
def address():
    """Of the scheduler of a cluster of two processes."""
    distributed = pytest.importorskip("distributed", reason="dask is an optional extra")
    import dask

    # The first death of a worker names the task: the second try is the engine's, one case at a time.
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50
        ) as cluster,
    ):
        yield cluster.scheduler_address


@pytest.fixture(params=["loky", "dask"])
def where(request):
    """Options of a run in processes."""
    if request.param != "dask":
        return {"backend": request.param, "jobs": 2}
    return {"backend": "dask", "scheduler": request.getfixturevalue("address")}


def test_every_backend_gives_the_same_table_bit_for_bit(where, reference, tmp_path):
    config, table = reference
    outcome = run(DRAWS, config, tmp_path, **where)
    assert outcome.table.read_bytes() == table
    assert outcome.failures == {3: "ValueError: case 3 is bad"}


@pytest.mark.long
@needs_dask
def test_a_lost_worker_goes_unnoticed_and_after_a_lost_scheduler_the_same_command_resumes(reference, tmp_path, capfd):
    """Real processes, forked from one that has loaded all, which saves their start."""
    config, table = reference
    config = config.model_copy(update={"pause_s": 0.02})
    processes = multiprocessing.get_context("forkserver")
    processes.set_forkserver_preload(["pytest", "distributed", "tests.engine_studies", "studies.montecarlo.cases"])
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    servers = []

    def start(*kinds):
        for kind in kinds:
            ready = processes.Event()
            servers.append(processes.Process(target=serve_dask, args=(kind, port, ready), daemon=True))
            servers[-1].start()
            assert ready.wait(60)

    def kill(server):
        server.kill()
        server.join()

    @contextmanager
    def disturb(label, total):
        scheduler, victim = servers[:2]
        done = Counter()

        def advance(count):
            done[label] += count
            if done[label] == 4:
                kill(victim)
            if done[label] == 12:
                kill(scheduler)

        yield advance

    options = {"backend": "dask", "scheduler": f"tcp://127.0.0.1:{port}"}
    try:
        start("scheduler", "worker", "worker", "worker")
        with pytest.raises(backends.SchedulerLostError) as caught:
            run(DRAWS, config, tmp_path, progress=disturb, **options)
        told = rf"the connection is lost; (\d+) of 30 cases are finished and kept in {tmp_path}; start it again"
        done = int(re.search(told, str(caught.value))[1])
        assert done >= 12
        assert json.loads((tmp_path / "manifest.json").read_text())["status"] == "interrupted"
        # Not before: a client that is closed while it meets the new scheduler leaves its socket open.
        start("scheduler", "worker")
        outcome = run(DRAWS, config, tmp_path, **options)
        assert outcome.resumed == done
        assert outcome.table.read_bytes() == table
    finally:
        for server in servers:
            kill(server)
    assert capfd.readouterr() == ("", "")  # not a word of dask's


def test_a_case_that_kills_its_worker_is_a_failed_row(where, reference, tmp_path, monkeypatch):
    monkeypatch.setattr("studies.montecarlo.store.PARTS", 5)
    config, _ = reference
    config = config.model_copy(update={"die": (7,)})
    outcome = run(DRAWS, config, tmp_path, **where | {"jobs": 1})  # each death costs the start of a worker
    assert outcome.failures == {3: "ValueError: case 3 is bad", 7: "WorkerDied: killed its worker"}
    assert "ended without an answer" in (tmp_path / "failures" / "case-000007.txt").read_text()
    expected = run(DRAWS, config.model_copy(update={"die": ()}), tmp_path / "serial", backend="serial").load()
    table = outcome.load()
    assert table.loc[7, "error"] == "WorkerDied: killed its worker"
    assert table.loc[7].drop(["case", "error"]).isna().all()
    assert table.drop(7).astype({"label": object}).equals(expected.drop(7).astype({"label": object}))


def test_a_case_that_never_returns_ends_at_its_limit(reference, tmp_path, monkeypatch):
    """Also one in compiled code that holds the interpreter; the other cases of its task go on, and their rows are the same."""
    monkeypatch.setattr("studies.montecarlo.store.PARTS", 5)
    config, _ = reference
    hung = config.model_copy(update={"hang": (7,)})
    outcome = run(DRAWS, hung, tmp_path, backend="loky", jobs=1, limit_s=2.0)
    assert outcome.failures == {3: "ValueError: case 3 is bad", 7: "TimeLimit: took longer than 2 s"}
    assert "draws_case" in (tmp_path / "failures" / "case-000007.txt").read_text()
    expected = run(DRAWS, config, tmp_path / "serial", backend="serial").load()
    assert outcome.load().drop(7).equals(expected.drop(7))


@needs_dask
@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere"])
def test_a_bad_scheduler_address_fails_at_once_in_one_line(address, monkeypatch, tmp_path, caplog):
    assert backends.CONNECT_S < 5
    monkeypatch.setattr(backends, "CONNECT_S", 0.3)
    begun = time.monotonic()
    with pytest.raises(InputError, match=rf"dask scheduler '{address}': .*tcp://HOST:PORT") as caught:
        run(DRAWS, DrawsConfig(), tmp_path, backend="dask", scheduler=address)
    assert "\n" not in str(caught.value)
    assert time.monotonic() - begun < 5
    gc.collect()  # a socket left open, or a client that waits once more, would show here
    assert time.monotonic() - begun < 5
    assert not caplog.messages


def blas_threads() -> set[int]:
    return {library["num_threads"] for library in threadpoolctl.threadpool_info() if library["user_api"] == "blas"}


def test_a_case_has_one_blas_thread():
    with threadpoolctl.threadpool_limits(2):
        with run_single_threaded(), run_single_threaded():
            np.ones((2, 2)) @ np.ones((2, 2))
            assert blas_threads() == {1}
        assert blas_threads() == {2}
