"""Conditions on which a command ends with status 3, for scripts, and the same as JUnit's XML, for what shows test results."""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from gyrocal import InputError
from studies.report.junit import Verdict, write_junit

STATUS = 3
CONDITION = re.compile(r"\s*(\w+)\s*([<>])\s*(\S+)\s*")


def compared(texts: Sequence[str], known: Mapping[str, float]) -> list[Verdict]:
    """Conditions such as "p<0.001" on numbers by name; one on a number that is not known is met, since it cannot be ruled out.

    Raises
    ------
    InputError
        A text is no condition on one of the numbers.
    """
    out = []
    for text in texts:
        name, sign, limit = parsed(text, known)
        value = known[name]
        met = not (value >= limit if sign == "<" else value <= limit)
        what = "is not known" if math.isnan(value) else f"is {value:.4g}"
        out.append(Verdict(text.strip(), f"{name} {what}" if met else ""))
    return out


def parsed(text: str, names: Sequence[str] | Mapping[str, float]) -> tuple[str, str, float]:
    """Name, sign and limit of a condition.

    Raises
    ------
    InputError
        It is none, or on something else.
    """
    match = CONDITION.fullmatch(text)
    try:
        if match is None or match[1] not in names:
            raise ValueError
        limit = float(match[3])
        if math.isnan(limit):
            raise ValueError
    except ValueError:
        raise InputError(f"--fail-on {text}: give NAME<LIMIT or NAME>LIMIT, where NAME is {' or '.join(names)}") from None
    return match[1], match[2], limit


def end(command: str, subject: str, verdicts: Sequence[Verdict], junit: Path | None) -> None:
    """Write the verdicts if asked for, and leave with status 3 if one of them is a failure.

    Raises
    ------
    SystemExit
        One is.
    """
    if junit:
        write_junit(junit, f"gyrocal {command}", subject, verdicts)
    if any(one.failure for one in verdicts):
        raise SystemExit(STATUS)
