"""Studies on what stands for another machine: other BLAS kernels, and numpy without its widest vector units.

``python -m tests.elsewhere`` runs each study anew under every combination of `KERNELS` and `VECTORS`, in a process of its own,
compares the tables that a study commits byte for byte and its rows bit for bit, and lets the last one go on with rows of the
first, which must be refused. It writes build/elsewhere; words choose studies.
"""

import os
import subprocess
import sys
import tempfile
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from studies.montecarlo.files import write_csv, write_text
from studies.montecarlo.manifest import read_commit
from studies.report import tables as render
from tests import ROOT

KERNELS = ("Haswell", "SkylakeX")  # OPENBLAS_CORETYPE
WIDE = ("X86_V4", "AVX512")
STUDIES = {  # by name, with the number of cases where the study's own takes minutes
    "consistency": None,
    "psi": None,
    "iterations": None,
    "timestep": None,
    "paper": 300,
    "promises": 16,
}


def vectors() -> dict[str, str]:
    """What NPY_DISABLE_CPU_FEATURES is with and without the widest vector units that numpy has found here."""
    found = (np.show_config(mode="dicts") or {})["SIMD Extensions"].get("found", [])
    return {"all": "", "no AVX-512": " ".join(name for name in found if name.startswith(WIDE))}


def ran(study: str, folder: Path, kernel: str, disabled: str, cases: int | None) -> subprocess.CompletedProcess[str]:
    """A study with one kernel and set of vector units."""
    more = {"OPENBLAS_CORETYPE": kernel, "NPY_DISABLE_CPU_FEATURES": disabled, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "gyrocal", "study", study, "--backend", "serial", "--out", str(folder)]
    command += ["--cases", str(cases)] if cases else []
    return subprocess.run(command, cwd=ROOT, env={**os.environ, **more}, capture_output=True, text=True, check=False)


def compared(study: str, work: Path) -> dict[str, object]:
    """One study under all combinations."""
    cases, folders = STUDIES[study], []
    combinations = list(product(KERNELS, vectors().items()))
    for kernel, (name, disabled) in combinations:
        folders.append(work / f"{study} {kernel} {name}")
        done = ran(study, folders[-1], kernel, disabled, cases)
        if done.returncode:
            raise RuntimeError(f"{study}, {kernel}, {name}: {done.stderr}")
    tables = [{path.name: path.read_bytes() for path in folder.glob("*.csv")} for folder in folders]
    different = {name for one in tables[1:] for name in one if one[name] != tables[0][name]}
    rows = [pd.read_parquet(folder / "table.parquet").select_dtypes("number") for folder in folders]
    apart = [_apart(rows[0], one) for one in rows[1:]]
    (folders[0] / "table.parquet").unlink()
    next((folders[0] / "parts").iterdir()).unlink()  # so that there is something left to compute
    kernel, (_, disabled) = combinations[-1]
    resumed = ran(study, folders[0], kernel, disabled, cases)
    return {
        "study": study,
        "cases": cases or "all",
        "tables": len(tables[0]),
        "tables_that_differ": ", ".join(sorted(different)) or "none",
        "floats_that_differ_percent": max(100 * share for share, _ in apart),
        "largest_relative_difference": max(size for _, size in apart),
        "resume_elsewhere": "refused" if resumed.returncode == 2 and "computed elsewhere" in resumed.stderr else "TAKEN",
    }


def _apart(a: pd.DataFrame, b: pd.DataFrame) -> tuple[float, float]:
    """Share of numbers that differ, and the largest difference by the largest number of its column."""
    x, y = a.to_numpy(float), b.to_numpy(float)
    same = (x == y) | (np.isnan(x) & np.isnan(y))
    size = np.maximum(np.nanmax(np.abs(np.where(np.isfinite(x), x, 0)), axis=0), 1e-300)
    return float(1 - same.mean()), float(np.nanmax(np.where(same, 0, np.abs(x - y)) / size, initial=0))


def main(words: list[str]) -> int:
    """Compare the chosen studies; 0 if no table differs and every resume is refused."""
    found = []
    with tempfile.TemporaryDirectory(prefix="elsewhere-") as name:
        for study in words or STUDIES:
            found.append(compared(study, Path(name)))
            print(found[-1], flush=True)
    table = pd.DataFrame(found)
    if not words:
        note = (
            f"`python -m tests.elsewhere` at commit {read_commit()}: OPENBLAS_CORETYPE {' and '.join(KERNELS)}, each with all\n"
            f"of numpy's vector units and without {vectors()['no AVX-512']}. Tables are those that a study commits, compared\n"
            "byte for byte; rows are compared with those of the first, differences by the largest number of their column."
        )
        folder = ROOT / "build" / "elsewhere"
        write_csv(folder / "elsewhere.csv", table)
        write_text(folder / "report.md", render.format_markdown("The same studies elsewhere", table, note))
    return int((table["tables_that_differ"] != "none").any() or (table["resume_elsewhere"] != "refused").any())


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
