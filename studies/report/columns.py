"""The report of a study that has none of its own: the distribution of each column, and the share that failed."""

from typing import Any

import numpy as np
import pandas as pd

from studies.montecarlo.statistics import compute_tolerance_interval
from studies.montecarlo.study import DISPERSED, RESERVED
from studies.report.entry import Report
from studies.report.tables import Table

QUANTILES = {"p05": 0.05, "median": 0.5, "p95": 0.95}


def report_columns(config: Any, rows: pd.DataFrame) -> Report:
    """Mean, its standard error, spread and quantiles of each numeric column, and the counts of each text."""
    tables = {
        "columns": Table(
            f"Columns, {rows['case'].nunique()} cases", _summarise_numbers(rows), "Of truth values the mean is a share."
        )
    }
    texts = rows.select_dtypes(exclude=["number", "bool"]).drop(columns=list(RESERVED), errors="ignore")
    counts = [
        texts[name].value_counts().rename_axis("value").reset_index(name="rows").assign(column=str(name)).head(20)
        for name in texts
    ]
    if counts:
        table = pd.concat(counts, ignore_index=True)[["column", "value", "rows"]]
        tables["texts"] = Table("Texts, the most frequent of each column", table)
    return Report(tables)


def _summarise_numbers(rows: pd.DataFrame) -> pd.DataFrame:
    numbers = rows.select_dtypes(["number", "bool"]).drop(columns=list(RESERVED), errors="ignore").astype(float)
    lines = []
    for name, values in numbers.items():
        found = values[np.isfinite(values)]
        # The rows of a case are not independent.
        each = found.groupby(rows["case"]).mean()
        error = float(each.std(ddof=1) / np.sqrt(len(each))) if len(each) > 1 else np.nan
        line = {"column": name, "rows": len(found), "mean": found.mean(), "standard_error": error, "spread": found.std(ddof=1)}
        lines.append(line | {key: found.quantile(share) for key, share in QUANTILES.items()})
    return pd.DataFrame(lines, columns=["column", "rows", "mean", "standard_error", "spread", *QUANTILES])


def build_tolerance_table(rows: pd.DataFrame) -> Table:
    """Median and tolerance interval of each numeric column of a study's good rows; of a case with several rows their mean."""
    lines = []
    for name, values in rows.select_dtypes("number").drop(columns=list(RESERVED), errors="ignore").items():
        each = values[np.isfinite(values)].astype(float).groupby(rows["case"]).mean()
        if len(each) and not str(name).startswith(DISPERSED):
            low, high = compute_tolerance_interval(each)
            lines.append({"column": name, "cases": len(each), "median": each.median(), "low": low, "high": high})
    note = (
        "Low to high holds 95 % of all cases that do not fail, with 95 % confidence, whatever the distribution. "
        "It needs 93 cases. Of a case with several rows their mean counts."
    )
    return Table("Tolerance intervals", pd.DataFrame(lines, columns=["column", "cases", "median", "low", "high"]), note)
