"""Attribution: from the evidence of sets of effects to a verdict on the causes, whose probabilities are made in `joint_search`.

A cause is *named* if its probability is at least `DiagnosisSettings.named`. Where several listed effects share the probability
of one place in the explanation, they are a *group* of indistinguishable alternatives. A random process explains a part of
anything that is slow, and none is so much likelier than those without a name that it could be named: its cause is stated by
side, axis and character, with the listed processes as its group. Causes beside something unlisted are a
*partial* answer, and something unlisted alone is *unknown*.

A p-value p is uniform under what is tested. Where something else is at work its density is α p^(α − 1), the smaller α, the more
the test sees of it. α may have any value from 0 to 1 (Sellke, Bayarri and Berger, The American Statistician 55, 2001), so that
a p-value is worth the Bayes factor

    C = ∫₀¹ α p^(α − 1) dα = (1/p − 1 + ln p)/ln² p

which is one half at p = 1 and one at p = 0.17.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from diagnosis.answer import Verdict, label_by_character
from diagnosis.inference.search import BASELINE_EXPLANATION, Explanation, sum_log_posterior
from diagnosis.model.linear import LinearModel, SelectedCandidate
from diagnosis.settings import DEFAULT, DiagnosisSettings

LEAST = 1e-300  # p-value, below which the factor is that of this one
CERTAIN = 1e-4  # −log of a p-value, below which the factor is its series


@dataclass(frozen=True)
class CredibleGroup:
    """One effect of the best explanation, and the alternatives that this recording cannot tell from it."""

    member: SelectedCandidate  # the effect in the explanation
    probability: float  # that it is at work, or a random error of its side and axis where no effect is named
    group_probability: float  # that one of the group is at work, or such a random error
    group: tuple[tuple[str, float], ...]  # labels with probabilities, itself included, the likeliest first
    shares: Mapping[int, float] = field(default_factory=dict)  # probability of every candidate in its place, by its number
    named: bool = True  # whether an effect is stated, or side, axis and character alone

    @property
    def label(self) -> str:
        """Label of what is stated."""
        first, _ = self.group[0]
        return first if self.named else label_by_character(first)


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


def rank_explanations(
    model: LinearModel, explanations: Sequence[Explanation], by_character: bool = True
) -> tuple[RankedExplanation, ...]:
    """Rank sets of effects by their posterior, in the order that they are given in; those that are stated alike are one.

    Random processes are stated by their character, and then are nothing unlisted.
    """
    norm, ranked = sum_log_posterior(list(explanations)), dict[tuple[str, ...], RankedExplanation]()
    for explanation in explanations:
        entries = [model.candidate(member) for member in explanation.members]
        labels = tuple(label_by_character(entry.label) if by_character and entry.process else entry.label for entry in entries)
        probability = float(np.exp(explanation.log_posterior - norm))
        unlisted = not all(entry.listed or (entry.process and by_character) for entry in entries)
        first = ranked.setdefault(labels, RankedExplanation(labels, 0.0, explanation.log_evidence, unlisted))
        ranked[labels] = replace(first, probability=first.probability + probability)
    return tuple(ranked.values())


def rank_all(model: LinearModel, explanations: Sequence[Explanation]) -> Attribution:
    """Rank sets of effects, the likeliest first, without naming a cause: for what is told by the sets themselves."""
    ranked = rank_explanations(model, explanations, by_character=False)
    return Attribution("unknown", explanations[0], (), sum(entry.probability for entry in ranked if entry.unlisted), ranked)


def attribute(
    attribution: Attribution, slots: tuple[CredibleGroup, ...], remainder: bool, settings: DiagnosisSettings = DEFAULT
) -> Attribution:
    """Say what the causes of an attribution amount to, beside a remainder or without one."""
    if not slots:
        return replace(attribution, verdict="unknown", slots=())
    if remainder:
        return replace(attribution, verdict="partial", slots=slots)
    named = all(slot.named and slot.probability >= settings.named for slot in slots)
    return replace(attribution, verdict="named" if named else "group", slots=slots)


def build_unknown_attribution(p_value: float) -> Attribution:
    """Compare M0 with an effect outside the library, equally probable a priori, for a gap that no candidate explains."""
    unknown = 1 / (1 + compute_bayes_factor_bound(p_value))
    nothing, something = (
        RankedExplanation((), 1 - unknown, 0.0, False),
        RankedExplanation(("residuals that are not white, as of no candidate",), unknown, 0.0, True),
    )
    return Attribution("unknown", BASELINE_EXPLANATION, (), unknown, (something, nothing))


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
    share = float(np.exp(sum_log_posterior([BASELINE_EXPLANATION, *explanations]) - norm))
    ranked = [
        replace(entry, probability=entry.probability * share)
        for entry in rank_explanations(model, [BASELINE_EXPLANATION, *explanations])
    ]
    ranked.append(RankedExplanation(("something that no candidate shows",), float(np.exp(hidden - norm)), 0.0, True))
    return tuple(sorted(ranked, key=lambda entry: -entry.probability))


def compute_bayes_factor_bound(p_value: float) -> float:
    """Bayes factor 1/B for a model against what its checks may see, of their p-value; two at most."""
    x = -math.log(min(max(p_value, LEAST), 1.0))
    return 1 / (0.5 + x / 6) if x < CERTAIN else x**2 / (math.expm1(x) - x)
