"""Run a study in processes of its own, which are killed at random moments or not, and watch how much memory they hold."""

import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from studies.montecarlo.engine import run
from studies.montecarlo.manifest import MANIFEST
from studies.montecarlo.study import load_config
from tests import ROOT
from tests.soak.study import STUDY

LOOK_S = 0.2  # between two looks at a process


@dataclass
class Runs:
    """What was seen of the processes of one study.

    Attributes
    ----------
    folder : of the study
    kills : how many were killed
    memory : resident MiB at each look, process by process
    seconds : of all of them
    """

    folder: Path
    kills: int = 0
    memory: list[list[float]] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def table(self) -> Path:
        """The table."""
        return self.folder / "table.parquet"

    @property
    def sha256(self) -> str:
        """Hash of the table's bytes."""
        return hashlib.sha256(self.table.read_bytes()).hexdigest()

    def memory_of_the_longest(self) -> tuple[float, float]:
        """Mean MiB over the second and over the last eighth of the process that was looked at most; NaN without any."""
        seen = max(self.memory, key=len, default=[])
        if not seen:
            return float("nan"), float("nan")
        part = max(len(seen) // 8, 1)
        first, last = seen[part : 2 * part] or seen, seen[-part:]
        return sum(first) / len(first), sum(last) / len(last)


def undisturbed(folder: Path, cases: int) -> Runs:
    """One process from the first case to the last."""
    out = Runs(folder)
    assert _watched(out, cases, None) == 0
    return out


def disturbed(folder: Path, cases: int, mean_s: float, seed: int) -> Runs:
    """Processes that are killed by SIGKILL after random times, exponential about a mean, until one comes to the end."""
    rng, out = random.Random(seed), Runs(folder)
    while _watched(out, cases, rng.expovariate(1 / mean_s)) != 0:
        out.kills += 1
    return out


def joined(folder: Path, first: Runs, second: Runs, cases: int) -> Runs:
    """Finished parts of one folder up to the middle, and of another after it, joined by a run in this process."""
    names = sorted(path.name for path in (first.folder / "parts").iterdir())
    (folder / "parts").mkdir(parents=True)
    shutil.copy2(first.folder / MANIFEST, folder / MANIFEST)
    for place, name in enumerate(names):
        source = first if place < len(names) // 2 else second
        shutil.copy2(source.folder / "parts" / name, folder / "parts" / name)
    begun = time.monotonic()
    outcome = run(STUDY, load_config(STUDY, changes={"cases": cases}), folder, backend="serial")
    assert outcome.resumed == cases
    return Runs(folder, seconds=time.monotonic() - begun)


def _watched(out: Runs, cases: int, after_s: float | None) -> int:
    """One process; its memory is looked at, and it is killed after a time if one is given. Returns its exit status."""
    begun = time.monotonic()
    command = [sys.executable, "-m", "tests.soak.run", str(out.folder), str(cases)]
    process = subprocess.Popen(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"})
    seen: list[float] = []
    while process.poll() is None:
        if after_s is not None and time.monotonic() - begun > after_s:
            process.send_signal(signal.SIGKILL)
            process.wait()
            break
        seen.append(_resident(process.pid))
        time.sleep(LOOK_S)
    out.memory.append([value for value in seen if value > 0])
    out.seconds += time.monotonic() - begun
    return int(process.returncode)


def _resident(process: int) -> float:
    """MiB that a process holds in memory; zero if it is gone."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS:")), 0.0)


if __name__ == "__main__":
    run(STUDY, load_config(STUDY, changes={"cases": int(sys.argv[2])}), Path(sys.argv[1]), backend="serial")
