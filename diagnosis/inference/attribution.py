"""Attribution: from the evidence of sets of effects to the causes that may be named.

A cause is *named* if its probability is at least `DiagnosisSettings.named`. Where several listed effects share the
probability of one place in the explanation, they are a *group* of indistinguishable alternatives. If the sets that hold
something unlisted have more than `DiagnosisSettings.unknown` of the probability together, the answer is *unknown*.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.answer import Verdict
from diagnosis.inference.search import Explanation, total
from diagnosis.model.linear import LinearModel, Member
from diagnosis.settings import DEFAULT, DiagnosisSettings


@dataclass(frozen=True)
class Slot:
    """One effect of the best explanation, and the alternatives that this recording cannot tell from it.

    Attributes
    ----------
    member : the effect in the explanation
    probability : that it is at work
    group : labels with probabilities, itself included, the likeliest first
    """

    member: Member
    probability: float
    group: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Ranked:
    """One explanation for the list of all of them."""

    labels: tuple[str, ...]
    probability: float
    log_evidence: float
    unlisted: bool


@dataclass(frozen=True)
class Attribution:
    """What the explanations amount to.

    Attributes
    ----------
    verdict : named, group or unknown
    best : the explanation that the slots belong to; the likeliest of all if unknown
    slots : its effects; none if unknown
    unknown : probability that something unlisted is at work
    ranked : all explanations, the likeliest first
    """

    verdict: Verdict
    best: Explanation
    slots: tuple[Slot, ...]
    unknown: float
    ranked: tuple[Ranked, ...]


def attribute(model: LinearModel, explanations: list[Explanation], settings: DiagnosisSettings = DEFAULT) -> Attribution:
    """From sets with their evidence to an answer."""
    norm = total(explanations)
    probability = {explanation.key: float(np.exp(explanation.log_posterior - norm)) for explanation in explanations}
    ranked = tuple(
        Ranked(
            tuple(model.candidate(member).label for member in explanation.members),
            probability[explanation.key],
            explanation.log_evidence,
            not _is_listed(model, explanation),
        )
        for explanation in explanations
    )
    unknown = sum(one.probability for one in ranked if one.unlisted)
    listed = [explanation for explanation in explanations if _is_listed(model, explanation)]
    if not listed or unknown > settings.unknown:
        return Attribution("unknown", explanations[0], (), unknown, ranked)
    best = _best(listed, probability)
    slots = tuple(_slot(model, best, member, probability, settings) for member in best.members)
    if all(slot.probability >= settings.named for slot in slots):
        return Attribution("named", best, tuple(replace(slot, group=slot.group[:1]) for slot in slots), unknown, ranked)
    slots = tuple(replace(slot, group=slot.group[: settings.largest_group]) for slot in slots)
    return Attribution("group", best, slots, unknown, ranked)


def as_unknown(attribution: Attribution) -> Attribution:
    """The same explanations where a check has rejected what they would have named."""
    return replace(attribution, verdict="unknown", slots=(), unknown=1.0)


def _is_listed(model: LinearModel, explanation: Explanation) -> bool:
    return all(model.candidates[k].listed for k in explanation.key)


def _best(listed: list[Explanation], probability: dict[frozenset[int], float]) -> Explanation:
    """The likeliest set, of the likeliest number of effects."""
    by_size: dict[int, float] = defaultdict(float)
    for explanation in listed:
        by_size[len(explanation.key)] += probability[explanation.key]
    size = max(by_size, key=lambda count: by_size[count])
    return next(explanation for explanation in listed if len(explanation.key) == size)


def _slot(
    model: LinearModel,
    best: Explanation,
    member: Member,
    probability: dict[frozenset[int], float],
    settings: DiagnosisSettings,
) -> Slot:
    """The effect with the alternatives that stand in its place in explanations with the same other effects."""
    others = best.key - {member.candidate}
    own = sum(p for key, p in probability.items() if member.candidate in key)
    shares: dict[int, float] = defaultdict(float)
    for key, p in probability.items():
        if member.candidate in key or not others <= key:
            continue
        for candidate in key - others:
            if model.candidates[candidate].listed:
                shares[candidate] += p / len(key - others)
    whole = own + sum(shares.values())
    group = [(model.candidate(member).label, own)]
    group += [
        (model.candidates[candidate].label, p)
        for candidate, p in sorted(shares.items(), key=lambda item: -item[1])
        if p > settings.group_share * whole
    ]
    return Slot(member, own, tuple(group))
