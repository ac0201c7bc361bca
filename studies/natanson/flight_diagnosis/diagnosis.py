"""A table's diagnosis: is there a gap, what explains it, how far does it close.

The common search, attribution, amplitudes and closure do the inference. What is added here is the iteration: timings act
nonlinearly, so the model is linearised again about what was found until nothing changes, each timing about its likeliest
values beside the other effects of the best explanation.

A kind of effect is a cause if the explanations with it have a probability of `NAMING_PROBABILITY` or more together, also where
something unlisted remains beside it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.answer import Closure, Verdict
from diagnosis.inference.amplitudes import FittedEffect, fit
from diagnosis.inference.attribution import Attribution, rank_all
from diagnosis.inference.closure import compute_closure
from diagnosis.inference.search import Search
from diagnosis.model.linear import LinearModel, SelectedCandidate
from diagnosis.settings import DEFAULT
from studies.natanson.flight_diagnosis.builder import (
    NOISE,
    RATE,
    SPLITS,
    TIMING,
    YAW,
    LinearisationPoint,
    build_flight_model,
    move_point,
)
from studies.natanson.flight_diagnosis.misfit_numbers import compute_misfit_p, compute_motion_numbers, estimate_noise_level
from studies.natanson.flight_diagnosis.table import Baseline, ResidualTable
from studies.natanson.flight_diagnosis.timings import TIMINGS
from studies.printed_table import UNKNOWN_NAME, rank_explanations

Array = NDArray[np.float64]
Effects = frozenset[str]

NAMING_PROBABILITY = 0.95
FALSE_ALARM = 0.01
PRIOR_OF_CHANCE = 0.2  # prior share of chance alone, as likely beforehand as one kind of effect
SEARCH_ROUNDS = 5  # of search and new linearisation
LINEARISATION_ITERATIONS = 10  # of the linearisation, between two searches
CONVERGED_TIMING = 0.01  # of a timing between zero and one


@dataclass(frozen=True)
class TableDiagnosis:
    """What is found in a table under a baseline."""

    gap: Mapping[str, float]  # tests of the motion's and the noise's numbers
    verdict: Verdict  # "none", "named", "group" or "unknown"
    causes: tuple[str, ...]  # effects with a probability of `NAMING_PROBABILITY`, "unknown" left out
    sets: Mapping[Effects, float]  # probability of each set of effects, the likeliest first, whatever their axes
    fitted: tuple[FittedEffect, ...]  # effects of the likeliest explanation, unlisted ones included
    noise: tuple[float, float]  # mean and sigma of the noise over the baseline's
    # by the likeliest explanation with the amplitudes that the other numbers give it, of each of `SPLITS`; empty without a gap
    closed: Mapping[str, Closure]
    before: Array  # before, after: (18,) d without and with the listed effects of the likeliest explanation, deg
    after: Array
    covariance: Array  # (18, 18) that print leaves of `after`, deg²

    def includes(self, effect: str) -> float:
        """Probability that an effect is at work."""
        return sum(p for effects, p in self.sets.items() if effect in effects)

    @property
    def best(self) -> str:
        """The likeliest explanation in words."""
        return " + ".join(one.label for one in self.fitted) or "nothing"

    @property
    def group(self) -> list[Effects]:
        """List the likeliest sets of effects that together hold `NAMING_PROBABILITY`; none without a misfit."""
        kept, reached = [], 0.0
        for effects, p in self.sets.items() if self.verdict != "none" else ():
            if reached < NAMING_PROBABILITY:
                kept.append(effects)
            reached += p
        return kept


def diagnose(table: ResidualTable, baseline: Baseline) -> TableDiagnosis:
    """Diagnose a table; without a gap nothing is searched."""
    gap = compute_misfit_p(table, baseline)
    case = compute_motion_numbers(table, baseline)
    noise = estimate_noise_level(table, case.Theta, baseline)[1:]
    if gap["p_value"] > FALSE_ALARM:
        return TableDiagnosis(gap, "none", (), {frozenset(): 1.0}, (), noise, {}, case.d, case.d, case.covariance)
    model, attribution, point = search_with_relinearisation(table, baseline)
    best = attribution.ranked[0].labels
    members = [_find_member(model, label) for label in best]
    fitted = tuple(fit(model, members))
    known = [one for one in fitted if not one.effect.startswith(UNKNOWN_NAME)]
    last = compute_motion_numbers(table, baseline, point.flips)
    explains = sum((np.linalg.cholesky(last.covariance) @ one.contribution for one in known), np.zeros(case.d.size))
    held = Search(model).optimise_members(tuple(members)).members
    closed = {split: compute_closure(build_flight_model(table, baseline, point, split), held) for split in SPLITS}
    sets: dict[Effects, float] = defaultdict(float)
    for one in attribution.ranked:
        sets[frozenset(UNKNOWN_NAME if label.startswith(UNKNOWN_NAME) else label.split(":")[0] for label in one.labels)] += (
            one.probability
        )
    causes = tuple(
        name for name in (YAW, RATE, TIMING, NOISE) if sum(p for own, p in sets.items() if name in own) >= NAMING_PROBABILITY
    )
    return TableDiagnosis(
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


def search_with_relinearisation(
    table: ResidualTable, baseline: Baseline
) -> tuple[LinearModel, Attribution, LinearisationPoint]:
    """The last of the models, what its explanations amount to, and what it is linearised about."""
    point, found = LinearisationPoint(), tuple[str, ...]()
    for _ in range(SEARCH_ROUNDS):
        point = relinearise_timings(table, baseline, point, found)
        model = build_flight_model(table, baseline, point)
        attribution = rank_all(model, rank_explanations(model, PRIOR_OF_CHANCE))
        best = tuple(label for label in attribution.ranked[0].labels if not label.startswith(UNKNOWN_NAME))
        if set(best) == set(found):
            break
        found = best
        flips = frozenset(int(label.split(":")[1]) - 1 for label in best if label.split(":")[0] in (YAW, RATE))
        point = LinearisationPoint(flips, point.timings)
    return model, attribution, point


def relinearise_timings(
    table: ResidualTable, baseline: Baseline, point: LinearisationPoint, found: tuple[str, ...]
) -> LinearisationPoint:
    """Each timing's point moved to its likeliest values, beside the other effects that were found, or instead of theirs.

    A timing that was not found may stand for those that were: it is tried beside the directions that were found alone.
    """
    for _ in range(LINEARISATION_ITERATIONS):
        model = build_flight_model(table, baseline, point)
        new = point
        for one in TIMINGS:
            label = f"{TIMING}:{one.axis}"
            others = [_find_member(model, o) for o in found if o != label and (label in found or not o.startswith(TIMING))]
            new = move_point(new, fit(model, [*others, _find_member(model, label)])[-1])
        change = max(float(np.abs(new.timings[axis] - u).max()) for axis, u in point.timings.items())
        point = new
        if change < CONVERGED_TIMING:
            break
    return point


def _find_member(model: LinearModel, label: str) -> SelectedCandidate:
    place = model.find(label)
    assert place is not None
    return SelectedCandidate(place, 0, 0)
