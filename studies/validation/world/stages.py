"""A diagnosis in three stages whose outcomes are stored, so that a change of a later stage is tried from there.

- ``samples``: `diagnosis.model.prepare`, the samples examined and the recording linearised about its calibration
- ``attitude``: `diagnosis.explain`, what the attitude shows
- ``verdict``: the answer

The outcome of a stage is taken from another run only if the sources of the stage, and of all before it, are those of that run:
their hash is the name of the folder in which the outcomes are stored. These are all sources of calibrator, simulator and
diagnosis but those that only a later stage runs (`LATER`). Recordings of several gyros or with raw sensor tables go
another way through the diagnosis; they are diagnosed as a whole, and nothing of them is stored.
"""

from __future__ import annotations

import os
import pickle
import resource
import time
import zlib
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from diagnosis.diagnose import answer, diagnose, nameable
from diagnosis.explain import Explained, explain_prepared
from diagnosis.model.prepare import Prepared, prepare
from diagnosis.settings import DEFAULT
from gyrocal.recording import Recording
from studies.montecarlo.provenance import PROJECT, hash_files

SEED = 0  # the diagnosis' own draws must not depend on the cases'
AFTER_ATTITUDE = (  # modules of the diagnosis that neither `samples` nor `attitude` runs
    *("__init__", "adopt", "assemble", "detail_tables", "diagnose", "draft", "gyros", "identifiable", "merge"),
    *("next_recording", "notes", "plan", "posterior", "result", "sensor_tables", "verdict"),
)
LATER = {  # by stage
    "samples": (
        *AFTER_ATTITUDE,
        *("budget", "explain", "remainder_search", "replication"),
        *("inference/closure", "inference/null", "inference/refinement"),
    ),
    "attitude": AFTER_ATTITUDE,
}
Attitude = tuple[Prepared, Explained]


@dataclass(frozen=True)
class Timed:
    """An answer as JSON, with processor seconds and peak memory (MB, NaN where the system does not tell), and the stage that
    was taken from another run ("" for none)."""

    answer: dict[str, Any]
    cpu_s: float
    peak_mb: float
    stored: str


def diagnose_in_stages(recording: Recording, store: Path | None, name: str) -> Timed:
    """Diagnose a recording, from the latest stage that is stored.

    Parameters
    ----------
    recording : what is diagnosed
    store : folder of the stages of all runs; None to store nothing
    name : of the recording in it
    """
    _reset_peak()
    stored, begun, storing = "", time.process_time(), 0.0
    if recording.is_array or recording.sensors is not None or store is None:
        found = diagnose(recording, seed=SEED)
    else:
        with threadpool_limits(1, user_api="blas"):
            effects = nameable(None, of_trackers=recording.attitudes.sensor is not None)
            places = {stage: store / f"{stage}-{stage_hash(stage)}" / f"{name}.pkl.z" for stage in LATER}
            if places["attitude"].exists():
                stored, (prepared, explained) = "attitude", _read(places["attitude"])
            else:
                if places["samples"].exists():
                    stored, examined = "samples", _read(places["samples"])
                else:
                    examined = prepare(recording, DEFAULT, _quiet)
                    storing += _write(places["samples"], examined)
                prepared, explained = explain_prepared(examined, effects, DEFAULT, SEED, _quiet)
                storing += _write(places["attitude"], (prepared, _without_functions(explained)))
            found = answer(prepared, explained, effects, DEFAULT, time.process_time() - begun - storing)
    return Timed(found.to_json(), time.process_time() - begun - storing, _peak_mb(), stored)


@cache
def stage_hash(stage: str) -> str:
    """Hash the sources of a stage and of all before it."""
    later = [PROJECT / "diagnosis" / name for name in LATER[stage]]
    files = [path for name in ("gyrocal", "simulator", "diagnosis") for path in (PROJECT / name).rglob("*")]
    return hash_files(path for path in files if not {path.with_suffix(""), *path.parents} & set(later))[:16]


def _quiet(text: str, share: float) -> None:
    """Show no progress."""


def _without_functions(explained: Explained) -> Explained:
    """Drop the functions of the candidates, which may hold gigabytes and which no answer is made of."""
    return replace(
        explained, candidates=tuple(replace(one, read=_nothing, size_sigma=_nothing) for one in explained.candidates)
    )


def _nothing(*arguments: Any) -> Any:
    raise RuntimeError("a stored explanation has no columns to do this with")


def _read(path: Path) -> Any:
    return pickle.loads(zlib.decompress(path.read_bytes()))  # made by the run that this one continues


def _write(path: Path, value: Any) -> float:
    """Store an outcome; returns the processor time that it took, s."""
    begun = time.process_time()
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.{os.getpid()}")
    part.write_bytes(zlib.compress(pickle.dumps(value), 1))
    part.replace(path)
    return time.process_time() - begun


def _reset_peak(place: Path = Path("/proc/self/clear_refs")) -> None:
    """Let the system count the peak memory anew; only Linux does."""
    if place.exists():
        place.write_text("5")


def _peak_mb(place: Path = Path("/proc/self/status")) -> float:
    """Read the peak memory since then."""
    if not place.exists():
        return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 1024
    lines = place.read_text().splitlines()
    return next((float(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")), float("nan"))
