"""A diagnosis with the processor time and the memory that it takes."""

from __future__ import annotations

import resource
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from diagnosis.diagnose import diagnose
from gyrocal.recording import Recording

SEED = 0  # the diagnosis' own draws must not depend on the cases'


@dataclass(frozen=True)
class TimedDiagnosis:
    """An answer as JSON, with processor seconds and peak memory (MB, NaN where the system does not tell)."""

    answer: dict[str, Any]
    cpu_s: float
    peak_mb: float


def diagnose_timed(recording: Recording) -> TimedDiagnosis:
    """Diagnose a recording."""
    _reset_peak()
    begun = time.process_time()
    found = diagnose(recording, seed=SEED)
    return TimedDiagnosis(found.to_json(), time.process_time() - begun, _read_peak_memory())


def _reset_peak(place: Path = Path("/proc/self/clear_refs")) -> None:
    """Let the system count the peak memory anew; only Linux does."""
    if place.exists():
        place.write_text("5")


def _read_peak_memory(place: Path = Path("/proc/self/status")) -> float:
    """Read the peak memory since then."""
    if not place.exists():
        return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 1024
    lines = place.read_text().splitlines()
    return next((float(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")), float("nan"))
