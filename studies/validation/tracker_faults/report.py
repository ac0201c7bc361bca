"""How often the tracker that errs, and what it does, is named."""

from __future__ import annotations

import pandas as pd

from studies.report.checks import Check, at_most
from studies.report.entry import Entry, Report
from studies.report.tables import Table
from studies.validation.gyro_faults.report import share_check, shares
from studies.validation.tracker_faults.cases import NONE, STUDY, TrackerFaultsConfig

FALSE = 0.02
COUNTED = "Named: one cause, and the effect of this tracker is among its alternatives. Wilson's 95 % intervals."
WRONG = "A cause that has not got the effect of this tracker among its alternatives."
SHOWN = ["case", "plan", "effect", "tracker", "size", "parameters", "snr", "verdict", "said", "unknown_probability"]


def report(config: TrackerFaultsConfig, rows: pd.DataFrame) -> Report:
    """Shares, false alarms, and the cases that were not named."""
    sound, faulty = rows[rows["effect"] == NONE], rows[rows["effect"] != NONE]
    checks = [
        share_check("effect of one tracker named, alone or in a group", faulty, "named", None, COUNTED),
        share_check("and alone", faulty, "alone", None),
        share_check("a confident wrong name", faulty, "wrong", at_most(FALSE), WRONG),
        share_check("alarms where nothing is wrong", sound, "alarm", at_most(FALSE)),
    ]
    sized = faulty["size_in_sigma"].dropna().astype(float)
    checks.append(Check("size of what is named alone within 4 sigma", float((sized.abs() <= 4).mean()), None))
    tables = {
        "named": Table("Named, by effect", shares(faulty, ["effect"], "named"), COUNTED),
        "wrong": Table("Wrong, by effect", shares(faulty, ["effect"], "wrong"), WRONG),
        "plans": Table("Named, by plan", shares(faulty, ["plan"], "named")),
        "alarms": Table("Alarms where nothing is wrong", shares(sound, ["plan"], "alarm")),
        "missed": Table("Not named", faulty[~faulty["named"].astype(bool)][SHOWN]),
    }
    return Report(tables, {}, tuple(checks))


ENTRY = Entry(STUDY, "is the star tracker that errs named, and what it does?", report)
