"""Tiny studies for the tests of the engine; importable, so that worker processes find them."""

import asyncio
import ctypes
import logging
import os
import signal
import sys
import time
import warnings
from pathlib import Path

import numpy as np

from studies.montecarlo.study import Streams, Study, StudyConfig, observed


class DrawsConfig(StudyConfig):
    """A study of random numbers.

    ``hang`` never return, ``die`` end their process, ``fail`` raise, ``stumble`` raise while the file ``crutch`` is not there;
    ``flag`` is a file that each case adds a byte to, so that a test sees how far a run is.
    """

    cases: int = 20
    size: int = 50
    steps_s: tuple[float, ...] = (0.5, 1.0)
    fail: tuple[int, ...] = ()
    die: tuple[int, ...] = ()
    hang: tuple[int, ...] = ()
    stumble: tuple[int, ...] = ()
    crutch: str = ""
    flag: str = ""
    pause_s: float = 0.0
    label: bool = False


def draws_case(config: DrawsConfig, case: int, streams: Streams) -> dict[str, object]:
    if config.flag:
        with Path(config.flag).open("ab") as file:
            file.write(b".")
    if config.pause_s:
        time.sleep(config.pause_s)
    if case in config.die:
        os.kill(os.getpid(), signal.SIGKILL)
    if case in config.hang:
        ctypes.PyDLL(None).sleep(600)  # holds the interpreter's lock
    if case in config.fail:
        raise ValueError(f"case {case}\nis bad")
    if case in config.stumble and not Path(config.crutch).exists():
        raise RuntimeError("no crutch")
    gyro = streams.generator("gyro_noise").standard_normal(config.size)
    reference = streams.generator("reference_noise").standard_normal(config.size)
    matrix = gyro[:, None] * reference[None, :]
    row: dict[str, object] = {
        "gyro": gyro[0],
        "mean": gyro.mean(),
        "norm": np.linalg.norm(matrix @ matrix),  # BLAS
        "positive": bool(gyro[0] > 0),
        "count": int((reference > 0).sum()),
    }
    # A column that only some chunks have.
    return row | ({"label": f"case {case}"} if config.label and case > 13 else {})


def steps_case(config: DrawsConfig, case: int, streams: Streams) -> list[dict[str, object]]:
    return [{"step_s": step, "draw": streams.generator(f"noise/{step}").standard_normal()} for step in config.steps_s]


def recording_case(config: StudyConfig, case: int, streams: Streams) -> dict[str, float]:
    recording = observed(config, case, streams)
    return {"rates": float(recording.gyro.rates.sum()), "quaternions": float(recording.attitudes.quaternions.sum())}


class OddConfig(StudyConfig):
    """A study of strange rows: one value per case, by name."""

    cases: int = 1
    values: tuple[str, ...] = ()


VALUES: dict[str, object] = {
    "number": 1.5,
    "whole": 3,
    "text": "a",
    "none": None,
    "list": [1],
}


def odd_case(config: OddConfig, case: int, streams: Streams) -> object:
    name = config.values[case]
    if name == "reserved":
        return {"case": 3}
    if name == "exit":
        sys.exit("over")
    if name == "warn":
        warnings.warn("mind the gap", RuntimeWarning, stacklevel=1)
        return {"x": 1.0}
    return {"x": VALUES[name]}


DRAWS = Study("tests.engine_studies:DRAWS", DrawsConfig, draws_case)
STEPS = Study("tests.engine_studies:STEPS", DrawsConfig, steps_case)
RECORDED = Study("tests.engine_studies:RECORDED", StudyConfig, recording_case, observed)
ODD = Study("tests.engine_studies:ODD", OddConfig, odd_case)


def serve_dask(kind, port, ready):
    """Be a scheduler, or a worker of one, until killed."""
    import distributed

    async def serve():
        made = (
            distributed.Scheduler(host="127.0.0.1", port=port, dashboard_address=":0")
            if kind == "scheduler"
            else distributed.Worker(f"tcp://127.0.0.1:{port}", nthreads=1, dashboard_address=":0")
        )
        async with made as server:
            ready.set()
            await server.finished()

    logging.disable()
    asyncio.run(serve())
