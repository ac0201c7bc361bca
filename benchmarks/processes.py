"""Measurements of fresh processes: their output and their processor time."""

import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import gyrocal
from gyrocal.recording import Recording

COMMAND = "import sys; from studies.cli.main import main; sys.exit(main())"
FOLDER = Path(__file__).parents[1]


def run_module(module: str, *arguments: float, **settings: str) -> dict[str, Any]:
    """Run a module in a fresh process, with settings of its environment, and return the JSON that it prints."""
    command = [sys.executable, "-m", module, *map(str, arguments)]
    process = subprocess.run(command, cwd=FOLDER, env=os.environ | settings, capture_output=True, text=True, check=True)
    result: dict[str, Any] = json.loads(process.stdout)
    return result


def measure_starts(recording: Recording, rounds: int) -> dict[str, float]:
    """Measure processor times in s: `gyrocal calibrate` with nothing compiled, and the least of the others with it compiled."""
    with tempfile.TemporaryDirectory() as folder:
        gyrocal.save(recording, Path(folder, "recording"))
        calibrate = COMMAND, "calibrate", str(Path(folder, "recording"))
        settings = {"NUMBA_CACHE_DIR": str(Path(folder, "cache"))}
        times = {"calibrate_cold_cpu_s": measure_processor_time(calibrate, settings)}
        calls = {"calibrate_warm": calibrate, "help": (COMMAND, "--help"), "import_gyrocal": ("import gyrocal",)}
        for name, call in calls.items():
            times[f"{name}_cpu_s"] = min(measure_processor_time(call, settings) for _ in range(rounds))
    return times


def measure_processor_time(call: tuple[str, ...], settings: dict[str, str]) -> float:
    """Measure the processor time of Python code with arguments in a fresh process, s; Python keeps its own bytecode."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | settings
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", *call], cwd=FOLDER, env=environment, capture_output=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
