"""Finer options where they matter: the times of a step and the time constants of a process around those that explain best."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from diagnosis.inference.search import Explanation, Search
from diagnosis.model.linear import LinearModel, Member, Wanted
from diagnosis.settings import DiagnosisSettings

NEARLY = 0.25  # of a member's log evidence, from which on another effect in its place may be it with finer options
MOST_BESIDE = 6  # of these
REFINED = 3  # of the likeliest explanations, around whose members options are made finer


def explained_finely(
    search: Search, settings: DiagnosisSettings, tell: Callable[[int], None] = lambda count: None
) -> tuple[LinearModel, list[Explanation]]:
    """The model with finer options around those of the likeliest explanations, and the explanations found with them.

    A step that is tried at a few times only leaves a trace when it happened between two of them, which another step about the
    same axis would explain. A random process has its weaker columns then; what a strong one would leave without them, another
    process would explain.
    """
    found = search.explanations()
    moments = search.model.moments(search.model, _wanted(search, found[:REFINED]))
    places = [member for explanation in found[:REFINED] for member in explanation.members]
    places += beside(search, found[0]) if found else []
    search.forget()
    linear = moments
    tried: set[int] = set()
    # Processes last: their finer scales are numbered anew, and the others of a set are held at theirs.
    for member in sorted(places, key=lambda member: linear.candidate(member).process):
        if member.candidate not in tried:
            tried.add(member.candidate)
            linear = linear.refine(linear, member)
    return (linear, found) if linear is search.model else (linear, Search(linear, settings, tell).explanations())


def _others(explanation: Explanation, member: Member) -> tuple[Member, ...]:
    return tuple(one for one in explanation.members if one != member)


def _wanted(search: Search, found: Sequence[Explanation]) -> list[Wanted]:
    """Explanations with one of their members away, and what a step must explain beside the others to be looked at closely."""
    wanted: dict[frozenset[Member], Wanted] = {}
    for explanation in found:
        for member in explanation.members:
            others = _others(explanation, member)
            least = NEARLY * search.score(member.candidate, others).best
            wanted.setdefault(frozenset(others), (others, least))
    return list(wanted.values())


def beside(search: Search, best: Explanation) -> list[Member]:
    """Listed effects that explain nearly as much as a member of an explanation in its place, with the others of it.

    One whose parameter lies between two that are tried may explain all of it with finer ones.
    """
    found: dict[int, tuple[float, Member]] = {}
    for member in best.members:
        others = _others(best, member)
        own = search.score(member.candidate, others).best
        for number, entry in enumerate(search.model.candidates):
            if number in best.key or not entry.listed or entry.process or len(entry.options) == 1:
                continue
            score = search.score(number, others)
            share = score.best / own if own > 0 else 0.0
            if share > max(NEARLY, found.get(number, (0.0, member))[0]):
                found[number] = share, Member(number, score.option, score.scale)
    return [member for _, member in sorted(found.values(), key=lambda one: -one[0])[:MOST_BESIDE]]
