"""Whether committed rows are those of the present code: some cases of each committed study are run again and compared.

Results without rows (results/mission, results/benchmarks, results/baseline) are compared by other tests and `make reproduce`.
"""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from studies.montecarlo.cases import Task, run_cases
from studies.montecarlo.engine import load_stored_config
from studies.montecarlo.study import find, resolve_config
from tests.claims.text import Problem

QUICK = {  # cases by study: some of the cheapest, 30 s of processor time together
    "alignment": (1,),
    "consistency": (0, 1),
    "estimators": (1,),
    "flight": (0, 100, 200),
    "import": (1,),
    "iterations": (0, 1),
    "noise": (0, 20, 42),
    "observability": (0, 1, 100),
    "onboard": (1,),
    "paper": (0, 1),
    "promises": (1, 6),
    "psi": (1, 50),
    "references": (0, 1),
    "sentinel2a": (0,),
    "timestep": (0, 1),
}
SLOW = {"heads": (0,), "real": (0,)}  # some 20 s a case: by ``python -m tests.claims --rerun`` only
TABLES = {"paper": "reproduction/cases.parquet"}  # its own 10,000 cases are not kept; these are its first 200
# Relative to the value, and to the largest of its column: rows made on other processors differ by up to 1e-8 of themselves.
RELATIVE, OF_COLUMN = 1e-6, 1e-9
MEASURED = re.compile("cost_|object_bytes$")  # columns of processor time and memory


def rerun_problems(root: Path, study: str) -> Iterator[Problem]:
    """Run the chosen cases of a study again; find where they differ from the committed rows."""
    path = root / "results" / TABLES.get(study, f"studies/{study}/table.parquet")
    chosen = find(json.loads((path.parent / "manifest.json").read_text())["study"])
    config = load_stored_config(chosen, path.parent)
    if config is None:
        yield Problem(str(path.relative_to(root)), 0, f"the study cannot have the settings of the manifest: {study}")
        return
    text = resolve_config(config).model_dump_json()
    for case in (QUICK | SLOW)[study]:
        made = pd.DataFrame(run_cases(Task(chosen.name, text, range(case, case + 1))).rows)
        different = differences(pq.read_table(path).to_pandas(), case, made)
        if different:
            what = ", ".join(different)
            yield Problem(str(path.relative_to(root)), 0, f"case {case} differs in {what}; make the results again")


def differences(table: pd.DataFrame, case: int, made: pd.DataFrame) -> list[str]:
    """List the columns in which rows of a case differ from those of a table, numbers by more than rounding."""
    rows = table[table["case"] == case].reset_index(drop=True)
    if len(rows) != len(made):
        return [f"the number of rows ({len(made)}, committed {len(rows)})"]
    names = [name for name in dict.fromkeys([*table, *made]) if not MEASURED.match(name)]
    return [name for name in names if not _same(table.get(name), rows.get(name), made.get(name))]


def _same(column: pd.Series | None, before: pd.Series | None, now: pd.Series | None) -> bool:
    if column is None or before is None:
        return False
    if now is None:
        return bool(before.isna().all())
    if not pd.api.types.is_numeric_dtype(column):
        return bool((before.fillna("") == now.fillna("")).all())
    largest = float(np.nanmax(np.abs(column.astype(float)), initial=0.0))
    return np.allclose(now.astype(float), before.astype(float), RELATIVE, OF_COLUMN * largest, equal_nan=True)
