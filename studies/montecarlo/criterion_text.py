"""What --until and --require share: a criterion as text, a form with a limit, and the column it is of."""

import math
import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from gyrocal.errors import InputError, suggest_names
from studies.montecarlo.study import RESERVED


def match_criterion(form: re.Pattern[str], text: str, option: str, usage: str) -> tuple[re.Match[str], float]:
    """Match a criterion with a form whose group `limit` is a number, and read this limit.

    Raises
    ------
    InputError
        The text is not of that form, or its limit is no finite number; the error has the option and its usage.
    """
    match = form.fullmatch(text)
    try:
        limit = float(match["limit"]) if match else math.nan
    except ValueError:
        limit = math.nan
    if match is None or not math.isfinite(limit):
        raise InputError(f"{option} {text}: {usage}")
    return match, limit


def check_criterion_column(column: str, names: Iterable[str], values: Iterable[Any], option: str) -> None:
    """Check that a column is one of a study's own, and that its values are numbers or missing.

    Raises
    ------
    InputError
        There is no such column, or it holds no numbers.
    """
    known = [name for name in names if name not in RESERVED]
    if column not in known:
        raise InputError(f"{option}: {column}: the rows have no such column; {suggest_names(column, known)}")
    if not all(isinstance(value, bool | int | float | np.bool_ | np.number | None) for value in values):
        raise InputError(f"{option}: column {column} holds no numbers")
