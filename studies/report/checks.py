"""What a study finds, as data: a named number, the bounds it is held to, and the verdict that follows from them.

A check with bounds passes or fails; one without is a note. It repeats no cell of a table. Controls, which are known to be
wrong, pass where they are outside the bounds of what is right. The renderer is the one of all tables; explanations are constant
sentences, one a kind of check.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import pandas as pd

from studies.montecarlo.requirement import Answer
from studies.montecarlo.statistics import CONSISTENT
from studies.report.tables import NO_VALUE, format_number
from studies.report.units import format_heading

Verdict = Literal["pass", "fail", "note"]
Bounds = tuple[float, float]

ENOUGH = 50  # cases of a line, below which its bounds let most things pass
CONTROL_NEES_NOTE = (
    "The mean NEES over the cases by its degrees of freedom; a control must be outside the bounds of a consistent one."
)
REQUIREMENT_NOTE = (
    "The confidence of a requirement holds for a number of cases chosen beforehand; each further look at its answer adds risk."
)
FEW_CASES_NOTE = f"With fewer than {ENOUGH} cases the bounds are so wide that most covariances are within them."


@dataclass(frozen=True)
class Check:
    """A finding.

    Attributes
    ----------
    name : what was found, in words
    value : a number, NaN where the rows do not say; or a word
    bounds : lowest and highest value that passes, infinite where there is none; the word to be; None for a note
    unit : of value and bounds
    meaning : a sentence that says how to read checks of this kind
    outside : whether the value must be outside its bounds, as that of a control
    """

    name: str
    value: float | str
    bounds: Bounds | str | None = None
    unit: str = ""
    meaning: str = ""
    outside: bool = False

    @property
    def verdict(self) -> Verdict:
        """Whether the value is as it should be; a note without bounds, and where the rows say neither value nor bounds."""
        if self.bounds is None:
            return "note"
        if isinstance(self.bounds, str) or isinstance(self.value, str):
            inside = self.value == self.bounds
        elif any(math.isnan(number) for number in (self.value, *self.bounds)):
            return "note"
        else:
            inside = self.bounds[0] <= self.value <= self.bounds[1]
        return "pass" if inside != self.outside else "fail"


def bound_above(limit: float) -> Bounds:
    """Bounds of a size that may be anything up to a limit."""
    return (-math.inf, limit)


def bound_below(limit: float) -> Bounds:
    """Bounds of a value that must reach a limit."""
    return (limit, math.inf)


def bound_near(expected: float, room: float) -> Bounds:
    """Bounds of a value that must be as expected, within some room."""
    return (expected - room, expected + room)


def check_extremes(
    name: str, values: Iterable[float], bounds: Bounds | None = None, unit: str = "", meaning: str = ""
) -> list[Check]:
    """The smallest and the largest of some values, NaN left out."""
    series = pd.Series(values, dtype=float)
    return [
        Check(f"{name}, {which}", float(value), bounds, unit, meaning)
        for which, value in (("smallest", series.min()), ("largest", series.max()))
    ]


def format_expectation(consistent: bool | None) -> str:
    """Column "expected" of a line whose covariance must be consistent, must not be, or may be either."""
    return {None: "", True: CONSISTENT, False: f"not {CONSISTENT}"}[consistent]


def check_nees_rows(table: pd.DataFrame, keys: Sequence[str], prefix: str = "", of: str = "") -> list[Check]:
    """A check for each line of a table of mean NEES that is expected to be consistent, or not to be.

    Parameters
    ----------
    table : the keys, and {prefix}nees_per_dof, {prefix}low, {prefix}high and {prefix}expected
    keys : columns that name a line
    prefix : of those columns
    of : what the NEES is of, to be added to the names
    """
    out = []
    for row in table[table[f"{prefix}expected"] != ""].to_dict("records"):
        names = [f"{format_heading(key)} {row[key]:g}" if isinstance(row[key], float) else str(row[key]) for key in keys]
        name = ", ".join([*names, of] if of else names)
        bounds = (row[f"{prefix}low"], row[f"{prefix}high"])
        outside = row[f"{prefix}expected"] != CONSISTENT
        out.append(Check(name, row[f"{prefix}nees_per_dof"], bounds, "NEES/dof", CONTROL_NEES_NOTE, outside))
    return out


def check_requirements(answers: Iterable[Answer]) -> list[Check]:
    """A check for each answer; a note if it is undecided."""
    out = []
    for answer in answers:
        bounds = None if answer.outcome == "undecided" else "met"
        out.append(Check(answer.requirement, answer.outcome, bounds, meaning=REQUIREMENT_NOTE))
    return out


def check_case_count(*tables: pd.DataFrame) -> Check:
    """Whether every line of tables with a column "cases" rests on so many that its bounds tell something."""
    fewest = min((float(table["cases"].min()) for table in tables if len(table)), default=math.nan)
    return Check("cases of the line with the fewest", fewest, bound_below(ENOUGH), "", FEW_CASES_NOTE)


def build_check_frame(checks: Iterable[Check]) -> pd.DataFrame:
    """A row a check, with numbers as they are."""
    rows = []
    for check in checks:
        lower, upper = check.bounds if isinstance(check.bounds, tuple) else (math.nan, math.nan)
        wanted = check.bounds if isinstance(check.bounds, str) else ""
        row = {"check": check.name, "value": check.value, "unit": check.unit, "lower": lower, "upper": upper}
        rows.append(row | {"wanted": wanted, "outside": check.outside, "verdict": check.verdict})
    return pd.DataFrame(rows)


def format_checks(checks: Iterable[Check]) -> pd.DataFrame:
    """A row a check, as texts for people."""
    rows = []
    for check in checks:
        value = check.value if isinstance(check.value, str) else format_number(check.value)
        rows.append(
            {"check": check.name, "value": value, "unit": check.unit, "asked": _format_bounds(check), "verdict": check.verdict}
        )
    return pd.DataFrame(rows)


def _format_bounds(check: Check) -> str:
    """The bounds in words."""
    if check.bounds is None:
        return NO_VALUE
    if isinstance(check.bounds, str):
        return f"not {check.bounds}" if check.outside else check.bounds
    low, high = check.bounds
    if math.isinf(low):
        text = f"at most {format_number(high)}"
    elif math.isinf(high):
        text = f"at least {format_number(low)}"
    else:
        text = format_number(low) if low == high else f"{format_number(low)} to {format_number(high)}"
    return f"outside {text}" if check.outside else text


def list_meanings(checks: Iterable[Check]) -> list[str]:
    """The sentences of some checks, each once."""
    return list(dict.fromkeys(check.meaning for check in checks if check.meaning))
