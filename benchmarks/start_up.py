"""What a command costs before it does anything: its help, and the refusal of a wrong option and of a missing recording."""

import resource
import subprocess
import sys
from pathlib import Path

from studies.cli.main import COMMAND_NAMES

NUMPY = "import numpy"
COMMAND_LINE = "from studies.cli.main import main; main()"
REFUSALS = {"wrong_option": ("calibrate", "--no-such-option"), "no_recording": ("calibrate", "no/such/recording")}


def measure_start_ups(rounds: int) -> dict[str, float]:
    """Least processor time (s) of `import numpy` in a fresh process, of each command's help, and of refusals, by name."""
    calls = {"numpy": (NUMPY,), **{f"help_{name}": (COMMAND_LINE, name, "--help") for name in COMMAND_NAMES}}
    calls |= {name: (COMMAND_LINE, *arguments) for name, arguments in REFUSALS.items()}
    least = dict.fromkeys(calls, float("inf"))
    for _ in range(rounds + 1):  # the first one fills the file system's caches
        for name, call in calls.items():
            least[name] = min(least[name], _measure_processor_time(*call))
    return least


def compute_start_up_ratios(seconds: dict[str, float]) -> dict[str, float]:
    """The largest help, and each refusal, over `import numpy`."""
    slowest = max(value for name, value in seconds.items() if name.startswith("help_"))
    return {"help_vs_numpy": slowest / seconds["numpy"]} | {
        f"{name}_vs_numpy": seconds[name] / seconds["numpy"] for name in REFUSALS
    }


def _measure_processor_time(code: str, *arguments: str) -> float:
    """Processor time of a fresh process, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", code, *arguments], cwd=Path(__file__).parents[1], capture_output=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
