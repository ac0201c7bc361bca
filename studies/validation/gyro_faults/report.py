"""How often the faulty gyro is named."""

from __future__ import annotations

import pandas as pd

from studies.montecarlo.statistics import binomial_interval, nees_line
from studies.report.checks import Check, at_least, at_most
from studies.report.entry import Entry, Report
from studies.report.tables import Table
from studies.validation.gyro_faults.cases import FOUR, NONE, STUDY, GyroFaultsConfig

NAMED, FALSE = 0.98, 0.02
PARAMETERS = {"six": 24, "tetrahedron": 16}
SHARED = (
    "Four gyros without reference attitudes have one parity residual, in which steps of any of the four look alike: there the "
    "right answer is a group, and what counts is that no other gyro is named."
)
COUNTED = (
    "Named: all that is said of gyros is of the faulty one; its kind may be a group or on no list. Wilson's 95 % intervals."
)


def told_apart(rows: pd.DataFrame) -> pd.Series:
    """Whether the data can tell the gyro: not a step of four gyros without references."""
    shared = (rows["gyros"] == FOUR) & ~rows["references"].astype(bool) & rows["fault"].isin(["step", "scale"])
    return ~shared & (rows["fault"] != NONE)


def shares(rows: pd.DataFrame, by: list[str], column: str) -> pd.DataFrame:
    """How often a column of truth values is true, a row a group."""
    out = []
    for key, own in rows.groupby(by, sort=False):
        hits = int(own[column].astype(bool).sum())
        low, high = binomial_interval(hits, len(own))
        values = dict(zip(by, key if isinstance(key, tuple) else (key,), strict=True))
        out.append({**values, "cases": len(own), column: hits, "share": hits / len(own), "low": low, "high": high})
    return pd.DataFrame(out, columns=[*by, "cases", column, "share", "low", "high"])


def share_check(name: str, rows: pd.DataFrame, column: str, bounds: tuple[float, float] | None, meaning: str = "") -> Check:
    """How often a column of truth values is true, as a check."""
    hits = int(rows[column].astype(bool).sum())
    value = hits / len(rows) if len(rows) else float("nan")
    return Check(f"{name}, {hits} of {len(rows)}", value, bounds, "", meaning)


def report(config: GyroFaultsConfig, rows: pd.DataFrame) -> Report:
    """Shares, false alarms, and the cases that were missed."""
    rows = rows[rows["error"].isna() | (rows["error"] == "")] if "error" in rows else rows
    sound, faulty = rows[rows["fault"] == NONE], rows[rows["fault"] != NONE]
    clear, shared = rows[told_apart(rows)], faulty[~told_apart(faulty)]
    bare = clear[~clear["references"].astype(bool)]
    checks = [
        share_check("faulty gyro named", clear, "named", at_least(NAMED), COUNTED),
        share_check("faulty gyro named without reference attitudes", bare, "named", at_least(NAMED)),
        share_check(
            "faulty gyro named with reference attitudes", clear[clear["references"].astype(bool)], "named", at_least(NAMED)
        ),
        share_check("kind of the fault stated, alone or in a group", clear, "kind", None),
        share_check("a sound gyro blamed", faulty, "wrong", at_most(FALSE)),
        share_check("alarms where nothing is wrong", sound, "alarm", at_most(FALSE)),
        share_check("steps of four gyros without references: fault in the group", shared, "kind", None, SHARED),
    ]
    lines = []
    for gyros, own in rows[rows["nees"].notna()].groupby("gyros", sort=False):
        line = nees_line(own["nees"], PARAMETERS[str(gyros)])
        lines.append({"gyros": gyros, **line})
        bounds = (line["low"], line["high"])
        checks.append(Check(f"mean NEES of the calibration, {gyros}", line["nees_per_dof"], bounds, "NEES/dof"))
    missed = clear[~clear["named"].astype(bool)]
    columns = ["case", "gyros", "references", "fault", "gyro", "snr", "size", "time_s", "verdict", "said", "found"]
    tables = {
        "named": Table("Named, by set-up and fault", shares(faulty, ["gyros", "references", "fault"], "named"), SHARED),
        "kinds": Table(
            "Kind of the fault stated, alone or in a group", shares(faulty, ["gyros", "references", "fault"], "kind")
        ),
        "alarms": Table("Alarms where nothing is wrong", shares(sound, ["gyros", "references"], "alarm")),
        "missed": Table("Not named though the data tell the gyro", missed[columns]),
        "nees": Table("Calibration of the same recordings without the fault", pd.DataFrame(lines)),
        "cost": Table("CPU of a diagnosis", _cost(rows)),
    }
    return Report(tables, {}, tuple(checks))


def _cost(rows: pd.DataFrame) -> pd.DataFrame:
    """Median and largest CPU seconds by set-up."""
    found = rows.groupby(["gyros", "references"], sort=False)["cpu_s"].agg(["median", "max"]).reset_index()
    return found.rename(columns={"median": "median_s", "max": "largest_s"})


ENTRY = Entry(STUDY, "is the faulty one of several gyros named, also without reference attitudes", report)
