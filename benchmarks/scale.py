"""What a large Dask cluster would need: ``python -m benchmarks.scale`` writes results/benchmarks/scale.json.

Processor times of workers, parent and scheduler are measured in one run, each in a process of its own: of cases of the study
`paper`, of tasks without cases, and of tasks with the rows of many cases that cost nothing to compute. From these times
`studies.montecarlo.cluster_load` simulates any number of workers.
"""

import asyncio
import contextlib
import json
import pickle
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

from benchmarks.machine import machine
from studies.catalogue import find_entry
from studies.montecarlo.backends import open_backend
from studies.montecarlo.cases import Result, Task, run_cases
from studies.montecarlo.cluster_load import ClusterCosts, compute_throughput_bound, simulate_cluster
from studies.montecarlo.manifest import read_commit
from studies.montecarlo.store import Parts, build_table
from studies.montecarlo.study import load_config, resolve_config

OUT = Path("results/benchmarks/scale.json")
SMALL, LARGE = 1, 16  # cases of a task, whose times give that of a task and of a case
TASKS, SERVERS, THREADS = 200, 4, 16
PAUSE_S, PAUSES = 0.5, 10  # of a task without processor time, and tasks of a worker; a real run against the simulation
CASES, WORKERS, CHUNKS, CASE_S = 10**6, 1000, (16, 64, 256), (None, 1.0, 10.0)


@lru_cache
def run_sample() -> tuple[Task, Result]:
    """Run a few cases of the study, warm."""
    study = find_entry("paper").study
    task = Task(study.name, resolve_config(load_config(study, changes={"cases": LARGE})).model_dump_json(), range(LARGE))
    run_cases(task)
    return task, run_cases(task)


def answer(task: Task) -> Result:
    """Answer with rows as a task has them, at once; those of the study's first cases."""
    rows = [dict(row) for row in run_sample()[1].rows if row["case"] < len(task.cases)]
    return Result(rows, {})


def pause(task: Task) -> Result:
    """Answer after a while that takes no processor time."""
    time.sleep(PAUSE_S)
    return Result([], {})


async def serve(kind: str, address: str, threads: str) -> None:
    """Be a scheduler, or many workers."""
    import distributed

    made: list[Any]
    async with contextlib.AsyncExitStack() as servers:
        if kind == "scheduler":
            made = [distributed.Scheduler(host="127.0.0.1", port=int(address.rpartition(":")[2]), dashboard_address=":0")]
        else:
            made = [distributed.Worker(address, nthreads=int(threads), dashboard_address=":0") for _ in range(SERVERS)]
        for one in made:
            await servers.enter_async_context(one)
        await made[0].finished()


@contextlib.contextmanager
def start_cluster(threads: int) -> Iterator[str]:
    """Start a scheduler and a process of workers; yields the scheduler's address."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    processes = []
    try:
        for kind in ("scheduler", "workers"):
            command = [sys.executable, "-m", "benchmarks.scale", kind, address, str(threads)]
            processes.append(subprocess.Popen(command, stderr=subprocess.DEVNULL))
            while kind == "scheduler" and socket.socket().connect_ex(("127.0.0.1", port)):
                time.sleep(0.1)
        yield address
    finally:
        for process in processes:
            process.kill()


def measure_tasks(address: str, run: Callable[[Task], Result], cases: int, count: int) -> dict[str, float]:
    """Measure processor times of parent and scheduler a task, and the duration of all, s."""
    backend: Any = open_backend("dask", run, scheduler=address)
    task = Task("", run_sample()[0].config, range(cases))
    try:
        backend.client.wait_for_workers(SERVERS)
        backend.client.run(run_sample)
        backend.counted_at = -1e9  # all workers are there now
        cpu = [backend.client.run_on_scheduler(time.process_time), time.process_time()]
        begun = time.monotonic()
        assert all(backend.results([task] * count))
        wall_s = time.monotonic() - begun
        spent = [backend.client.run_on_scheduler(time.process_time) - cpu[0], time.process_time() - cpu[1]]
    finally:
        backend.close(True)
    return {"scheduler_s": spent[0] / count, "parent_s": spent[1] / count, "wall_s": wall_s}


def measure_parts(cases: int) -> tuple[float, float]:
    """Measure the processor time to store a part of so many cases, and to look at it when a study resumes, s."""
    rows = [row for row in run_sample()[1].rows if row["case"] < cases]
    with tempfile.TemporaryDirectory() as folder:
        parts = Parts(Path(folder), cases * TASKS, cases, "")
        begun = time.process_time()
        for index in range(TASKS):
            parts.write(index, rows, 0.0)
        written = time.process_time()
        for _ in range(TASKS):
            parts.inspect(0)
        return (written - begun) / TASKS, (time.process_time() - written) / TASKS


def measure() -> dict[str, Any]:
    """Measure all costs, and compare the simulation with a real run."""
    task, result = run_sample()
    with start_cluster(THREADS) as address:
        small, large = (measure_tasks(address, answer, cases, TASKS) for cases in (SMALL, LARGE))
    with start_cluster(1) as address:
        paused = measure_tasks(address, pause, 0, PAUSES * SERVERS)["wall_s"]
    (store_small, _), (store_large, inspect_s) = measure_parts(SMALL), measure_parts(LARGE)
    parent = [small["parent_s"] + store_small, large["parent_s"] + store_large]
    scheduler = [small["scheduler_s"], large["scheduler_s"]]
    slopes = [max(0.0, (high - low) / (LARGE - SMALL)) for low, high in (parent, scheduler)]
    fixed = [low - SMALL * slope for (low, _), slope in zip((parent, scheduler), slopes, strict=True)]
    costs = ClusterCosts(result.cpu_s / LARGE, fixed[0], slopes[0], fixed[1], slopes[1])
    idle = ClusterCosts(PAUSE_S, small["parent_s"], 0.0, small["scheduler_s"], 0.0)
    return {
        "costs": asdict(costs),
        "bytes_of_a_task": len(pickle.dumps(task)),
        "bytes_of_a_case": len(pickle.dumps(result)) / LARGE,
        "table_bytes_of_a_case": build_table(result.rows).nbytes / LARGE,
        "inspect_part_s": inspect_s,
        "real_run": {
            "workers": SERVERS,
            "wall_s": paused,
            "simulated_s": simulate_cluster(idle, SERVERS, 1, PAUSES * SERVERS),
        },
    }


def build_rows(costs: ClusterCosts) -> list[dict[str, float]]:
    """Simulate a million cases on a thousand workers, by the time of a case and the cases of a task."""
    rows = []
    for case_s in CASE_S:
        these = ClusterCosts(**asdict(costs) | ({"case_s": case_s} if case_s else {}))
        for chunk in CHUNKS:
            wall_s = simulate_cluster(these, WORKERS, chunk, CASES)
            bound = compute_throughput_bound(these, WORKERS, chunk)
            row = {"case_s": these.case_s, "chunk": chunk, "wall_s": wall_s, "bound_s": CASES / bound}
            rows.append(row | {"busy": CASES * these.case_s / WORKERS / wall_s, "parts": -(-CASES // chunk)})
    return rows


def main() -> None:
    """Measure, simulate, write."""
    found = measure()
    rows = build_rows(ClusterCosts(**found["costs"]))
    document = {"command": "python -m benchmarks.scale", "commit": read_commit(), "machine": machine(), **found, "rows": rows}
    OUT.write_text(json.dumps(document, indent=1) + "\n")
    print(json.dumps({**found, "rows": rows}, indent=1))


if __name__ == "__main__":
    if sys.argv[1:]:
        asyncio.run(serve(*sys.argv[1:]))
    else:
        from benchmarks import scale

        scale.main()  # under its own name, by which a worker finds what it runs
