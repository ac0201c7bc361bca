"""The result of a plan: smallest visible sizes, inseparable pairs, extra maneuvers, and all of it as JSON.

The thresholds of a plan are in `PlanSettings`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Progress = Callable[[str, float], None]

Verdict = Literal["visible", "implausible", "not identifiable", "not available"]


@dataclass(frozen=True)
class Visible:
    """Smallest visible size of one effect."""

    effect: str  # effect, axis, label, unit: which
    axis: str | None
    label: str
    unit: str
    verdict: Verdict  # whether it can be seen at a plausible size
    size: float  # seen with probability 0.9 at a typical phase and time; infinite if never
    best: float  # best, worst: at the best and the worst phase and time
    worst: float
    snr: float  # a‖x‖ at which that is so; NaN for random effects
    plausible: tuple[float, float]  # range of its size
    text: str = ""  # condition or reason


@dataclass(frozen=True)
class Pair:
    """An effect that is mistaken for another one."""

    effect: str  # effect, other: labels; `effect` acts and is mistaken for `other`
    other: str
    share: float  # ρ², NaN for random effects
    snr: float  # that tells them apart; infinite if nothing does, NaN for random effects
    size: float  # of `effect` that tells them apart, in its unit


@dataclass(frozen=True)
class Extra:
    """Improvements by an extra maneuver."""

    name: str  # of the maneuver
    hours: float  # it takes
    ratio: float  # smallest visible size with it over that without, median over the effects of the median over their axes
    by_effect: dict[str, float]  # the same by label, of effects that are visible with it
    resolved: tuple[tuple[str, str], ...]  # pairs that it makes separable, of `pairs`
    pairs: int  # inseparable pairs before
    gained: tuple[str, ...]  # effects that become visible at a plausible size


@dataclass(frozen=True)
class Plan:
    """The result of a plan."""

    scenario: str  # title
    false_alarm_rate: float  # false_alarm_rate, threshold: of the diagnosis, and the value of its statistic that stands for it
    threshold: float
    degrees_of_freedom: int  # beside the calibration
    effects: tuple[Visible, ...]  # smallest visible sizes, in the order of the registry
    pairs: tuple[Pair, ...]  # that cannot be told apart, the worst first
    extras: tuple[Extra, ...]  # the most helpful first
    notes: tuple[str, ...]  # limits of this scenario, in sentences
    runtime_s: float  # time taken

    def list_unordered_pairs(self) -> set[tuple[str, str]]:
        """List the inseparable pairs, each once."""
        return {order_pair(pair.effect, pair.other) for pair in self.pairs}

    def to_json(self) -> dict[str, Any]:
        """Return the document of `gyrocal plan --json`, format 1."""
        return {
            "format": 1,
            "scenario": self.scenario,
            "power": SETTINGS.power,
            "false_alarm_rate": self.false_alarm_rate,
            "threshold": self.threshold,
            "degrees_of_freedom": self.degrees_of_freedom,
            "effects": [{**vars(effect), "plausible": list(effect.plausible)} for effect in self.effects],
            "pairs": [dict(vars(item)) for item in self.pairs],
            "extras": [{**vars(extra), "resolved": [list(pair) for pair in extra.resolved]} for extra in self.extras],
            "notes": list(self.notes),
            "runtime_s": self.runtime_s,
        }


def order_pair(first: str, second: str) -> tuple[str, str]:
    """Sort a pair of labels, whichever is mistaken for the other."""
    return (first, second) if first < second else (second, first)


@dataclass(frozen=True)
class PlanSettings:
    """Thresholds and draws of a plan."""

    power: float = 0.9  # probability with which an effect of its smallest visible size is seen; a convention
    null_draws: int = 2000  # of M0, for the threshold of the statistic
    power_draws: int = 200  # of each effect; their 10 % point is good to 2 % of a size
    near: float = 0.1  # of the statistic; a size is good to 0.3 % then
    steps: int = 14  # of the solution for a size at most
    snr: float = 6.5  # that an effect usually needs, where solutions start
    # size of a random effect, in terms of its strength, where solutions start; it needs about the square root of the number of
    # ways it can be
    random: float = 4.0
    gone: float = 1e-6  # share of a signature that is left, below which it acts like the calibration itself; rounding
    log_odds: float = float(np.log(19.0))  # that tell two effects apart, of a probability of 0.95
    limit_snr: float = 20.0  # from which on a pair that needs it counts as inseparable; by judgement
    exact: float = 1e-7  # of 1 − ρ², below which columns are the same; rounding
    gap_orbits: float = 1.0  # between the scenario's end and an extra maneuver


SETTINGS = PlanSettings()
