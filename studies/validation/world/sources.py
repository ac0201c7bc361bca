"""Where cases come from: effects outside the library, kinds of plans, and grades of gyros and references.

- ``known``: what the diagnosis was developed with. Its cases set thresholds and never score a published figure.
- ``fresh``: written from the formats and the list of effects alone, without sight of the diagnosis. During development only
  counts of its cases are looked at.
- ``exam/NNN``: the families and plans of a first-sight exam (`studies.validation.exam`), written after a code freeze.

Every random stream of a case has its source's name in its own, so that no entropy makes a case of one source that of another.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from gyrocal.errors import InputError
from studies.validation.world import standard
from studies.validation.world.families import FAMILIES
from studies.validation.world.families.base import Family
from studies.validation.world.kinds import Grade, Kind

SOURCE_MODULES = {"fresh": "studies.validation.world.fresh"}
EXAM_PREFIX = "exam/"


@dataclass(frozen=True)
class Source:
    """What cases are drawn from, each by its name."""

    families: Mapping[str, Family]
    plans: Mapping[str, Kind]
    grades: Mapping[str, Grade]


@cache
def find_source(name: str) -> Source:
    """Find a source by its name.

    Raises
    ------
    InputError
        There is none of that name.
    """
    if name == "known":
        return Source(FAMILIES, standard.KINDS, standard.GRADES)
    folder = SOURCE_MODULES.get(name) or (
        f"studies.validation.exam.{name.removeprefix(EXAM_PREFIX)}" if name.startswith(EXAM_PREFIX) else ""
    )
    try:
        families, plans = (importlib.import_module(f"{folder}.{part}") for part in ("families", "plans"))
    except ImportError:
        raise InputError(
            f"{name}: no such source of cases; there are known, {', '.join(SOURCE_MODULES)} and {EXAM_PREFIX}NNN"
        ) from None
    return Source({one.name: one for one in families.EFFECTS}, plans.KINDS, plans.GRADES)
