"""Which cause: probabilities of sets of effects, and what may be said of them.

A cause is *named* if its probability is at least 0.95. Where several listed effects share it, they are a *group*. If something
that is on no list explains the data about as well, or together with what is on it, the answer is *unknown*. A random process
can imitate most things, so that it takes less doubt not to name one.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from diagnosis.answer import Verdict
from diagnosis.inference.candidates import Bank
from diagnosis.inference.search import Explanation, Member, total
from simulator.effects import EFFECTS

NAMED = 0.95
UNKNOWN = 0.4  # probability of something unlisted from which on nothing is named
UNKNOWN_BESIDE_RANDOM = 0.25  # the same where a random process is the answer, which can imitate most things
GROUP_SHARE = 0.02  # of a slot's probability, below which an effect is not offered in place of another
LARGEST_GROUP = 4


@dataclass(frozen=True)
class Slot:
    """One effect of the best explanation and what could stand in its place: labels with probabilities."""

    member: Member
    probability: float
    group: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Attribution:
    """What the explanations amount to.

    Attributes
    ----------
    verdict : named, group or unknown
    best : the explanation the slots belong to
    slots : its effects; none if unknown
    unknown : probability that something unlisted is at work
    ranked : labels of each explanation with probability and log evidence, best first
    """

    verdict: Verdict
    best: Explanation
    slots: tuple[Slot, ...]
    unknown: float
    ranked: tuple[tuple[tuple[str, ...], float, float, bool], ...]


def attribute(bank: Bank, explanations: list[Explanation]) -> Attribution:
    """From sets with their evidence to an answer."""
    norm = total(explanations)
    probability = {explanation.key: float(np.exp(explanation.log_posterior - norm)) for explanation in explanations}
    listed = [all(bank.candidates[k].listed for k in explanation.key) for explanation in explanations]
    unknown = sum(probability[e.key] for e, own in zip(explanations, listed, strict=True) if not own)
    ranked = tuple(
        (
            tuple(bank.candidates[member.candidate].label for member in explanation.members),
            probability[explanation.key],
            explanation.log_evidence,
            not own,
        )
        for explanation, own in zip(explanations, listed, strict=True)
    )
    candidates = [explanation for explanation, own in zip(explanations, listed, strict=True) if own]
    if not candidates or unknown > UNKNOWN:
        return Attribution("unknown", explanations[0], (), unknown, ranked)
    best = _best(candidates, probability)
    if unknown > UNKNOWN_BESIDE_RANDOM and any(_is_random(bank, member) for member in best.members):
        return Attribution("unknown", explanations[0], (), unknown, ranked)
    slots = tuple(_slot(bank, best, member, probability) for member in best.members)
    sure = all(slot.probability >= NAMED for slot in slots)
    if sure:
        slots = tuple(Slot(slot.member, slot.probability, slot.group[:1]) for slot in slots)
        return Attribution("named", best, slots, unknown, ranked)
    if max(len(slot.group) for slot in slots) > LARGEST_GROUP:
        slots = tuple(Slot(slot.member, slot.probability, slot.group[:LARGEST_GROUP]) for slot in slots)
    return Attribution("group", best, slots, unknown, ranked)


def _is_random(bank: Bank, member: Member) -> bool:
    effect = EFFECTS.get(bank.candidates[member.candidate].effect)
    return effect is not None and effect.is_process


def _best(candidates: list[Explanation], probability: dict[frozenset[int], float]) -> Explanation:
    """The likeliest set, of the likeliest number of effects."""
    by_size: dict[int, float] = defaultdict(float)
    for explanation in candidates:
        by_size[len(explanation.key)] += probability[explanation.key]
    size = max(by_size, key=lambda count: by_size[count])
    return next(explanation for explanation in candidates if len(explanation.key) == size)


def _slot(bank: Bank, best: Explanation, member: Member, probability: dict[frozenset[int], float]) -> Slot:
    others = best.key - {member.candidate}
    own = sum(p for key, p in probability.items() if member.candidate in key)
    shares: dict[int, float] = defaultdict(float)
    for key, p in probability.items():
        if member.candidate in key or not others <= key:
            continue
        for candidate in key - others:
            if bank.candidates[candidate].listed:
                shares[candidate] += p / len(key - others)
    slot_total = own + sum(shares.values())
    group = [(bank.candidates[member.candidate].label, own)]
    group += [
        (bank.candidates[candidate].label, p)
        for candidate, p in sorted(shares.items(), key=lambda item: -item[1])
        if p > GROUP_SHARE * slot_total
    ]
    return Slot(member, own, tuple(group))
