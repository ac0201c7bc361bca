"""Probabilities of causes and of explanations: all of them are made here, from plain numbers.

| probability of | made by |
|---|---|
| a cause that the attitude shows | `compute_place_posterior` over all candidates for one place of a set, then `build_slot` |
| a cause that the samples show | `compute_symptom_posterior` |
| a cause that both show | `combine_independent` |
| a set of effects that explains the attitude | `rank_explanations`; without a gap `rank_weak_effects` |
| an explanation of the samples and the attitude together | `combine_posteriors` |
| something unlisted behind a gap that no candidate explains | `build_unknown_attribution` |

A cause is *named* if its probability is at least `DiagnosisSettings.named`. Where several listed effects share the probability
of one place in the explanation, they are a *group* of indistinguishable alternatives. A random process explains a part of
anything that is slow, and none is so much likelier than those without a name that it could be named: its cause is stated by
side, axis and character, with the listed processes as its group.

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
from typing import NamedTuple

import numpy as np

from diagnosis.answer import Explanations, Verdict, label_by_character
from diagnosis.inference.search import BASELINE_EXPLANATION, Explanation, sum_log_posterior
from diagnosis.model.linear import Candidate, LinearModel, SelectedCandidate
from diagnosis.settings import DEFAULT, DiagnosisSettings

KEPT = 0.999  # of the posterior
TESTS = 30  # of the samples of a recording, over which the prior probability of one more effect is spread
TIME_CONSTANT = "time_constant_s"  # parameter of random errors without a name that a listed process may be one of
LEAST_POSITIVE = 1e-300
LARGEST_P = float(np.exp(-1))  # p-value up to which the bound on the Bayes factor of a small p-value holds
CERTAIN = 1e-4  # −log of a p-value, below which the Bayes factor of a test of behaviour is its series
UNKNOWN_LABELS = ("unknown",)


# ---- causes that the attitude shows --------------------------------------------------------------------------------------


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


def compute_place_posterior(log_posteriors: Mapping[int, float], rival: float) -> tuple[dict[int, float], float]:
    """Compute the probability of each candidate in one place of a set, and that of none of them.

    Parameters
    ----------
    log_posteriors : of the set with each candidate in this place, by its number, not normalised
    rival : log posterior of the best set in which nothing listed stands in this place
    """
    norm = float(np.logaddexp.reduce([rival, *log_posteriors.values()]))
    return {number: float(np.exp(value - norm)) for number, value in log_posteriors.items()}, float(np.exp(rival - norm))


def build_slot(
    candidates: Sequence[Candidate], member: SelectedCandidate, shares: Mapping[int, float], settings: DiagnosisSettings
) -> tuple[CredibleGroup | None, float]:
    """Build the credible group of a place, None where unlisted errors are likelier; and the probability of these.

    Parameters
    ----------
    candidates : of the model
    member : that of the best set in this place
    shares : probability of each candidate in this place, by its number; what is missing to one is that of none of them
    settings : thresholds and priors
    """
    listed = compute_listed_shares(candidates, shares, settings)
    total = sum(listed.values())
    if total < 1 - settings.unknown:
        return None, 1 - total
    characters = {number: sum_character(candidates, shares, number) for number in listed if candidates[number].process}
    stated = {number: characters.get(number, p) for number, p in listed.items()}
    top = max(stated, key=lambda number: (stated[number], listed[number]))
    alike = [number for number in characters if is_alike(candidates[number], candidates[top])] or [top]
    # Processes that are stated by their character come first, and then what else may stand in the place.
    order = sorted(listed, key=lambda number: (number not in alike, -listed[number]))
    group = [number for number in order if number == top or listed[number] > settings.group_share * total]
    group = group[: settings.largest_group]
    beside = sum(listed[number] for number in group if number not in alike)
    shown = tuple((candidates[number].label, listed[number]) for number in group)
    unlisted = 1 - (total if top not in characters else stated[top])
    return CredibleGroup(member, stated[top], stated[top] + beside, shown, shares, top not in characters), unlisted


def compute_listed_shares(
    candidates: Sequence[Candidate], shares: Mapping[int, float], settings: DiagnosisSettings
) -> dict[int, float]:
    """Compute the probability of each listed candidate in a place, by its number; random processes share with the unlisted."""
    listed = {number: p for number, p in shares.items() if candidates[number].listed}
    for numbers in group_processes(candidates, shares):
        named = compute_named_share(candidates, {number: shares[number] for number in numbers}, settings)
        total = sum(shares[number] for number in numbers)
        known = sum(listed.get(number, 0.0) for number in numbers)
        listed |= {number: listed[number] * named * total / known for number in numbers if number in listed and known > 0}
    return listed


def sum_character(candidates: Sequence[Candidate], shares: Mapping[int, float], number: int) -> float:
    """Sum the probabilities of all random processes of the side and axis of one, listed or not."""
    return sum(p for other, p in shares.items() if is_alike(candidates[other], candidates[number]))


def is_alike(one: Candidate, other: Candidate) -> bool:
    """Whether two candidates are random processes of one side and axis."""
    return one.process and other.process and label_by_character(one.label) == label_by_character(other.label)


def group_processes(candidates: Sequence[Candidate], shares: Mapping[int, float]) -> list[list[int]]:
    """Group random processes of one side and axis, listed ones and the kernels without a name, by their numbers."""
    groups: dict[tuple[bool, str | None], list[int]] = {}
    for number in shares:
        entry = candidates[number]
        if entry.process and (entry.listed or TIME_CONSTANT in entry.options[0].parameters):
            groups.setdefault((entry.effect.startswith("reference"), entry.axis), []).append(number)
    return [numbers for numbers in groups.values() if any(candidates[number].listed for number in numbers)]


def compute_named_share(candidates: Sequence[Candidate], shares: Mapping[int, float], settings: DiagnosisSettings) -> float:
    """Compute the share of listed processes among random processes of one side and axis.

    A process without a name may have any statistics, those of a listed one among them: its evidence is the mean of all, that of
    what is on the list the mean of the listed ones.
    """
    prior = {number: float(np.exp(candidates[number].log_prior)) for number in shares}
    listed = [number for number in shares if candidates[number].listed]
    of_listed = sum(shares[number] for number in listed) / sum(prior[number] for number in listed)
    of_all = sum(shares.values()) / sum(prior.values())
    odds = settings.unlisted_share / (1 - settings.unlisted_share) * of_all / max(of_listed, LEAST_POSITIVE)
    return 1 / (1 + odds)


# ---- causes that the samples show ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SymptomPosterior:
    """Posterior probabilities of a symptom's explanations; they add up to one."""

    listed: float  # the effect that claims it, or a listed rival
    unlisted: float  # something unlisted
    motion: float  # a motion of the body
    chance: float  # noise of M0


def compute_symptom_posterior(
    p_value: float, likeness: float, not_motion: float, settings: DiagnosisSettings, claimed: bool = True
) -> SymptomPosterior:
    """Compute the posterior of a symptom's explanations from prior odds and Bayes factors.

    Every explanation is weighed against the listed effects, whose weight is one. A symptom that no effect claims is that of
    something unlisted with the same weight.

    - *Chance.* One more effect has the prior odds π/(1 − π), spread over `TESTS`. Under M0 the p-value is uniform. Where an
      effect is at work it is small: over the densities a p^(a−1) with 0 < a < 1, the Bayes factor is at most 1/(−e p ln p)
      (Sellke, Bayarri and Berger, American Statistician 55, 2001). The weight is the inverse of prior odds times that factor.
    - *Unlisted.* The prior odds are ι/(1 − ι). The p-value of how the symptom behaves, `likeness`, is uniform under the listed
      effect and has any power law under something unlisted, which gives the Bayes factor of `compute_bayes_factor_bound`;
      without such a test it is one.
    - *Motion.* Where a likelihood has compared the effect with a motion of the body, its probability r, `not_motion`, gives the
      odds (1 − r)/r.
    """
    prior = settings.another / (1 - settings.another) / TESTS
    p = min(max(p_value, LEAST_POSITIVE), LARGEST_P)
    chance = -math.e * p * np.log(p) / prior
    behaviour = compute_bayes_factor_bound(likeness) if likeness < 1 else 1.0
    unlisted = settings.unlisted_in_samples / (1 - settings.unlisted_in_samples) / behaviour
    motion = 1 / max(not_motion, LEAST_POSITIVE) - 1
    weights = np.array([1.0, unlisted, motion, chance] if claimed else [0.0, 1.0, motion, chance])
    return SymptomPosterior(*(weights / weights.sum()).tolist())


def compute_bayes_factor_bound(p_value: float) -> float:
    """Compute the Bayes factor 1/C for a model against what its checks may see, of their p-value; two at most."""
    x = -math.log(min(max(p_value, LEAST_POSITIVE), 1.0))
    return 1 / (0.5 + x / 6) if x < CERTAIN else x**2 / (math.expm1(x) - x)


def combine_independent(one: float, other: float) -> float:
    """Combine the probabilities that two independent parts of the data give to one cause."""
    return 1 - (1 - one) * (1 - other)


# ---- sets of effects that explain the attitude ---------------------------------------------------------------------------


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
    for one in explanations:
        entries = [model.candidate(member) for member in one.members]
        labels = tuple(label_by_character(entry.label) if by_character and entry.process else entry.label for entry in entries)
        probability = float(np.exp(one.log_posterior - norm))
        unlisted = not all(entry.listed or (entry.process and by_character) for entry in entries)
        first = ranked.setdefault(labels, RankedExplanation(labels, 0.0, one.log_evidence, unlisted))
        ranked[labels] = replace(first, probability=first.probability + probability)
    return tuple(ranked.values())


def rank_all(model: LinearModel, explanations: Sequence[Explanation]) -> Attribution:
    """Rank sets of effects, the likeliest first, without naming a cause: for what is told by the sets themselves."""
    ranked = rank_explanations(model, explanations, by_character=False)
    return Attribution("unknown", explanations[0], (), sum(one.probability for one in ranked if one.unlisted), ranked)


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
    share = float(np.exp(sum_log_posterior([BASELINE_EXPLANATION, *explanations]) - norm))
    ranked = [
        replace(one, probability=one.probability * share)
        for one in rank_explanations(model, [BASELINE_EXPLANATION, *explanations])
    ]
    ranked.append(RankedExplanation(("something that no candidate shows",), float(np.exp(hidden - norm)), 0.0, True))
    return tuple(sorted(ranked, key=lambda one: -one.probability))


def sum_by_labels(ranked: Sequence[RankedExplanation], odds: float = 1.0) -> dict[tuple[str, ...], float]:
    """Sum the probabilities of ranked explanations by their labels, that of each effect times `odds`."""
    sums: dict[tuple[str, ...], float] = {}
    for one in ranked:
        labels = UNKNOWN_LABELS if one.unlisted else tuple(sorted(one.labels))
        sums[labels] = sums.get(labels, 0.0) + one.probability * (odds if labels else 1.0)
    return sums


def list_attitude_explanations(attribution: Attribution | None) -> Explanations:
    """List the explanations of the data of a linear model, to a sum of `KEPT`; the empty one without a gap."""
    return (((), 1.0),) if attribution is None else select_likeliest(sum_by_labels(attribution.ranked))


def list_explanations_without_gap(
    ranked: Sequence[RankedExplanation], beside: bool, settings: DiagnosisSettings
) -> Explanations:
    """List M0 and effects too weak to identify; beside findings in the samples each counts as one more effect."""
    if not ranked:
        return (((), 1.0),)
    sums = sum_by_labels(ranked, settings.another / (1 - settings.another) if beside else 1.0)
    norm = sum(sums.values())
    return select_likeliest({labels: p / norm for labels, p in sums.items()})


# ---- all parts of the data together --------------------------------------------------------------------------------------


class SymptomSummary(NamedTuple):
    """Probabilities of one symptom of the samples."""

    kind: str  # symptoms of one kind have one unlisted cause or none
    listed: float  # probability that nothing unlisted makes it
    shares: tuple[
        tuple[str, float], ...
    ]  # labels of the effects that may make it, with their shares; none if no effect claims it


def list_listed(symptoms: Sequence[SymptomSummary]) -> list[float]:
    """List the probability of each symptom that nothing unlisted makes it, given that of those before.

    What acts on one gyro acts on others: the symptoms of one kind have one unlisted cause or none.
    """
    conditional: list[float] = []
    least: dict[str, float] = {}
    for one in symptoms:
        before = least.get(one.kind, 1.0)
        least[one.kind] = min(before, one.listed)
        conditional.append(least[one.kind] / before if before > 0 else 0.0)
    return conditional


def combine_posteriors(symptoms: Sequence[SymptomSummary], attitude: Explanations) -> Explanations:
    """Combine the explanations of the samples and of the attitude; to a sum of `KEPT`."""
    shown: dict[tuple[str, ...], float] = {(): 1.0}
    for one, listed in zip(symptoms, list_listed(symptoms), strict=True):
        if one.shares:
            shown = {(*labels, label): p * listed * share for labels, p in shown.items() for label, share in one.shares}
        else:
            shown = {labels: p * listed for labels, p in shown.items()}
    sums: dict[tuple[str, ...], float] = {}
    for labels, p in attitude:
        for beside, share in shown.items():
            both = labels if "unknown" in labels else (*beside, *(label for label in labels if label not in beside))
            sums[both] = sums.get(both, 0.0) + p * share
    # Something unlisted may have made what the samples show.
    sums[UNKNOWN_LABELS] = sums.get(UNKNOWN_LABELS, 0.0) + 1 - sum(sums.values())
    return select_likeliest({labels: p for labels, p in sums.items() if p > 0})


def join_explanations(attitude: Explanations, sensors: Explanations) -> Explanations:
    """Join the explanations of the attitude and of the raw sensor tables, which are independent of one another."""
    sums: dict[tuple[str, ...], float] = {}
    for one, p in attitude:
        for other, q in sensors:
            labels = UNKNOWN_LABELS if UNKNOWN_LABELS in (one, other) else (*one, *other)
            sums[labels] = sums.get(labels, 0.0) + p * q
    return select_likeliest(sums)


def select_likeliest(sums: Mapping[tuple[str, ...], float]) -> Explanations:
    """Select explanations with their probabilities, the likeliest first, to a sum of `KEPT`."""
    selected, total = [], 0.0
    for labels, probability in sorted(sums.items(), key=lambda pair: -pair[1]):
        selected.append((labels, probability))
        total += probability
        if total >= KEPT:
            break
    return tuple(selected)
