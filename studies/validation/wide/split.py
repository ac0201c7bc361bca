"""The split of the wide world: what sets thresholds, and what scores; ``split.json`` was fixed before any scored case was run.

A scored part serves for one look: once what it scored has been looked at in development, it is material that thresholds may be
set by. Parts were therefore replaced when what had been scored had been looked at. This is the third version: all families,
plans and grades that set thresholds or scored before are in the setting part, the scored part has new ones only, which no
development of the diagnosis has seen, and both have new numbers.

Families, kinds of plans and noise grades of one part are never those of the other, and every random stream of a case has its
part's own number in its name, so that no entropy makes a case of one part that of the other.
"""

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

PartName = Literal["setting", "scored"]
FILE = Path(__file__).with_name("split.json")


@dataclass(frozen=True)
class Part:
    """A part: names of families, kinds of plans and grades, and the number in the names of its random streams."""

    families: tuple[str, ...]
    plans: tuple[str, ...]
    grades: tuple[str, ...]
    entropy: int


@cache
def part(name: PartName) -> Part:
    """A part of the split."""
    found = json.loads(FILE.read_text(encoding="utf-8"))[name]
    return Part(tuple(found["families"]), tuple(found["plans"]), tuple(found["grades"]), int(found["entropy"]))
