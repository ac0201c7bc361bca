"""Processor time of fresh processes: the first calibration, the next ones, help, and the import of the library."""

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import gyrocal
from gyrocal.recording import Recording

COMMAND = "import sys; from studies.cli.main import main; sys.exit(main())"


def measure_starts(recording: Recording, rounds: int) -> dict[str, float]:
    """Measure processor times in s: `gyrocal calibrate` with nothing compiled, and the least of the others with it compiled."""
    with tempfile.TemporaryDirectory() as place:
        gyrocal.save(recording, Path(place, "recording"))
        calibrate = COMMAND, "calibrate", str(Path(place, "recording"))
        settings = {"NUMBA_CACHE_DIR": str(Path(place, "cache"))}
        found = {"calibrate_cold_cpu_s": measure_processor_time(calibrate, settings)}
        calls = {"calibrate_warm": calibrate, "help": (COMMAND, "--help"), "import_gyrocal": ("import gyrocal",)}
        for name, call in calls.items():
            found[f"{name}_cpu_s"] = min(measure_processor_time(call, settings) for _ in range(rounds))
    return found


def measure_processor_time(call: tuple[str, ...], settings: dict[str, str]) -> float:
    """Measure the processor time of Python code with arguments in a fresh process, s; Python keeps its own bytecode."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | settings
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-c", *call]
    subprocess.run(command, cwd=Path(__file__).parents[1], env=environment, capture_output=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
