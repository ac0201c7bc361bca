"""The report of the study of a real gyro: findings, tables and figures."""

from __future__ import annotations

from functools import partial

import pandas as pd

from studies.report.entry import Entry, Report
from studies.report.panels import Draw
from studies.report.tables import Table
from studies.validation.real_gyro.figures import figure_ladder, figure_series, figure_sizes, figure_zero
from studies.validation.real_gyro.findings import findings
from studies.validation.real_gyro.study import STUDY
from studies.validation.real_gyro.tables import diagnoses, ladder, remaining, samples, sizes, tried, wide
from studies.validation.real_gyro.trials import RealConfig


def report(rows: pd.DataFrame) -> Report:
    """Findings, tables and figures."""
    table = ladder(rows)
    found, offsets = diagnoses(rows), sizes(rows)
    tables = {
        "ladder": Table("Held-out error, RMS per rung", table, shown=wide(table)),
        "diagnoses": Table("Diagnosis of each trial", found),
        "time_offsets": Table("Time offset per trial and unit", offsets),
        "samples": Table("Samples", samples(rows)),
        "tried": Table("Tried beside the last rung", tried(rows)),
        "remaining": Table("What remains of the turns", remaining(rows)),
    }
    figures: dict[str, Draw] = {
        "ladder": partial(figure_ladder, table),
        "series": partial(figure_series, rows),
        "zero": partial(figure_zero, rows),
    }
    if len(offsets):
        figures["offsets"] = partial(figure_sizes, offsets)
    return Report(tables, figures, findings=tuple(findings(rows, table)))


def _report(config: RealConfig, rows: pd.DataFrame) -> Report:
    return report(rows)


ENTRY = Entry(STUDY, "what M0 lacks on recorded gyros, and how far held-out prediction improves (BROAD)", _report)
