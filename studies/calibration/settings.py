"""Kinds of settings that several studies have."""

from itertools import pairwise
from typing import Annotated

from pydantic import AfterValidator


def _check_different(value: tuple[float, ...]) -> tuple[float, ...]:
    if not value or min(value) <= 0 or len(set(value)) < len(value):
        raise ValueError("must be one or more different numbers above zero")
    return value


def _check_rising(value: tuple[float, ...]) -> tuple[float, ...]:
    if not value or value[0] <= 0 or any(b <= a for a, b in pairwise(value)):
        raise ValueError("must be one or more rising numbers above zero")
    return value


Different = Annotated[tuple[float, ...], AfterValidator(_check_different)]
Rising = Annotated[tuple[float, ...], AfterValidator(_check_rising)]
