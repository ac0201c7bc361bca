"""What a study finds, as data: a named number, the bounds it is held to, and the verdict that follows from them.

A check with bounds passes or fails; one without is a note. It repeats no cell of a table. Controls, which are known to be
wrong, pass where they are outside the bounds of what is right. The renderer is the one of all tables; explanations are constant
sentences, one a kind of check.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import pandas as pd

from studies.montecarlo.criteria import Answer
from studies.report.tables import NO_VALUE, format_number

Verdict = Literal["pass", "fail", "note"]
Bounds = tuple[float, float]

REQUIREMENT_NOTE = (
    "The confidence of a requirement holds for a number of cases chosen beforehand; each further look at its answer adds risk."
)


@dataclass(frozen=True)
class Check:
    """A finding."""

    name: str  # of the quantity, in words
    value: float | str  # a number, NaN where the rows do not say; or a word
    # lowest and highest value that passes, infinite where there is none; the word to be; None for a note
    bounds: Bounds | str | None = None
    unit: str = ""  # of value and bounds
    meaning: str = ""  # a sentence that explains checks of this kind
    outside: bool = False  # whether the value must be outside its bounds, as for a control

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
    """Return the bounds of a value that may be at most a limit."""
    return (-math.inf, limit)


def bound_below(limit: float) -> Bounds:
    """Return the bounds of a value that must be at least a limit."""
    return (limit, math.inf)


def bound_near(expected: float, tolerance: float) -> Bounds:
    """Return the bounds of a value that must be as expected, within a tolerance."""
    return (expected - tolerance, expected + tolerance)


def check_extremes(
    name: str, values: Iterable[float], bounds: Bounds | None = None, unit: str = "", meaning: str = ""
) -> list[Check]:
    """Check the smallest and the largest of some values, NaN left out."""
    series = pd.Series(values, dtype=float)
    return [
        Check(f"{name}, {extreme}", float(value), bounds, unit, meaning)
        for extreme, value in (("smallest", series.min()), ("largest", series.max()))
    ]


def check_requirements(answers: Iterable[Answer]) -> list[Check]:
    """Build a check for each answer; a note if it is undecided."""
    return [
        Check(answer.requirement, answer.outcome, None if answer.outcome == "undecided" else "met", meaning=REQUIREMENT_NOTE)
        for answer in answers
    ]


def build_check_frame(checks: Iterable[Check]) -> pd.DataFrame:
    """Build a row a check, with unformatted numbers."""
    rows = []
    for check in checks:
        lower, upper = check.bounds if isinstance(check.bounds, tuple) else (math.nan, math.nan)
        expected_word = check.bounds if isinstance(check.bounds, str) else ""
        row = {"check": check.name, "value": check.value, "unit": check.unit, "lower": lower, "upper": upper}
        rows.append(row | {"wanted": expected_word, "outside": check.outside, "verdict": check.verdict})
    return pd.DataFrame(rows)


def format_checks(checks: Iterable[Check]) -> pd.DataFrame:
    """Format the checks as texts for people, a row a check."""
    rows = []
    for check in checks:
        value = check.value if isinstance(check.value, str) else format_number(check.value)
        row = {"check": check.name, "value": value, "unit": check.unit}
        rows.append(row | {"asked": _format_bounds(check), "verdict": check.verdict})
    return pd.DataFrame(rows)


def _format_bounds(check: Check) -> str:
    """Format the bounds in words."""
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
    """List the explanations of some checks, each once."""
    return list(dict.fromkeys(check.meaning for check in checks if check.meaning))
