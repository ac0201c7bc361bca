"""Levels of an answer: side, axis and character of the error in one place of an explanation, each with its probability.

A recording often shows on which side and about which axis an error acts, and how it behaves, although it cannot identify the
effect. The posterior of a place (`diagnosis.inference.joint_search.Place`) is summed over all candidates of one side, axis and
character, listed or not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple

from diagnosis.model.linear import Candidate
from simulator.effects.base import Effect

Side = Literal["gyro", "references", "clocks", "samples"]
Character = Literal[
    "constant per interval", "step", "jumps", "slow random", "follows a rate", "follows a temperature", "periodic", "noise",
    "faults of samples", "trend",
]  # fmt: skip

SIDES: dict[str, Side] = {  # of the stages of the measuring chain
    "rate": "gyro",
    "random_rate": "gyro",
    "filter": "clocks",
    "clock": "clocks",
    "reference": "references",
    "random_reference": "references",
    "reference_noise": "references",
    "reference_telemetry": "references",
}
# Words in the name of an effect or of a family outside the library, and the character that they say; the first one counts.
CHARACTERS: tuple[tuple[str, Character], ...] = (
    ("jump", "jumps"),
    ("step", "step"),
    ("slip", "step"),
    ("flight directions", "constant per interval"),
    ("mode_offset", "constant per interval"),
    ("in each interval", "constant per interval"),
    ("between intervals", "constant per interval"),
    ("temperature", "follows a temperature"),
    ("housekeeping", "follows a temperature"),
    ("period", "periodic"),
    ("orbit", "periodic"),
    ("horizon", "periodic"),
    ("wanders", "slow random"),
    ("random", "slow random"),
    ("noise", "noise"),
    ("offset", "constant per interval"),
    ("drift", "trend"),
    ("time", "trend"),
    ("settles", "trend"),
)


class Level(NamedTuple):
    """One level of an answer: its name, and its probability."""

    name: str
    probability: float


class Levels(NamedTuple):
    """Side, axis and character of one place; the axis is None where nothing has one."""

    side: Level
    axis: Level | None
    character: Level

    def to_json(self) -> dict[str, Any]:
        """Return the levels as in the documented format."""
        return {name: None if level is None else level._asdict() for name, level in self._asdict().items()}


def find_side(candidate: Candidate, effects: Mapping[str, Effect]) -> Side:
    """Find the side on which a candidate acts; of a family outside the library by its name."""
    if candidate.effect in effects:
        return SIDES.get(effects[candidate.effect].stage, "samples")
    if candidate.effect.startswith("time tags"):
        return "clocks"
    return "references" if candidate.effect.startswith("references") else "gyro"


def find_character(candidate: Candidate) -> Character:
    """Find how the error of a candidate behaves."""
    if candidate.process:
        return "slow random"
    return next((character for word, character in CHARACTERS if word in candidate.effect), "follows a rate")


def compute_levels(shares: Mapping[int, float], candidates: tuple[Candidate, ...], effects: Mapping[str, Effect]) -> Levels:
    """Sum the posterior of a place over sides, axes and characters.

    Parameters
    ----------
    shares : probability of each candidate by its number
    candidates : of the model
    effects : listed effects by name
    """

    def choose(name_of: Callable[[Candidate], str | None]) -> Level | None:
        sums: dict[str, float] = {}
        for number, share in shares.items():
            name = name_of(candidates[number])
            if name is not None:
                sums[name] = sums.get(name, 0.0) + share
        return Level(*max(sums.items(), key=lambda item: item[1])) if sums else None

    side, character = choose(lambda candidate: find_side(candidate, effects)), choose(find_character)
    assert side is not None  # every candidate has one, and a character
    assert character is not None
    return Levels(side, choose(lambda candidate: candidate.axis), character)
