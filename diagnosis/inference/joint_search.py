"""One search for effects with a shape and random errors without a name, which compete from the start.

A set grows by the candidate that raises its log posterior most: a listed effect, a broad family outside the library or a random
process. The option and scale of every member are then optimised with the other members fixed, and a member whose evidence no
longer exceeds its prior cost is removed. A random process explains a part of any slow error, so that it often enters first:
each member is removed once more, up to `MOST_SHAPES` effects may enter in its place, and then any candidates. The better set is
kept.

A place of the set has a posterior of its own (a single-effect regression: Wang, Sarkar, Carbonetto and Stephens, JRSS B 82,
2020): with all other members fixed, every candidate may stand in it, or none. One more alternative is the best set without the
member, found by the same search: random errors may enter in place of an effect with a shape, and the scales of the other
members may grow. `diagnosis.posterior` computes the probabilities of a place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from diagnosis.inference.refinement import refine_model
from diagnosis.inference.search import BASELINE_EXPLANATION, SCREEN_COLUMNS, Explanation, Search
from diagnosis.model.linear import LinearModel, SelectedCandidate
from diagnosis.posterior import (
    CredibleGroup,
    RankedExplanation,
    build_credible_group,
    compute_place_posterior,
    rank_explanations,
)
from diagnosis.settings import DiagnosisSettings

MOST_EFFECTS = 5  # listed effects with a shape among them
MOST_RIVALS = 2  # members without a name that may stand in one place together
MOST_SHAPES = 3  # effects that may enter in the place of one member
WEAK = 10.0  # log posterior that a member adds, above which its removal is not tried
OPTIMISED = 3  # candidates of each step whose sets are optimised before one is chosen
LEFT_OUT = 12.0  # log posterior below the likeliest, from which on a candidate has no share of a place
HOPELESS = 50.0  # the same, from which on a second member with it would not make up for it
SETTLED = 1e-6  # gain of log posterior below which an exchange is not made


@dataclass(frozen=True)
class Place:
    """Posterior of one place of a set."""

    member: SelectedCandidate  # the member of the best set
    shares: dict[int, float]  # probability of each candidate in this place; one minus their sum is that of none of them
    rival: float  # probability of the best set with no listed effect in this place


class JointSearch:
    """Grows, prunes and exchanges a set of candidates of one linear model."""

    def __init__(self, search: Search):
        self.search, self.model = search, search.model
        self._optimised: dict[frozenset[int], Explanation] = {frozenset(): BASELINE_EXPLANATION}

    @property
    def explanations(self) -> list[Explanation]:
        """All sets that were optimised, the best first."""
        return sorted(self._optimised.values(), key=lambda explanation: -explanation.log_posterior)

    def settle(self, best: Explanation) -> Explanation:
        """Grow and prune a set whose members have finer options now."""
        return self._grow(self._prune(self._optimise(best.members)), lambda number: True)

    def find(self) -> Explanation:
        """Find the set with the highest posterior."""
        best = self._grow(BASELINE_EXPLANATION, lambda number: True)
        tried: set[frozenset[int]] = set()
        for member in sorted(best.members, key=lambda member: self._compute_gain(best, member)):
            others = best.key - {member.candidate}
            if member.candidate not in best.key or others in tried:
                continue
            tried.add(others)
            better = self._exchange(best, member)
            if better.log_posterior > best.log_posterior + SETTLED:
                best = better
        return best

    def compute_place(self, best: Explanation, member: SelectedCandidate) -> Place:
        """Compute the posterior of the place of one member of the best set.

        All candidates are scored with the other members as they are; the scores of the likeliest ones are then replaced by the
        posterior of their optimised sets. The rival set with no listed effect in this place is searched for only if the member
        is an effect with a shape and an unlisted candidate scores nearly as well.
        """
        others = _list_others(best, member)
        reduced = Explanation(others, 0.0, 0.0)
        screened = self.search.list_children(reduced, most=SCREEN_COLUMNS)
        scores = {_find_added(child, reduced): child.log_posterior for child in screened}  # the likeliest first
        least = screened[0].log_posterior - LEFT_OUT
        likely = {number for number, score in scores.items() if score > least} | {member.candidate}
        children = {_find_added(child, reduced): child for child in self.search.list_children(reduced, likely.__contains__)}
        offset = best.log_posterior - children[member.candidate].log_posterior
        log_posteriors = {number: child.log_posterior + offset for number, child in children.items()}
        for number in list(children)[:OPTIMISED]:
            if log_posteriors[number] > best.log_posterior - LEFT_OUT:
                optimised = self._optimise(children[number].members)
                log_posteriors[number] = max(log_posteriors[number], optimised.log_posterior)
        log_posteriors[member.candidate] = best.log_posterior
        rival, unlisted = -np.inf, lambda number: not self.model.candidates[number].listed
        nearest = next((score for number, score in scores.items() if unlisted(number)), -np.inf)
        if self.is_shape(member.candidate) and nearest > children[member.candidate].log_posterior - HOPELESS:
            rival = self._grow(self._optimise(others), unlisted, MOST_RIVALS).log_posterior
        return Place(member, *compute_place_posterior(log_posteriors, rival))

    def prefer_listed(self, best: Explanation) -> Explanation:
        """Put the likeliest listed effect in each place in which listed effects have more of the posterior than others."""
        for number in [member.candidate for member in best.members]:
            member = next((member for member in best.members if member.candidate == number), None)
            if member is None:
                continue
            place = self.compute_place(best, member)
            slot, _ = build_credible_group(self.model.candidates, member, place.shares, self.search.settings)
            top = member.candidate if slot is None else self.model.find(slot.group[0][0])
            if top is not None and top != member.candidate:
                best = self._optimise((*_list_others(best, member), SelectedCandidate(top, 0, 0)))
        return best

    def is_shape(self, number: int) -> bool:
        """Check whether a candidate is a listed effect with a shape, not a random process."""
        entry = self.model.candidates[number]
        return entry.listed and not entry.process

    def _restrict_to_random(self, allowed: Callable[[int], bool]) -> Callable[[int], bool]:
        return lambda number: allowed(number) and not self.is_shape(number)

    def _optimise(self, members: tuple[SelectedCandidate, ...]) -> Explanation:
        key = frozenset(member.candidate for member in members)
        if key not in self._optimised:
            self._optimised[key] = self.search.optimise_members(members)
        return self._optimised[key]

    def _grow(self, current: Explanation, allowed: Callable[[int], bool], limit: int | None = None) -> Explanation:
        """Add the best candidate while that raises the posterior, at most `limit` times, and prune the set each time."""
        for _ in range(self.model.most_effects if limit is None else limit):
            if len(current.members) >= self.model.most_effects:
                break
            room = sum(map(self.is_shape, current.key)) < MOST_EFFECTS
            candidates = allowed if room else self._restrict_to_random(allowed)
            children = self.search.list_children(current, candidates, SCREEN_COLUMNS)[:OPTIMISED]
            grown = [self._optimise(child.members) for child in children if child.log_posterior > current.log_posterior]
            best = max(grown, key=lambda explanation: explanation.log_posterior, default=current)
            if best.log_posterior <= current.log_posterior:
                break
            current = self._prune(best)
        return current

    def _prune(self, current: Explanation) -> Explanation:
        """Remove members while that raises the posterior; only members that add little to the others as they are."""
        while len(current.members) > 1:
            weak = [member for member in current.members if self._compute_gain(current, member) < WEAK]
            pruned = [self._optimise(_list_others(current, member)) for member in weak]
            best = max(pruned, key=lambda explanation: explanation.log_posterior, default=current)
            if best.log_posterior <= current.log_posterior:
                break
            current = best
        return current

    def _compute_gain(self, current: Explanation, member: SelectedCandidate) -> float:
        """Compute the log posterior that a member adds to the others as they are."""
        entry = self.model.candidate(member)
        prior = entry.log_prior + entry.log_odds + float(np.log(self.search.settings.another))
        return self.search.score(member.candidate, _list_others(current, member)).average + prior

    def _exchange(self, current: Explanation, member: SelectedCandidate) -> Explanation:
        """Find the best set without one member: effects with a shape may enter first, and then any candidates."""
        others, removed = self._optimise(_list_others(current, member)), member.candidate
        shaped = self._grow(others, lambda number: number != removed and self.is_shape(number), MOST_SHAPES)
        return self._grow(shaped, lambda number: number != removed)


def _list_others(explanation: Explanation, member: SelectedCandidate) -> tuple[SelectedCandidate, ...]:
    return tuple(other for other in explanation.members if other != member)


def _find_added(child: Explanation, parent: Explanation) -> int:
    """Find the number of the one candidate that a set has and the set that it grew from has not."""
    (number,) = child.key - parent.key
    return number


@dataclass(frozen=True)
class InferredSet:
    """Causes and remainder of a misfit, and the model that they are members of."""

    linear: LinearModel  # with finer options around the members
    best: Explanation  # the set with the highest posterior
    slots: tuple[CredibleGroup, ...]  # causes, in the order of the set
    remainder: tuple[SelectedCandidate, ...]  # members without a name
    unknown: float  # probability that something unlisted is at work, in the place where it is likeliest
    ranked: tuple[RankedExplanation, ...]  # all sets that were optimised, the likeliest first
    log_evidence: dict[int, float]  # of each member beside the others, averaged over its options and scales


def infer_set(search: Search, settings: DiagnosisSettings) -> InferredSet:
    """Find the best set of effects and random errors, and the posterior of each of its places."""
    joint = JointSearch(search)
    best = joint.find()
    finer = refine_model(joint.search, [best])
    if finer is not search.model:
        refined_search = Search(finer, settings)
        refined_search.inherit(joint.search)
        joint = JointSearch(refined_search)
        best = joint.settle(best)
    best = joint.prefer_listed(best)
    places = [joint.compute_place(best, member) for member in best.members]
    slots: list[CredibleGroup] = []
    remainder, unlisted = [], []
    for place in places:
        slot, p = build_credible_group(joint.model.candidates, place.member, place.shares, settings)
        unlisted.append(p)
        # A later exchange may have made listed effects likelier in the place of a member without a name, which stays one.
        if slot is None or not joint.model.candidate(place.member).listed:
            remainder.append(place.member)
        else:
            slots.append(slot)
    ranked = rank_explanations(joint.model, joint.explanations)
    unknown = max(unlisted, default=0.0)
    evidence = {
        member.candidate: joint.search.score(member.candidate, _list_others(best, member)).average for member in best.members
    }
    return InferredSet(joint.model, best, tuple(slots), tuple(remainder), unknown, ranked, evidence)
