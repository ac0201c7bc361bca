"""The recovered parameters of a fixed small study, held under ``results/baseline`` for CI to compare with.

Stored in ppm and deg/h, where the values are of the order one, and compared relatively: an absolute tolerance would let a
bias of 1e-7 rad/s change unseen.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

from gyrocal import NAMES, InputError
from studies.montecarlo import engine
from studies.montecarlo.files import write_csv
from studies.natanson import paper_tables

CASES = 4
STEPS_S = (0.5, 2.0)
RTOL = 1e-6  # compilers and BLAS libraries differ in rounding; a change of method shows at 1e-4 and above
KEYS = ["case", "step_s", "resampling", "psi", "covariance"]


def default_path() -> Path:
    """Where the baseline lies, in the folder the command runs in."""
    return Path("results") / "baseline" / "recovered.csv"


def recovered() -> pd.DataFrame:
    """Recovered minus identity of G in ppm, b in deg/h, their sigmas and NEES, a row per case and variant."""
    config = paper_tables.PaperTablesConfig(cases=CASES, steps_s=STEPS_S)
    with TemporaryDirectory() as folder:
        outcome = engine.run(paper_tables.STUDY, config, Path(folder), backend="serial")
        outcome.check()
        rows = outcome.load()
    out = rows[KEYS].copy()
    identity = np.eye(3).ravel()
    for label in ("first", "second"):
        for k, name in enumerate(NAMES):
            value = rows[f"{label}_{name}"]
            out[f"{label}_{_named(name)}"] = (value - identity[k]) * 1e6 if k < 9 else value * 3600
    for k, name in enumerate(NAMES):
        out[f"sigma_{_named(name)}"] = rows[f"sigma_{name}"] * (1e6 if k < 9 else 3600)
    out["nees"] = rows["nees"]
    return out


def _named(name: str) -> str:
    return f"{name}_ppm" if name.startswith("G") else f"{name}_deg_h"


def moved(old: pd.DataFrame, new: pd.DataFrame) -> pd.DataFrame:
    """Values that differ by more than RTOL, the largest relative change first."""
    if list(old.columns) != list(new.columns) or not old[KEYS].equals(new[KEYS]):
        return pd.DataFrame({"quantity": ["rows or columns"], "old": [str(old.shape)], "new": [str(new.shape)]})
    values = [column for column in new.columns if column not in KEYS]
    before, after = old[values].to_numpy(), new[values].to_numpy()
    change = np.abs(after - before) / np.abs(before)
    rows, columns = np.nonzero(~(change <= RTOL))
    table = pd.DataFrame(
        {
            **{key: new[key].to_numpy()[rows] for key in KEYS},
            "quantity": [values[k] for k in columns],
            "old": before[rows, columns],
            "new": after[rows, columns],
            "relative_change": change[rows, columns],
        }
    )
    return table.sort_values("relative_change", ascending=False, ignore_index=True)


def read(path: Path) -> pd.DataFrame:
    """Read a stored baseline."""
    try:
        table = pd.read_csv(path)
    except (ValueError, UnicodeDecodeError) as fault:  # pandas' parser errors are ValueErrors
        raise InputError(f"{path}: not a baseline: {' '.join(str(fault).split())}") from None
    if not set(KEYS) <= set(table.columns):
        raise InputError(f"{path}: not a baseline: columns {', '.join(KEYS)} are needed")
    return table


def write(table: pd.DataFrame, path: Path) -> None:
    """Store a baseline with all digits that the comparison uses."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_csv(path, table, digits=12)
