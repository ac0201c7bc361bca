"""Finer options where they matter: the times of a step and the time constants of a process around those that explain best."""

from __future__ import annotations

from collections.abc import Sequence

from diagnosis.inference.search import Explanation, Search
from diagnosis.model.linear import LinearModel, SelectedCandidate, Wanted

NEARLY = 0.25  # of a member's log evidence, from which on another effect in its place may be it with finer options
MOST_BESIDE = 6  # of these


def refine_model(search: Search, likely: Sequence[Explanation]) -> LinearModel:
    """Refine the options around those of some explanations, and of effects that may stand in the first of them.

    A step between two of the tried times leaves a residual that another step about the same axis would explain. A refined
    random process also has its weaker columns; without them it leaves a residual that another process would explain.
    """
    moments = search.model.moments(search.model, _list_wanted_sets(search, likely))
    places = [member for explanation in likely for member in explanation.members]
    places += find_near_alternatives(search, likely[0]) if likely else []
    places = [member for member in places if not search.model.candidate(member).process]
    processes = [
        candidate for explanation in likely for candidate in explanation.members if search.model.candidate(candidate).process
    ]
    search.forget()
    linear = moments
    for member in [*{member.candidate: member for member in reversed(places)}.values(), *processes]:
        linear = linear.refine(linear, member)
    return linear


def _list_other_members(explanation: Explanation, member: SelectedCandidate) -> tuple[SelectedCandidate, ...]:
    return tuple(candidate for candidate in explanation.members if candidate != member)


def _list_wanted_sets(search: Search, explanations: Sequence[Explanation]) -> list[Wanted]:
    """List explanations without one member, each with the evidence that a step beside them must have to be refined."""
    wanted: dict[frozenset[SelectedCandidate], Wanted] = {}
    for explanation in explanations:
        for member in explanation.members:
            others = _list_other_members(explanation, member)
            least = NEARLY * search.score(member.candidate, others).best
            wanted.setdefault(frozenset(others), (others, least))
    return list(wanted.values())


def find_near_alternatives(search: Search, best: Explanation) -> list[SelectedCandidate]:
    """Find listed effects that explain nearly as much as a member of an explanation in its place.

    An effect whose parameter lies between two tried values may explain all with finer options, and one that is not linear in
    the rates with the true rates. The number of alternatives is limited for effects with one option and with several
    separately.
    """
    nearest: dict[int, tuple[float, SelectedCandidate]] = {}
    for member in best.members:
        others = _list_other_members(best, member)
        own_score = search.score(member.candidate, others).best
        for number, entry in enumerate(search.model.candidates):
            if number in best.key or not entry.listed or entry.process:
                continue
            score = search.score(number, others)
            share = score.best / own_score if own_score > 0 else 0.0
            if share > max(NEARLY, nearest.get(number, (0.0, member))[0]):
                nearest[number] = share, SelectedCandidate(number, score.option, score.scale)
    ranked = [member for _, member in sorted(nearest.values(), key=lambda ranked_member: -ranked_member[0])]
    single_option = {member: len(search.model.candidate(member).options) == 1 for member in ranked}
    return [
        member
        for kind in (False, True)
        for member in [ranked_member for ranked_member in ranked if single_option[ranked_member] is kind][:MOST_BESIDE]
    ]
