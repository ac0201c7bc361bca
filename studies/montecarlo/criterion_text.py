"""What --until, --require and --rare share: a criterion as text, a form with a limit."""

import math
import re

from gyrocal.errors import InputError


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
