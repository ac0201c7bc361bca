"""Attribution: from the evidence of sets of effects to the causes that may be named.

A cause is *named* if its probability is at least `DiagnosisSettings.named`. Where several listed effects share the
probability of one place in the explanation, they are a *group* of indistinguishable alternatives. If the sets that hold
something unlisted have more than `DiagnosisSettings.unknown` of the probability together, the answer is *unknown*, or
*partial* where a place that reaches `DiagnosisSettings.named` is in nearly all of these sets.

No list is complete. Something unlisted may act beside the effects, with the prior probability `another` times `unlisted_share`
of `DiagnosisSettings`. It is described by a remainder of random errors (`diagnosis.model.remainder`). A listed random process
is one of these, so that a remainder may stand in its place as well, with the prior probability `unlisted_share`. What the
samples show of a process by themselves speaks against that, since the remainder would have to show it, too. In the place of an
effect with a shape of its own a remainder had less evidence in every simulated recording that was tried.

The checks of what the explanation leaves (`diagnosis.inference.criticism`) weigh both. Their p-value p is uniform under the
explanation. Where something else is at work its density is α p^(α − 1), the smaller α, the more the checks see of it. α may
have any value from 0 to 1 (Sellke, Bayarri and Berger, The American Statistician 55, 2001), so that a p-value is worth the
Bayes factor

    C = ∫₀¹ α p^(α − 1) dα = (1/p − 1 + ln p)/ln² p

which is one half at p = 1 and one at p = 0.17. The odds are C times the prior odds.

Where several listed explanations share the probability, p is averaged over their posterior (Gelman et al., Bayesian Data
Analysis, section 6.3): what one of them would not leave, another may.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.answer import Verdict
from diagnosis.inference.search import BASELINE_EXPLANATION, Explanation, sum_log_posterior
from diagnosis.model.linear import LinearModel, SelectedCandidate
from diagnosis.settings import DEFAULT, DiagnosisSettings

LEAST = 1e-300  # p-value, below which the factor is that of this one
CERTAIN = 1e-4  # −log of a p-value, below which the factor is its series
WORTH_A_CHECK = 0.02  # share of the listed explanations' probability, from which on one of them is checked
MOST_CHECKED = 5  # of these

REMAINDER = "a remainder"  # in explanations


@dataclass(frozen=True)
class CredibleGroup:
    """One effect of the best explanation, and the alternatives that this recording cannot tell from it."""

    member: SelectedCandidate  # the effect in the explanation
    probability: float  # that it is at work
    group: tuple[tuple[str, float], ...]  # labels with probabilities, itself included, the likeliest first

    @property
    def group_probability(self) -> float:
        """Probability that one of the group is at work."""
        return sum(p for _, p in self.group)


@dataclass(frozen=True)
class RankedExplanation:
    """One explanation for the list of all of them."""

    labels: tuple[str, ...]
    probability: float
    log_evidence: float
    unlisted: bool


@dataclass(frozen=True)
class Attribution:
    """What the explanations amount to."""

    verdict: Verdict  # named, group, partial or unknown
    best: Explanation  # the explanation that the slots belong to; the likeliest of all if partial or unknown
    slots: tuple[CredibleGroup, ...]  # its effects; if partial those that are sure, and none if unknown
    unknown: float  # probability that something unlisted is at work
    ranked: tuple[RankedExplanation, ...]  # all explanations, the likeliest first


def infer_attribution(
    model: LinearModel, explanations: list[Explanation], settings: DiagnosisSettings = DEFAULT
) -> Attribution:
    """Infer the attribution from sets of effects with their evidence."""
    norm = sum_log_posterior(explanations)
    probability = {explanation.key: float(np.exp(explanation.log_posterior - norm)) for explanation in explanations}
    ranked = tuple(
        RankedExplanation(
            tuple(model.candidate(member).label for member in explanation.members),
            probability[explanation.key],
            explanation.log_evidence,
            not is_listed(model, explanation),
        )
        for explanation in explanations
    )
    unknown = sum(one.probability for one in ranked if one.unlisted)
    listed = [one for one in explanations if one.members and is_listed(model, one)]
    if not listed or unknown > settings.unknown:
        found = find_slots(model, explanations[0], explanations, settings)
        sure = tuple(slot for slot in found if slot.group_probability >= settings.named)
        return Attribution("partial" if sure else "unknown", explanations[0], _trim_groups(sure, settings), unknown, ranked)
    best = _find_best_explanation(listed, probability)
    slots = tuple(_build_credible_group(model, best, member, probability, settings) for member in best.members)
    return Attribution(_decide_attribution_verdict(slots, settings), best, _trim_groups(slots, settings), unknown, ranked)


def find_slots(
    model: LinearModel, best: Explanation, explanations: Sequence[Explanation], settings: DiagnosisSettings = DEFAULT
) -> list[CredibleGroup]:
    """Find the listed effects of an explanation, with their posterior over all explanations, and their alternatives."""
    norm = sum_log_posterior(list(explanations))
    probability = {one.key: float(np.exp(one.log_posterior - norm)) for one in explanations}
    listed = [member for member in best.members if model.candidate(member).listed]
    return [_build_credible_group(model, best, member, probability, settings) for member in listed]


def rank_beside_remainder(slots: Sequence[CredibleGroup]) -> tuple[RankedExplanation, ...]:
    """Rank the explanations by identified effects and a remainder: each effect or one of its alternatives, independently."""
    ranked = []
    for choice in itertools.product(*(slot.group for slot in slots)):
        probability = math.prod(p for _, p in choice)
        ranked.append(RankedExplanation((*(name for name, _ in choice), REMAINDER), probability, 0.0, True))
    ranked.append(RankedExplanation((REMAINDER,), max(0.0, 1 - sum(one.probability for one in ranked)), 0.0, True))
    return tuple(sorted(ranked, key=lambda one: -one.probability))


def build_unknown_attribution(p_value: float) -> Attribution:
    """Compare M0 with an effect outside the library, equally probable a priori, for a gap that no candidate explains."""
    unknown = 1 / (1 + compute_bayes_factor_bound(p_value))
    nothing, other = (
        RankedExplanation((), 1 - unknown, 0.0, False),
        RankedExplanation(("residuals that are not white, as of no candidate",), unknown, 0.0, True),
    )
    return Attribution("unknown", BASELINE_EXPLANATION, (), unknown, (other, nothing))


def rank_weak_effects(
    model: LinearModel, explanations: Sequence[Explanation], p_value: float, settings: DiagnosisSettings = DEFAULT
) -> tuple[RankedExplanation, ...]:
    """Rank M0 and effects that may be present but too weak to identify, for a recording without a gap.

    Parameters
    ----------
    model : the candidates
    explanations : one effect each, with its evidence, which is small
    p_value : of what M0 leaves of all references, which would show something on no list that no candidate does

    Returns
    -------
    All of them, the likeliest first
    """
    hidden = float(np.log(settings.unlisted_share / compute_bayes_factor_bound(p_value)))
    norm = float(np.logaddexp(sum_log_posterior([BASELINE_EXPLANATION, *explanations]), hidden))
    found = [
        RankedExplanation(
            tuple(model.candidate(member).label for member in one.members),
            float(np.exp(one.log_posterior - norm)),
            one.log_evidence,
            not is_listed(model, one),
        )
        for one in (BASELINE_EXPLANATION, *explanations)
    ]
    found.append(RankedExplanation(("something that no candidate shows",), float(np.exp(hidden - norm)), 0.0, True))
    return tuple(sorted(found, key=lambda one: -one.probability))


def weigh_unlisted(
    model: LinearModel,
    attribution: Attribution,
    p_value: float | None,
    settings: DiagnosisSettings = DEFAULT,
) -> Attribution:
    """Weigh what would be named against something unlisted in its place or beside it.

    Parameters
    ----------
    model : the candidates
    attribution : of an explanation that has effects to name
    p_value : of all checks of what the explanation leaves together; None where nothing could be checked
    """
    factor = 1.0 if p_value is None else 1 / compute_bayes_factor_bound(p_value)
    if attribution.verdict == "partial":  # something unlisted is in the explanation already
        slots = [scale_slot(slot, _keep(model, slot, factor, settings)) for slot in attribution.slots]
        return replace(attribution, slots=tuple(slots))
    beside = settings.another * settings.unlisted_share
    alone = 1 / (1 + factor * beside / (1 - beside))
    own = [_keep(model, slot, factor, settings) for slot in attribution.slots]
    left = alone * math.prod(own)
    unknown = 1 - (1 - attribution.unknown) * left
    ranked = [replace(one, probability=one.probability * left) for one in attribution.ranked]
    ranked = sorted([*ranked, *_rank_unlisted(attribution, own, alone)], key=lambda one: -one.probability)
    if unknown > settings.unknown:
        return Attribution("unknown", attribution.best, (), unknown, tuple(ranked))
    slots = [scale_slot(slot, part) for slot, part in zip(attribution.slots, own, strict=True)]
    return Attribution(
        _decide_attribution_verdict(slots, settings), attribution.best, _trim_groups(slots, settings), unknown, tuple(ranked)
    )


def scale_slot(slot: CredibleGroup, share: float) -> CredibleGroup:
    """Multiply the probabilities of an effect and of its alternatives by a share."""
    return replace(slot, probability=slot.probability * share, group=tuple((name, p * share) for name, p in slot.group))


def _keep(model: LinearModel, slot: CredibleGroup, factor: float, settings: DiagnosisSettings) -> float:
    """Compute the probability that no remainder stands in the place of an effect; `factor` is that of the checks."""
    entry = model.candidate(slot.member)
    if not entry.process:
        return 1.0
    odds = factor * settings.unlisted_share / (1 - settings.unlisted_share)
    return 1 / (1 + odds * math.exp(-max(entry.log_odds, 0.0)))


def _rank_unlisted(attribution: Attribution, own: Sequence[float], alone: float) -> Iterator[RankedExplanation]:
    """Rank the explanations that have a remainder in the place of some causes, or beside all of them.

    Parameters
    ----------
    attribution : its slots are the causes
    own : of each, the probability that nothing unlisted is in its place; independent
    alone : probability that nothing unlisted is beside them
    """
    names = [slot.group[0][0] for slot in attribution.slots]
    for true in itertools.product((True, False), repeat=len(names)):
        probability = math.prod(p if is_true else 1 - p for p, is_true in zip(own, true, strict=True))
        kept = [name for name, is_true in zip(names, true, strict=True) if is_true]
        share = 1 - alone if all(true) else 1.0
        yield RankedExplanation((*kept, REMAINDER), probability * share, attribution.best.log_evidence, True)


def compute_bayes_factor_bound(p_value: float) -> float:
    """Bayes factor 1/B for a model against what its checks may see, of their p-value; two at most."""
    x = -math.log(min(max(p_value, LEAST), 1.0))
    return 1 / (0.5 + x / 6) if x < CERTAIN else x**2 / (math.expm1(x) - x)


def average_checks(
    explanations: Sequence[Explanation], check: Callable[[Explanation], float], listed: Callable[[Explanation], bool]
) -> float:
    """P-value of the checks, averaged over the posterior of the listed explanations that have enough of it."""
    entries = [one for one in explanations if one.members and listed(one)]
    norm = sum_log_posterior(entries)
    weighed = [(float(np.exp(one.log_posterior - norm)), one) for one in entries]
    kept = [(weight, one) for weight, one in weighed if weight > WORTH_A_CHECK][:MOST_CHECKED]
    return sum(weight * check(one) for weight, one in kept) / sum(weight for weight, _ in kept)


def _decide_attribution_verdict(slots: Sequence[CredibleGroup], settings: DiagnosisSettings) -> Verdict:
    return "named" if all(slot.probability >= settings.named for slot in slots) else "group"


def _trim_groups(slots: Sequence[CredibleGroup], settings: DiagnosisSettings) -> tuple[CredibleGroup, ...]:
    """The slots with the alternatives that are shown: none beside causes that are all named."""
    most = 1 if _decide_attribution_verdict(slots, settings) == "named" else settings.largest_group
    return tuple(replace(slot, group=slot.group[:most]) for slot in slots)


def is_listed(model: LinearModel, explanation: Explanation) -> bool:
    """Whether all effects of an explanation are listed."""
    return all(model.candidates[k].listed for k in explanation.key)


def _find_best_explanation(listed: list[Explanation], probability: dict[frozenset[int], float]) -> Explanation:
    """The likeliest set, of the likeliest number of effects."""
    by_size: dict[int, float] = defaultdict(float)
    for explanation in listed:
        by_size[len(explanation.key)] += probability[explanation.key]
    size = max(by_size, key=lambda count: by_size[count])
    return next(explanation for explanation in listed if len(explanation.key) == size)


def _build_credible_group(
    model: LinearModel,
    best: Explanation,
    member: SelectedCandidate,
    probability: dict[frozenset[int], float],
    settings: DiagnosisSettings,
) -> CredibleGroup:
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
    return CredibleGroup(member, own, tuple(group))
