"""Run the soak and write its figures: ``python -m tests.soak [CASES] [MEAN SECONDS BETWEEN KILLS]``; a million by default."""

import sys
import tempfile
from pathlib import Path

import pandas as pd
from numpy import sqrt

from studies.montecarlo.files import write_csv, write_text
from studies.montecarlo.manifest import read_commit
from studies.report import tables as render
from tests import ROOT
from tests.soak.run import Runs, disturbed, joined, undisturbed
from tests.soak.study import SAMPLE_S

CASES, MEAN_S, SEED = 1_000_000, 120.0, 15
DOF = 12


def table(runs: dict[str, Runs]) -> pd.DataFrame:
    """A row a study: processes killed, memory, time, and the table's hash."""
    rows = []
    for name, one in runs.items():
        early, late = one.memory_of_the_longest()
        rows.append(
            {
                "study": name,
                "kills": one.kills,
                "processes": len(one.memory),
                "memory_early_MiB": early,
                "memory_late_MiB": late,
                "wall_s": round(one.seconds),
                "table_sha256": one.sha256[:16],
            }
        )
    return pd.DataFrame(rows)


def main(cases: int, mean_s: float) -> int:
    """Run all three studies; 0 if their tables are the same byte for byte."""
    with tempfile.TemporaryDirectory(prefix="soak-") as name:
        work = Path(name)
        runs = {"undisturbed": undisturbed(work / "whole", cases)}
        print(table(runs).to_string(), flush=True)
        runs["killed at random"] = disturbed(work / "killed", cases, mean_s, SEED)
        print(table(runs).to_string(), flush=True)
        runs["halves joined"] = joined(work / "joined", runs["killed at random"], runs["undisturbed"], cases)
        found = table(runs)
        nees = pd.read_parquet(runs["undisturbed"].table, columns=["nees"])["nees"]
    print(found.to_string())
    same = len(set(found["table_sha256"])) == 1
    folder, sure = ROOT / "build" / "soak", DOF + sqrt(2 * DOF / cases) * pd.Series([-2.576, 2.576])
    write_csv(folder / "soak.csv", found)
    lines = [
        f"`python -m tests.soak {cases} {mean_s:g}` at commit {read_commit()}: {cases:,} cases, a calibration each,",
        f"one process at a time. The tables are {'the same' if same else 'NOT the same'} byte for byte. Memory: mean of the",
        "second and the last eighth of the longest process; the halves are finished parts of both, which another run joins.",
        f"Mean NEES {nees.mean():.3f}; {sure[0]:.3f} to {sure[1]:.3f} (99 %) if the covariance were exact. So many cases see",
        f"what holding the mean rate over samples of {SAMPLE_S:g} s leaves.",
    ]
    write_text(folder / "report.md", render.format_markdown("A long study, killed at random moments", found, "\n".join(lines)))
    return int(not same)


if __name__ == "__main__":
    given = [float(one) for one in sys.argv[1:]]
    sys.exit(main(int(given[0]) if given else CASES, given[1] if len(given) > 1 else MEAN_S))
