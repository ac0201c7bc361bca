"""One search for effects with a shape and random errors without a name, which compete from the start.

A set grows by the candidate that raises its log posterior most, whatever it is: a listed effect, a broad family outside the
library or a random process. Every member is then moved to its best option and scale with the others held, and a member that is
no longer worth its prior leaves. A random process explains a part of anything that is slow, so that it often enters first:
each member is taken out once more, up to `MOST_SHAPES` effects may enter in its place, and then anything. The better set is
kept.

A place of the set has a posterior of its own (a single-effect regression: Wang, Sarkar, Carbonetto and Stephens, JRSS B 82,
2020): with all other members held, every candidate may stand in it, or nothing. Instead of a member whose scale is known, the
other members may also grow, and random errors may enter: the best set without it, found by the same search, is one more
alternative. `diagnosis.posterior` makes the probabilities of a place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from diagnosis.inference.refinement import refine_model
from diagnosis.inference.search import BASELINE_EXPLANATION, SCREEN_COLUMNS, Explanation, Search
from diagnosis.model.linear import LinearModel, SelectedCandidate
from diagnosis.posterior import CredibleGroup, RankedExplanation, build_slot, compute_place_posterior, rank_explanations
from diagnosis.settings import DiagnosisSettings

MOST_EFFECTS = 5  # listed effects with a shape among them
MOST_RIVALS = 2  # members without a name that may stand in one place together
MOST_SHAPES = 3  # effects that may enter in the place of one member
WEAK = 10.0  # log posterior that a member adds, above which it is not tried to do without
OPTIMISED = 3  # candidates of each step whose sets are optimised before one is chosen
LEFT_OUT = 12.0  # log posterior below the likeliest, from which on a candidate has no share of a place
HOPELESS = 50.0  # the same, from which on a second member beside it would not make up for it
SETTLED = 1e-6  # gain of log posterior below which an exchange is none


@dataclass(frozen=True)
class Place:
    """Posterior of one place of a set."""

    member: SelectedCandidate  # the member of the best set
    shares: dict[int, float]  # probability of each candidate in this place; what is missing to one is that of none of them
    rival: float  # probability of the best set in which nothing listed stands in this place


class JointSearch:
    """Grows, prunes and exchanges a set of candidates of one linear model."""

    def __init__(self, search: Search):
        self.search, self.model = search, search.model
        self._found: dict[frozenset[int], Explanation] = {frozenset(): BASELINE_EXPLANATION}

    @property
    def explanations(self) -> list[Explanation]:
        """All sets that were optimised, the best first."""
        return sorted(self._found.values(), key=lambda one: -one.log_posterior)

    def settle(self, best: Explanation) -> Explanation:
        """Grow and prune a set whose members have finer options now."""
        return self._grow(self._prune(self._optimise(best.members)), lambda number: True)

    def find(self) -> Explanation:
        """Find the set with the highest posterior."""
        best = self._grow(BASELINE_EXPLANATION, lambda number: True)
        tried: set[frozenset[int]] = set()
        for member in sorted(best.members, key=lambda one: self._compute_worth(best, one)):
            if member.candidate not in best.key or best.key - {member.candidate} in tried:
                continue
            tried.add(best.key - {member.candidate})
            better = self._exchange(best, member)
            if better.log_posterior > best.log_posterior + SETTLED:
                best = better
        return best

    def compute_place(self, best: Explanation, member: SelectedCandidate) -> Place:
        """Compute the posterior of the place of one member of the best set.

        The scores of all candidates are those beside the other members as they are; those of the likeliest ones are then
        replaced by the posterior of their sets at their best. That nothing listed stands in this place is asked of effects
        with a shape, which may have a name, and where one member without a name comes near.
        """
        others = tuple(one for one in best.members if one != member)
        held = Explanation(others, 0.0, 0.0)
        screened = self.search.list_children(held, most=SCREEN_COLUMNS)
        least = screened[0].log_posterior - LEFT_OUT
        likely = {next(iter(one.key - held.key)) for one in screened if one.log_posterior > least} | {member.candidate}
        children = {next(iter(one.key - held.key)): one for one in self.search.list_children(held, likely.__contains__)}
        offset = best.log_posterior - children[member.candidate].log_posterior
        logs = {number: one.log_posterior + offset for number, one in children.items()}
        for number in [number for number in list(logs)[:OPTIMISED] if logs[number] > best.log_posterior - LEFT_OUT]:
            logs[number] = max(logs[number], self._optimise(children[number].members).log_posterior)
        logs[member.candidate] = best.log_posterior
        rival, unlisted = -np.inf, lambda number: not self.model.candidates[number].listed
        nearest = next((one.log_posterior for one in screened if unlisted(next(iter(one.key - held.key)))), -np.inf)
        if self.is_shape(member.candidate) and nearest > children[member.candidate].log_posterior - HOPELESS:
            rival = self._grow(self._optimise(others), unlisted, MOST_RIVALS).log_posterior
        return Place(member, *compute_place_posterior(logs, rival))

    def prefer_listed(self, best: Explanation) -> Explanation:
        """Put the likeliest listed effect in each place in which listed effects have more of the posterior than others."""
        for number in [one.candidate for one in best.members]:
            member = next((one for one in best.members if one.candidate == number), None)
            if member is None:
                continue
            place = self.compute_place(best, member)
            slot, _ = build_slot(self.model.candidates, member, place.shares, self.search.settings)
            top = member.candidate if slot is None else self.model.find(slot.group[0][0])
            if top is not None and top != member.candidate:
                others = tuple(one for one in best.members if one != member)
                best = self._optimise((*others, SelectedCandidate(top, 0, 0)))
        return best

    def is_shape(self, number: int) -> bool:
        """Whether a candidate is a listed effect with a shape of its own."""
        entry = self.model.candidates[number]
        return entry.listed and not entry.process

    def _restrict_to_random(self, allowed: Callable[[int], bool]) -> Callable[[int], bool]:
        return lambda number: allowed(number) and not self.is_shape(number)

    def _optimise(self, members: tuple[SelectedCandidate, ...]) -> Explanation:
        key = frozenset(one.candidate for one in members)
        if key not in self._found:
            self._found[key] = self.search.optimise_members(members)
        return self._found[key]

    def _grow(self, current: Explanation, allowed: Callable[[int], bool], most: int | None = None) -> Explanation:
        """Add the best candidate while that raises the posterior, at most so many times, and take out what is not needed."""
        for _ in range(self.model.most_effects if most is None else most):
            if len(current.members) >= self.model.most_effects:
                break
            room = sum(map(self.is_shape, current.key)) < MOST_EFFECTS
            own = allowed if room else self._restrict_to_random(allowed)
            children = self.search.list_children(current, own, SCREEN_COLUMNS)[:OPTIMISED]
            grown = [self._optimise(child.members) for child in children if child.log_posterior > current.log_posterior]
            best = max(grown, key=lambda one: one.log_posterior, default=current)
            if best.log_posterior <= current.log_posterior:
                break
            current = self._prune(best)
        return current

    def _prune(self, current: Explanation) -> Explanation:
        """Take members out while that raises the posterior; only those that are worth little beside the others as they are."""
        while len(current.members) > 1:
            weak = [one for one in current.members if self._compute_worth(current, one) < WEAK]
            fewer = [self._optimise(tuple(one for one in current.members if one != member)) for member in weak]
            best = max(fewer, key=lambda one: one.log_posterior, default=current)
            if best.log_posterior <= current.log_posterior:
                break
            current = best
        return current

    def _compute_worth(self, current: Explanation, member: SelectedCandidate) -> float:
        """Log posterior that a member adds to the others as they are held."""
        others = tuple(one for one in current.members if one != member)
        entry = self.model.candidate(member)
        prior = entry.log_prior + entry.log_odds + float(np.log(self.search.settings.another))
        return self.search.score(member.candidate, others).average + prior

    def _exchange(self, current: Explanation, member: SelectedCandidate) -> Explanation:
        """The set with something else in the place of one member: effects first, and then anything."""
        others, own = self._optimise(tuple(one for one in current.members if one != member)), member.candidate
        shaped = self._grow(others, lambda number: number != own and self.is_shape(number), MOST_SHAPES)
        return self._grow(shaped, lambda number: number != own)


@dataclass(frozen=True)
class Inferred:
    """Causes and remainder of a misfit, and the model that they are members of."""

    linear: LinearModel  # with finer options around the members
    best: Explanation  # the set with the highest posterior
    slots: tuple[CredibleGroup, ...]  # causes, in the order of the set
    remainder: tuple[SelectedCandidate, ...]  # members without a name
    unknown: float  # probability that something unlisted is at work, in the place where it is likeliest
    ranked: tuple[RankedExplanation, ...]  # all sets that were optimised, the likeliest first
    log_evidence: dict[int, float]  # of each member beside the others, averaged over its options and scales


def infer_set(search: Search, settings: DiagnosisSettings) -> Inferred:
    """Find the best set of effects and random errors, and the posterior of each of its places."""
    joint = JointSearch(search)
    best = joint.find()
    finer = refine_model(joint.search, [best])
    if finer is not search.model:
        again = Search(finer, settings)
        again.inherit(joint.search)
        joint = JointSearch(again)
        best = joint.settle(best)
    best = joint.prefer_listed(best)
    places = [joint.compute_place(best, member) for member in best.members]
    slots: list[CredibleGroup] = []
    remainder, unlisted = [], []
    for place in places:
        slot, p = build_slot(joint.model.candidates, place.member, place.shares, settings)
        unlisted.append(p)
        # A later exchange may have made listed effects likelier in the place of a member without a name, which stays one.
        if slot is None or not joint.model.candidate(place.member).listed:
            remainder.append(place.member)
        else:
            slots.append(slot)
    ranked = rank_explanations(joint.model, joint.explanations)
    unknown = max(unlisted, default=0.0)
    others = {one: tuple(other for other in best.members if other != one) for one in best.members}
    evidence = {one.candidate: joint.search.score(one.candidate, beside).average for one, beside in others.items()}
    return Inferred(joint.model, best, tuple(slots), tuple(remainder), unknown, ranked, evidence)
