"""Does every covariance and interval that the library states hold, over four plans and four grades of noise?

Each case flies one plan with one grade (`studies.validation.promises.plans`) through calibrator, trackers, four gyros, batch,
filter, smoother, alignment and prediction (`studies.validation.promises.cases`). What a diagnosis states is checked in the test
world (`studies.validation.world`).

Of a covariance, coverage is the share of cases in which the truth is within the ellipsoid that holds so much of a normal
distribution. The bounds are those that all lines of one table keep to together with 99 %, if every statement is right: a share
below them was stated too surely, one above too cautiously.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd
import scipy.special
from matplotlib.axes import Axes
from pydantic import model_validator

from studies.montecarlo.statistics import SIGMA_LEVELS, compute_binomial_band
from studies.montecarlo.study import Streams, Study, StudyConfig
from studies.report import panels
from studies.report.checks import Check
from studies.report.entry import Entry, Report
from studies.report.panels import Draw
from studies.report.tables import Table, summarise_groups
from studies.validation.promises import cases
from studies.validation.promises.cases import Row
from studies.validation.promises.plans import PLAN_NAMES, SENSOR_GRADES

TABLE_CONFIDENCE = 0.99  # of all lines of a table together
KEPT, TOO_SURE, TOO_CAUTIOUS = "kept", "too sure", "too cautious"
CONTROL_LINES = ("calibrate, N's covariance",)  # known to be wrong where the gyro's noise counts
JUDGED = (SIGMA_LEVELS["68"], SIGMA_LEVELS["95"])
HELD_SHARE_NOTE = (
    "Share of the cases in which what is stated holds, within bounds that all lines of the table keep to together with 99 %."
)
MEAN_NEES_NOTE = "Mean NEES by its degrees of freedom, within bounds that all lines keep to together with 99 %."
CONTROL_NOTE = "A control is known to be wrong, and must be found out."


class PromisesConfig(StudyConfig):
    """What the study runs; its plans and grades are its own."""

    cases: int = 1600

    @model_validator(mode="after")
    def _refuse_overrides(self) -> "PromisesConfig":
        if self.overrides or self.dispersions:
            raise ValueError("plans and grades are the study's own; overrides and dispersions have no effect")
        return self


def run_case(config: PromisesConfig, number: int, streams: Streams) -> list[Row]:
    """A row for each promise."""
    return cases.collect_statements(number, streams)


STUDY = Study("studies.validation.promises.study:STUDY", PromisesConfig, run_case)


def list_statements(rows: pd.DataFrame) -> pd.DataFrame:
    """A row for each covariance and level: promise, plan, grade, level, and whether the truth is inside."""
    limits = {level: scipy.special.chdtri(rows["dof"].to_numpy(float), 1 - level) for level in JUDGED}
    names = rows[["promise", "plan", "grade"]]
    parts = [names.assign(level=level, inside=rows["nees"] <= limit) for level, limit in limits.items()]
    return pd.concat(parts, ignore_index=True)


def compute_statement_coverage(said: pd.DataFrame, keys: Sequence[str]) -> pd.DataFrame:
    """A line for each promise, the keys and level: cases, share, its bounds, and whether the promise is kept."""
    groups = said.groupby(["promise", *keys, "level"], sort=False, observed=True)["inside"]
    out = groups.agg(cases="size", count="sum").reset_index()
    # A control is no line whose bounds are to be kept.
    lines = max(int((~out["promise"].isin(CONTROL_LINES)).sum()), 1)
    bounds = [
        compute_binomial_band(int(n), p, TABLE_CONFIDENCE, lines) for n, p in zip(out["cases"], out["level"], strict=True)
    ]
    low, high = np.array(bounds, dtype=float).reshape(-1, 2).T
    out["share"] = out["count"] / out["cases"]
    out["low"], out["high"] = low / out["cases"], high / out["cases"]
    out["verdict"] = np.where(out["count"] < low, TOO_SURE, np.where(out["count"] > high, TOO_CAUTIOUS, KEPT))
    return out.drop(columns="count")


def check_nees(rows: pd.DataFrame) -> pd.DataFrame:
    """A line for each covariance: mean NEES by its degrees of freedom with bounds; dof is that of all cases together."""
    tail = (1 - TABLE_CONFIDENCE) / (2 * max(rows["promise"].nunique(), 1))

    def line(part: pd.DataFrame) -> dict[str, object]:
        # The sum over the cases is χ² with the sum of their degrees of freedom, which differ where references do.
        dof = float(part["dof"].sum())
        low, high = scipy.special.chdtri(dof, [1 - tail, tail]) / dof
        value = float(part["nees"].sum()) / dof
        verdict = TOO_SURE if value > high else TOO_CAUTIOUS if value < low else KEPT
        return {"cases": len(part), "dof": dof, "nees_per_dof": value, "low": low, "high": high, "verdict": verdict}

    return summarise_groups(rows, ["promise"], line)


def report(config: PromisesConfig, rows: pd.DataFrame) -> Report:
    """All promises, over all plans and grades, and by each of them."""
    said = list_statements(rows)
    whole, by_plan, by_grade = (
        compute_statement_coverage(said, []),
        compute_statement_coverage(said, ["plan"]),
        compute_statement_coverage(said, ["grade"]),
    )
    cells, mean = compute_statement_coverage(said, ["plan", "grade"]), check_nees(rows)
    broken = cells[(cells["verdict"] != KEPT) & ~cells["promise"].isin(CONTROL_LINES)]
    grades = pd.DataFrame(
        [{"grade": name, "arw_deg_per_sqrt_s": arw, "sigma_deg": sigma} for name, (arw, sigma) in SENSOR_GRADES.items()]
    )
    tables = {
        "grades": Table("Grades of noise", grades, f"Each with the plans {', '.join(PLAN_NAMES)}."),
        "promises": Table("Over all plans and grades", whole, HELD_SHARE_NOTE),
        "nees": Table("Covariances: mean NEES", mean, MEAN_NEES_NOTE),
        "by_plan": Table("By plan", by_plan, shown=_widen_coverage(by_plan, "plan")),
        "by_grade": Table("By grade of noise", by_grade, shown=_widen_coverage(by_grade, "grade")),
        "cells": Table("Combinations of plan and grade that are outside their bounds", cells, shown=broken),
    }
    return Report(
        tables, {"coverage": _draw_coverage_figure(whole)}, _build_coverage_checks(whole, mean, by_plan, by_grade, cells)
    )


def _widen_coverage(table: pd.DataFrame, key: str) -> pd.DataFrame:
    """Shares at 95 % or the level stated, a column for each plan or grade, those outside their bounds marked."""
    own = table[~np.isclose(table["level"], SIGMA_LEVELS["68"])]
    text = [f"{100 * s:.1f} %{'' if v == KEPT else ' ' + v}" for s, v in zip(own["share"], own["verdict"], strict=True)]
    shown = own.assign(text=text).pivot_table(index="promise", columns=key, values="text", aggfunc="first", sort=False)
    return shown.fillna("").reset_index().rename_axis(columns=None)


def _build_coverage_checks(whole: pd.DataFrame, mean: pd.DataFrame, *parts: pd.DataFrame) -> tuple[Check, ...]:
    out = []
    names = [f"{row['promise']}, {100 * row['level']:.3g} %, of {row['cases']}" for row in whole.to_dict("records")]
    shares = whole.assign(name=names)
    means = mean.assign(name="mean NEES, " + mean["promise"])
    for table, value, unit, meaning in (
        (shares, "share", "", HELD_SHARE_NOTE),
        (means, "nees_per_dof", "NEES/dof", MEAN_NEES_NOTE),
    ):
        for row in table.to_dict("records"):
            control = row["promise"] in CONTROL_LINES
            told = CONTROL_NOTE if control else meaning
            out.append(Check(row["name"], row[value], (row["low"], row["high"]), unit, told, control))
    for name, table in zip(("plans", "grades", "combinations of both"), parts, strict=True):
        own = table[~table["promise"].isin(CONTROL_LINES)]
        outside = int((own["verdict"] != KEPT).sum())
        out.append(Check(f"lines outside their bounds by {name}, of {len(own)}", outside, (0, 0), "", HELD_SHARE_NOTE))
    return tuple(out)


def _draw_coverage_figure(whole: pd.DataFrame) -> Draw:
    """Share found less share stated of every promise, with its bounds."""
    own = whole[~whole["promise"].isin(CONTROL_LINES)].to_dict("records")

    def draw_on(axes: Axes) -> None:
        for place, row in enumerate(own):
            bounds = [row["low"] - row["level"], row["high"] - row["level"]]
            axes.plot(bounds, [place, place], color=panels.GREY, linewidth=5, alpha=0.35)
            colour = panels.TEAL if row["verdict"] == KEPT else panels.RED
            axes.plot(row["share"] - row["level"], place, "o", color=colour, markersize=3.5)

    names = [f"{row['promise']}, {100 * row['level']:.3g} %" for row in own]
    panel = panels.Panel(draw_on, "", "share found less share stated", "", at=[0.0], rows=names)
    return panels.build_sheet(panel, size=(7.6, 0.9 + 0.17 * len(own)))


ENTRY = Entry(STUDY, "does every covariance and interval that is stated hold, over plans and grades of noise", report)
