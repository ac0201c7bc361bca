"""Finer options where they matter: the times of a step and the time constants of a process around those that explain best."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from diagnosis.inference.search import Explanation, Score, Search
from diagnosis.model.linear import LinearModel, SelectedCandidate, Wanted

NEARLY = 0.25  # of a member's log evidence, from which on another effect in its place may be it with finer options
MOST_BESIDE = 6  # of these
REACH = 12.0  # log evidence below the best process, down to which another may be likelier with finer options


def refine_model(search: Search, likely: Sequence[Explanation]) -> LinearModel:
    """Refine the options around those of some explanations, and of effects that may stand in the first of them.

    A step that is tried at a few times only leaves a trace when it happened between two of them, which another step about the
    same axis would explain. A random process has its weaker columns then; what a strong one would leave without them, another
    process would explain.
    """
    moments = search.model.moments(search.model, _list_wanted_sets(search, likely))
    places = [member for explanation in likely for member in explanation.members]
    places += find_near_alternatives(search, likely[0]) if likely else []
    places = [member for member in places if not search.model.candidate(member).process]
    processes = find_whole_processes(search, likely)
    search.forget()
    linear = moments
    for member in {member.candidate: member for member in reversed(places)}.values():
        linear = linear.refine(linear, member)
    # Processes last: their finer scales are numbered anew, and the others of a set are held at theirs.
    for member in processes:
        scales = linear.candidate(member).scales
        scale = int(np.argmin(np.abs(np.log(scales / search.model.scale(member)))))
        linear = linear.refine(linear, replace(member, scale=scale))
    return linear


def find_whole_processes(search: Search, likely: Sequence[Explanation]) -> list[SelectedCandidate]:
    """Where random processes explain best with all of their columns: those in some explanations, and those that may be instead.

    Of a strong process the columns that are usual hold a part only, of a short time constant more than of a long one. They
    favour another option than all columns do, other effects beside it, and that process of several whose part is larger.
    Each listed process about the same axis is therefore asked with all columns, alone and beside the other members.
    """
    model = search.model
    random = [
        (member, explanation) for explanation in likely for member in explanation.members if model.candidate(member).process
    ]
    axes = {model.candidate(member).axis for member, _ in random}
    givens = list(dict.fromkeys([(), *(_list_other_members(explanation, member) for member, explanation in random)]))
    found: dict[tuple[SelectedCandidate, ...], list[tuple[float, SelectedCandidate]]] = {given: [] for given in givens}
    for number, entry in enumerate(model.candidates):
        if not (entry.process and entry.listed and entry.axis in axes):
            continue
        for given, score in _score_whole_process(search, number, givens):
            found[given].append((score.best, SelectedCandidate(number, score.option, score.scale)))
    spots = []
    for scored in found.values():
        top = max((best for best, _ in scored), default=0.0)
        spots += [member for best, member in scored if best > top - REACH]
    return list({(member.candidate, member.option): member for member in spots}.values())


def _score_whole_process(
    search: Search, number: int, givens: Sequence[tuple[SelectedCandidate, ...]]
) -> Iterator[tuple[tuple[SelectedCandidate, ...], Score]]:
    """Scores of a process with all columns that show at the scale that it has alone, given sets without it."""
    model, alone = search.model, search.score(number, ())
    own = [given for given in givens if all(member.candidate != number for member in given)]
    members = list(dict.fromkeys(member for given in own for member in given))
    held = [replace(model.candidate(member), options=(model.option(member),)) for member in members]
    small = replace(model, candidates=(model.candidates[number], *held)).compact()
    whole = Search(small.whole(small, SelectedCandidate(0, alone.option, alone.scale)))
    for given in own:
        yield given, whole.score(0, tuple(SelectedCandidate(1 + members.index(one), 0, one.scale) for one in given))


def _list_other_members(explanation: Explanation, member: SelectedCandidate) -> tuple[SelectedCandidate, ...]:
    return tuple(one for one in explanation.members if one != member)


def _list_wanted_sets(search: Search, found: Sequence[Explanation]) -> list[Wanted]:
    """Explanations with one of their members away, and what a step must explain beside the others to be looked at closely."""
    wanted: dict[frozenset[SelectedCandidate], Wanted] = {}
    for explanation in found:
        for member in explanation.members:
            others = _list_other_members(explanation, member)
            least = NEARLY * search.score(member.candidate, others).best
            wanted.setdefault(frozenset(others), (others, least))
    return list(wanted.values())


def find_near_alternatives(search: Search, best: Explanation) -> list[SelectedCandidate]:
    """Listed effects that explain nearly as much as a member of an explanation in its place, with the others of it.

    One whose parameter lies between two that are tried may explain all of it with finer ones; one that is not linear in the
    rates, with those that the body has beside it. Each kind has its own places.
    """
    found: dict[int, tuple[float, SelectedCandidate]] = {}
    for member in best.members:
        others = _list_other_members(best, member)
        own = search.score(member.candidate, others).best
        for number, entry in enumerate(search.model.candidates):
            if number in best.key or not entry.listed or entry.process:
                continue
            score = search.score(number, others)
            share = score.best / own if own > 0 else 0.0
            if share > max(NEARLY, found.get(number, (0.0, member))[0]):
                found[number] = share, SelectedCandidate(number, score.option, score.scale)
    ranked = [member for _, member in sorted(found.values(), key=lambda one: -one[0])]
    alone = {member: len(search.model.candidate(member).options) == 1 for member in ranked}
    return [member for kind in (False, True) for member in [one for one in ranked if alone[one] is kind][:MOST_BESIDE]]
