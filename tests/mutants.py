"""Mutate modules with cosmic-ray and list the mutants that their tests miss.

``python -m tests.mutants gyrocal/calibration/davenport.py --tests tests/gyrocal/calibration --sample 60`` works in a copy of
the checkout in build/mutants. Every mutant starts a fresh process, and compiled code follows its source (`gyrocal.jit_cache`).
cosmic-ray rather than mutmut, because mutmut calls mutants through a wrapper, which numba cannot compile.
"""

import argparse
import os
import random
import shutil
import subprocess
import sys
from pathlib import Path

from tests import ROOT, SHARED

PLACE = ROOT / "build" / "mutants"
CONFIG = """[cosmic-ray]
module-path = {modules}
timeout = {timeout_s}
excluded-modules = []
test-command = "{python} -m pytest -x -q -p no:cacheprovider {tests}"

[cosmic-ray.distributor]
name = "local"
"""


def copy_checkout(place: Path) -> Path:
    """Copy the versioned files, changes included, and link the recordings that tests may use."""
    tree = place / "tree"
    shutil.rmtree(place, ignore_errors=True)
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout.decode()
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, tree / name)
    if SHARED.exists():
        (place / SHARED.name).symlink_to(SHARED.resolve())
    return tree


def keep_sample(session: Path, size: int, seed: int) -> None:
    """Mark all mutants of a session as skipped but a random sample."""
    from cosmic_ray.work_db import WorkDB, use_db
    from cosmic_ray.work_item import WorkerOutcome, WorkResult

    with use_db(str(session), WorkDB.Mode.open) as database:
        mutants = sorted(item.job_id for item in database.work_items)
        kept = set(random.Random(seed).sample(mutants, min(size, len(mutants))))
        for job in set(mutants) - kept:
            database.set_result(job, WorkResult(worker_outcome=WorkerOutcome.SKIPPED))


def list_survivors(session: Path) -> tuple[int, list[str]]:
    """Count the mutants that were run, and give the differences of those that no test noticed."""
    from cosmic_ray.work_db import WorkDB, use_db
    from cosmic_ray.work_item import WorkerOutcome

    with use_db(str(session), WorkDB.Mode.open) as database:
        run = [result for _, result in database.completed_work_items if result.worker_outcome != WorkerOutcome.SKIPPED]
    return len(run), [result.diff or "" for result in run if not result.is_killed]


def main() -> int:
    """Run the command; the exit status is 1 if a mutant survives."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("modules", nargs="+", help="files of the core, from the root of the repository")
    parser.add_argument("--tests", nargs="+", default=["tests/gyrocal"], help="files or folders of tests that have to notice")
    parser.add_argument("--sample", type=int, default=60, help="mutants to run, drawn from all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--timeout", type=float, default=600.0, help="seconds after which a mutant counts as noticed")
    asked = parser.parse_args()
    tree = copy_checkout(PLACE)
    config, session = PLACE / "cosmic-ray.toml", PLACE / "session.sqlite"
    tests = " ".join(asked.tests)
    config.write_text(CONFIG.format(modules=asked.modules, timeout_s=asked.timeout, python=sys.executable, tests=tests))
    environment = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment.pop("NUMBA_CACHE_DIR", None)

    def run(*words: str | Path) -> None:
        subprocess.run([sys.executable, "-m", "cosmic_ray.cli", *map(str, words)], cwd=tree, env=environment, check=True)

    run("baseline", config)  # fails where the tests fail without a mutant
    run("init", config, session)
    keep_sample(session, asked.sample, asked.seed)
    run("exec", config, session)
    count, survivors = list_survivors(session)
    print("\n".join(survivors))
    print(f"{count} mutants were run, {len(survivors)} of them were noticed by no test")
    return int(bool(survivors))


if __name__ == "__main__":
    sys.exit(main())
