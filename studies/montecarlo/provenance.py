"""What rows were made with, sources and machine, and whether others may stand beside them."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from studies.montecarlo.machine import machine
from studies.montecarlo.sources import sources
from studies.montecarlo.study import Study

SHOWN = 4  # differences that a message names


@dataclass(frozen=True)
class MadeWith:
    """Sources by path and their hashes, and what `studies.montecarlo.machine` says, as plain values."""

    sources: dict[str, str]
    machine: dict[str, str]

    def as_dict(self) -> dict[str, dict[str, str]]:
        """For a manifest."""
        return asdict(self)


def made_with(study: Study) -> MadeWith:
    """What a study's rows are made with in this process."""
    return MadeWith(sources(study), machine())


def edited(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Paths of the sources that differ, or are there only before or now."""
    return [path for path in sorted({*before, *now}) if before.get(path) != now.get(path)]


def changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Every value that differs, as "key: old → new"; – where there is none."""
    old, new = _flat(before), _flat(now)
    keys = list(dict.fromkeys([*old, *new]))
    return [f"{key}: {old.get(key, '–')} → {new.get(key, '–')}" for key in keys if old.get(key, "–") != new.get(key, "–")]


def listed(items: list[str]) -> str:
    """The first of some items, and how many more there are."""
    more = len(items) - SHOWN
    return ", ".join(items[:SHOWN]) + (f" and {more} more" if more > 0 else "")


def _flat(value: Any, path: str = "") -> dict[str, Any]:
    """The single values of nested dictionaries and lists by dotted path; empty ones are none."""
    items = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list | tuple) else None
    if items is None:
        return {path: value}
    return {key: one for name, item in items for key, one in _flat(item, f"{path}.{name}" if path else str(name)).items()}
