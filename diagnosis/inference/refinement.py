"""Finer options where they matter: the times of a step and the time constants of a process around those that explain best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.inference.search import Explanation, Search
from diagnosis.model.linear import LinearModel, Member
from diagnosis.settings import DiagnosisSettings


@dataclass(frozen=True)
class RefinementSettings:
    """Constants of `diagnosis.inference.refinement`."""

    nearly: float = 0.25  # of a member's log evidence, from which on another effect in its place may be it with finer options
    most_beside: int = 6  # of these
    refined: int = 3  # of the likeliest explanations, around whose members options are made finer


SETTINGS = RefinementSettings()


def search_with_refined_options(
    search: Search, settings: DiagnosisSettings, tell: Callable[[int], None] = lambda count: None
) -> tuple[LinearModel, list[Explanation]]:
    """The model with finer options around those of the likeliest explanations, and the explanations found with them.

    A step that is tried at a few times only leaves a trace when it happened between two of them, which another step about the
    same axis would explain. A random process has its weaker columns then; what a strong one would leave without them, another
    process would explain.
    """
    found = search.explanations()
    likely = found[: SETTINGS.refined]
    places = [member for explanation in likely for member in explanation.members]
    processes = [member for member in places if search.model.candidate(member).process]
    places += beside(search, found[0]) if found else []
    search.forget()
    linear = search.model
    for member in {member.candidate: member for member in reversed(places) if member not in processes}.values():
        linear = linear.refine(linear, member)
    # Processes last: their finer scales are numbered anew, and the others of a set are held at theirs.
    for member in {(member.candidate, member.option): member for member in processes}.values():
        scales = linear.candidate(member).scales
        scale = int(np.argmin(np.abs(np.log(scales / search.model.scale(member)))))
        linear = linear.refine(linear, replace(member, scale=scale))
    return (linear, found) if linear is search.model else (linear, Search(linear, settings, tell).explanations())


def _others(explanation: Explanation, member: Member) -> tuple[Member, ...]:
    return tuple(one for one in explanation.members if one != member)


def beside(search: Search, best: Explanation) -> list[Member]:
    """Listed effects that explain nearly as much as a member of an explanation in its place, with the others of it.

    One whose parameter lies between two that are tried may explain all of it with finer ones; one that is not linear in the
    rates, with those that the body has beside it. Each kind has its own places.
    """
    found: dict[int, tuple[float, Member]] = {}
    for member in best.members:
        others = _others(best, member)
        own = search.score(member.candidate, others).best
        for number, entry in enumerate(search.model.candidates):
            if number in best.key or not entry.listed or entry.process:
                continue
            score = search.score(number, others)
            share = score.best / own if own > 0 else 0.0
            if share > max(SETTINGS.nearly, found.get(number, (0.0, member))[0]):
                found[number] = share, Member(number, score.option, score.scale)
    ranked = [member for _, member in sorted(found.values(), key=lambda one: -one[0])]
    alone = {member: len(search.model.candidate(member).options) == 1 for member in ranked}
    return [
        member for kind in (False, True) for member in [one for one in ranked if alone[one] is kind][: SETTINGS.most_beside]
    ]
