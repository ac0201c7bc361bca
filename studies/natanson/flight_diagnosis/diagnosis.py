"""A table's diagnosis: is there a gap, what explains it, how far does it close.

The common search, attribution, amplitudes and closure do the inference. What is added here is the iteration: timings act
nonlinearly, so the model is linearised again about what was found until nothing changes, each timing about its likeliest
values beside the other effects of the best explanation.

A kind of effect is a cause if the explanations with it have a probability of `SURE` or more together, also where something
unlisted remains beside it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.answer import Closure, Verdict
from diagnosis.inference.amplitudes import Fitted, fit
from diagnosis.inference.attribution import Attribution, attribute
from diagnosis.inference.closure import compute_closure
from diagnosis.inference.search import Search
from diagnosis.model.linear import LinearModel, Member
from diagnosis.settings import DEFAULT
from studies.natanson.flight_diagnosis.builder import NOISE, RATE, SPLITS, TIMING, YAW, Point, linear_model, moved
from studies.natanson.flight_diagnosis.numbers import gap_test, motion, noise_factor
from studies.natanson.flight_diagnosis.table import Baseline, Table
from studies.natanson.flight_diagnosis.timings import TIMINGS
from studies.printed_table import UNKNOWN, rank_explanations

Array = NDArray[np.float64]
Effects = frozenset[str]

SURE = 0.95
FALSE_ALARM = 0.01
NOTHING = 0.2  # prior share of chance alone, as likely beforehand as one kind of effect
ROUNDS = 5  # of search and new linearisation
ITERATIONS = 10  # of the linearisation, between two searches
SETTLED = 0.01  # of a timing between zero and one


@dataclass(frozen=True)
class Diagnosis:
    """What is found in a table under a baseline.

    Attributes
    ----------
    gap : tests of the motion's and the noise's numbers
    verdict : "none", "named", "group" or "unknown"
    causes : effects with a probability of `SURE`, "unknown" left out
    sets : probability of each set of effects, the likeliest first, whatever their axes
    fitted : effects of the likeliest explanation, unlisted ones included
    noise : mean and sigma of the noise over the baseline's
    closed : by the likeliest explanation with the amplitudes that the other numbers give it, of each of `SPLITS`; empty
        without a gap
    before, after : (18,) d without and with the listed effects of the likeliest explanation, deg
    covariance : (18, 18) that print leaves of `after`, deg²
    """

    gap: Mapping[str, float]
    verdict: Verdict
    causes: tuple[str, ...]
    sets: Mapping[Effects, float]
    fitted: tuple[Fitted, ...]
    noise: tuple[float, float]
    closed: Mapping[str, Closure]
    before: Array
    after: Array
    covariance: Array

    def includes(self, effect: str) -> float:
        """Probability that an effect is at work."""
        return sum(p for effects, p in self.sets.items() if effect in effects)

    @property
    def best(self) -> str:
        """The likeliest explanation in words."""
        return " + ".join(one.label for one in self.fitted) or "nothing"

    @property
    def group(self) -> list[Effects]:
        """Sets of effects that hold `SURE` of the probability together, the likeliest first; none without a gap."""
        kept, reached = [], 0.0
        for effects, p in self.sets.items() if self.verdict != "none" else ():
            if reached < SURE:
                kept.append(effects)
            reached += p
        return kept


def diagnose(table: Table, baseline: Baseline) -> Diagnosis:
    """Diagnose a table; without a gap nothing is searched."""
    gap = gap_test(table, baseline)
    case = motion(table, baseline)
    noise = noise_factor(table, case.Theta, baseline)[1:]
    if gap["p_value"] > FALSE_ALARM:
        return Diagnosis(gap, "none", (), {frozenset(): 1.0}, (), noise, {}, case.d, case.d, case.covariance)
    model, attribution, point = explained(table, baseline)
    best = attribution.ranked[0].labels
    members = [_member(model, label) for label in best]
    fitted = tuple(fit(model, members))
    known = [one for one in fitted if not one.effect.startswith(UNKNOWN)]
    last = motion(table, baseline, point.flips)
    explains = sum((np.linalg.cholesky(last.covariance) @ one.contribution for one in known), np.zeros(case.d.size))
    held = Search(model).settled(tuple(members)).members
    closed = {split: compute_closure(linear_model(table, baseline, point, split), held) for split in SPLITS}
    sets: dict[Effects, float] = defaultdict(float)
    for one in attribution.ranked:
        sets[frozenset(UNKNOWN if label.startswith(UNKNOWN) else label.split(":")[0] for label in one.labels)] += (
            one.probability
        )
    causes = tuple(name for name in (YAW, RATE, TIMING, NOISE) if sum(p for own, p in sets.items() if name in own) >= SURE)
    return Diagnosis(
        gap=gap,
        verdict="named" if causes else "unknown" if attribution.unknown > DEFAULT.unknown else "group",
        causes=causes,
        sets=dict(sorted(sets.items(), key=lambda item: -item[1])),
        fitted=fitted,
        noise=noise,
        closed={split: one for split, one in closed.items() if one is not None},
        before=case.d,
        after=case.d - explains,
        covariance=last.covariance,
    )


def explained(table: Table, baseline: Baseline) -> tuple[LinearModel, Attribution, Point]:
    """The last of the models, what its explanations amount to, and what it is linearised about."""
    point, found = Point(), tuple[str, ...]()
    for _ in range(ROUNDS):
        point = settled(table, baseline, point, found)
        model = linear_model(table, baseline, point)
        attribution = attribute(model, rank_explanations(model, NOTHING))
        best = tuple(label for label in attribution.ranked[0].labels if not label.startswith(UNKNOWN))
        if set(best) == set(found):
            break
        found = best
        flips = frozenset(int(label.split(":")[1]) - 1 for label in best if label.split(":")[0] in (YAW, RATE))
        point = Point(flips, point.timings)
    return model, attribution, point


def settled(table: Table, baseline: Baseline, point: Point, found: tuple[str, ...]) -> Point:
    """Each timing's point moved to its likeliest values, beside the other effects that were found, or instead of theirs.

    A timing that was not found may stand for those that were: it is tried beside the directions that were found alone.
    """
    for _ in range(ITERATIONS):
        model = linear_model(table, baseline, point)
        new = point
        for one in TIMINGS:
            label = f"{TIMING}:{one.axis}"
            others = [_member(model, o) for o in found if o != label and (label in found or not o.startswith(TIMING))]
            new = moved(new, fit(model, [*others, _member(model, label)])[-1])
        change = max(float(np.abs(new.timings[axis] - u).max()) for axis, u in point.timings.items())
        point = new
        if change < SETTLED:
            break
    return point


def _member(model: LinearModel, label: str) -> Member:
    place = model.find(label)
    assert place is not None
    return Member(place, 0, 0)
