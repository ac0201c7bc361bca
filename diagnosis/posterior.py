"""Probabilities of causes and of explanations, computed from plain numbers.

The log posteriors of candidates come from `inference.joint_search`, the likelihood ratios of symptoms from the detectors. A
symptom that a cause of the attitude explains is discounted in `model.symptoms`.

| probability of | computed by |
|---|---|
| a cause that the attitude shows | `compute_place_posterior` over all candidates of one place, then `build_credible_group` |
| a cause that the samples show | `compute_symptom_posterior` |
| a cause that both show | `combine_independent` |
| a set of effects that explains the attitude | `rank_explanations`; without a gap `rank_weak_effects` |
| an explanation of the samples and the attitude together | `combine_posteriors` |
| something unlisted behind a gap that no candidate explains | `build_unknown_attribution` |

A cause is *named* if its probability is at least `DiagnosisSettings.named`. Where several listed effects share the probability
of one place in the explanation, they are a *group* of indistinguishable alternatives. A random process explains a part of
any slow error, and no listed process is so much likelier than processes outside the library that it could be named: its cause
is stated by side, axis and character, with the listed processes as its group.

A p-value p is uniform under the tested model. Under another model its density is α p^(α − 1), with a smaller α the more
sensitive the test is to that model. α may have any value from 0 to 1 (Sellke, Bayarri and Berger, The American Statistician 55,
2001), so that a p-value is worth the Bayes factor

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
    """One effect of the best explanation, and the alternatives that this recording cannot distinguish from it."""

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


def build_credible_group(
    candidates: Sequence[Candidate], member: SelectedCandidate, shares: Mapping[int, float], settings: DiagnosisSettings
) -> tuple[CredibleGroup | None, float]:
    """Build the credible group of a place, None where unlisted errors are likelier; and the probability of these.

    Parameters
    ----------
    candidates : of the model
    member : that of the best set in this place
    shares : probability of each candidate in this place, by its number; one minus their sum is that of none of them
    settings : thresholds and priors
    """
    listed = compute_listed_shares(candidates, shares, settings)
    total = sum(listed.values())
    if total < 1 - settings.unknown:
        return None, 1 - total
    characters = {number: sum_character(candidates, shares, number) for number in listed if candidates[number].process}
    stated = {number: characters.get(number, p) for number, p in listed.items()}
    top = max(stated, key=lambda number: (stated[number], listed[number]))
    same_character = [number for number in characters if is_alike(candidates[number], candidates[top])] or [top]
    # Processes that are stated by their character come first, and then the other candidates of the place.
    order = sorted(listed, key=lambda number: (number not in same_character, -listed[number]))
    group = [number for number in order if number == top or listed[number] > settings.group_share * total]
    group = group[: settings.largest_group]
    alternatives = sum(listed[number] for number in group if number not in same_character)
    labelled = tuple((candidates[number].label, listed[number]) for number in group)
    unlisted = 1 - (total if top not in characters else stated[top])
    return CredibleGroup(member, stated[top], stated[top] + alternatives, labelled, shares, top not in characters), unlisted


def compute_listed_shares(
    candidates: Sequence[Candidate], shares: Mapping[int, float], settings: DiagnosisSettings
) -> dict[int, float]:
    """Compute the probability of each listed candidate in a place, by its number, with unlisted random processes as rivals."""
    listed = {number: p for number, p in shares.items() if candidates[number].listed}
    for numbers in group_processes(candidates, shares):
        share = compute_process_share(candidates, {number: shares[number] for number in numbers}, settings)
        total = sum(shares[number] for number in numbers)
        known = sum(listed.get(number, 0.0) for number in numbers)
        listed |= {number: listed[number] * share * total / known for number in numbers if number in listed and known > 0}
    return listed


def sum_character(candidates: Sequence[Candidate], shares: Mapping[int, float], number: int) -> float:
    """Sum the probabilities of all random processes of the side and axis of candidate `number`, listed or not."""
    return sum(p for rival, p in shares.items() if is_alike(candidates[rival], candidates[number]))


def is_alike(first: Candidate, second: Candidate) -> bool:
    """Check whether two candidates are random processes of one side and axis."""
    return first.process and second.process and label_by_character(first.label) == label_by_character(second.label)


def group_processes(candidates: Sequence[Candidate], shares: Mapping[int, float]) -> list[list[int]]:
    """Group random processes of one side and axis, listed ones and the kernels without a name, by their numbers."""
    groups: dict[tuple[bool, str | None], list[int]] = {}
    for number in shares:
        entry = candidates[number]
        if entry.process and (entry.listed or TIME_CONSTANT in entry.options[0].parameters):
            groups.setdefault((entry.effect.startswith("reference"), entry.axis), []).append(number)
    return [numbers for numbers in groups.values() if any(candidates[number].listed for number in numbers)]


def compute_process_share(candidates: Sequence[Candidate], shares: Mapping[int, float], settings: DiagnosisSettings) -> float:
    """Compute the share of listed processes among random processes of one side and axis.

    An unlisted process may have any statistics, also those of a listed one: its evidence is the mean over all processes, that
    of listed processes the mean over these. Both means weigh each process by its prior probability.
    """
    prior = {number: float(np.exp(candidates[number].log_prior)) for number in shares}
    listed = [number for number in shares if candidates[number].listed]
    listed_evidence = sum(shares[number] for number in listed) / sum(prior[number] for number in listed)
    mean_evidence = sum(shares.values()) / sum(prior.values())
    odds = settings.unlisted_share / (1 - settings.unlisted_share) * mean_evidence / max(listed_evidence, LEAST_POSITIVE)
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
    p_value: float, likeness: float, not_motion: float, settings: DiagnosisSettings, is_claimed: bool = True
) -> SymptomPosterior:
    """Compute the posterior of a symptom's explanations from prior odds and Bayes factors.

    Every explanation is weighed against the listed effects, whose weight is one. Where no effect claims the symptom, something
    unlisted has this weight.

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
    weights = np.array([1.0, unlisted, motion, chance] if is_claimed else [0.0, 1.0, motion, chance])
    return SymptomPosterior(*(weights / weights.sum()).tolist())


def compute_bayes_factor_bound(p_value: float) -> float:
    """Compute the Bayes factor 1/C for a model against those that its check is sensitive to, from a p-value; two at most."""
    x = -math.log(min(max(p_value, LEAST_POSITIVE), 1.0))
    return 1 / (0.5 + x / 6) if x < CERTAIN else x**2 / (math.expm1(x) - x)


def combine_independent(first: float, second: float) -> float:
    """Combine the probabilities that two independent parts of the data give to one cause."""
    return 1 - (1 - first) * (1 - second)


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
    """Verdict, causes and probabilities that follow from the ranked explanations."""

    verdict: Verdict  # named, group, partial or unknown
    best: Explanation  # the explanation that the slots belong to; the likeliest of all if partial or unknown
    slots: tuple[CredibleGroup, ...]  # its effects; if partial those that are sure, and none if unknown
    unknown: float  # probability that something unlisted is at work
    ranked: tuple[RankedExplanation, ...]  # all explanations, the likeliest first


def rank_explanations(
    model: LinearModel, explanations: Sequence[Explanation], by_character: bool = True
) -> tuple[RankedExplanation, ...]:
    """Rank sets of effects by their posterior, in the given order; sets with the same labels are merged.

    With `by_character` random processes are labelled by their character, and none of them counts as unlisted.
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


def rank_without_naming(model: LinearModel, explanations: Sequence[Explanation]) -> Attribution:
    """Rank sets of effects, the likeliest first, without identifying a cause; random processes keep their own labels."""
    ranked = rank_explanations(model, explanations, by_character=False)
    unlisted = sum(explanation.probability for explanation in ranked if explanation.unlisted)
    return Attribution("unknown", explanations[0], (), unlisted, ranked)


def build_unknown_attribution(p_value: float) -> Attribution:
    """Compare M0 with an effect outside the library, equally probable a priori, for a gap that no candidate explains."""
    unknown = 1 / (1 + compute_bayes_factor_bound(p_value))
    baseline, outside = (
        RankedExplanation((), 1 - unknown, 0.0, False),
        RankedExplanation(("residuals that are not white, as of no candidate",), unknown, 0.0, True),
    )
    return Attribution("unknown", BASELINE_EXPLANATION, (), unknown, (outside, baseline))


def rank_weak_effects(
    model: LinearModel, explanations: Sequence[Explanation], p_value: float, settings: DiagnosisSettings = DEFAULT
) -> tuple[RankedExplanation, ...]:
    """Rank M0 and effects that may be present but too weak to identify, for a recording without a gap.

    Parameters
    ----------
    model : the candidates
    explanations : one effect each, with its evidence, which is small
    p_value : of M0's residuals of all references, which would show an effect outside the library that no candidate shows

    Returns
    -------
    All of them, the likeliest first
    """
    log_unlisted = float(np.log(settings.unlisted_share / compute_bayes_factor_bound(p_value)))
    norm = float(np.logaddexp(sum_log_posterior([BASELINE_EXPLANATION, *explanations]), log_unlisted))
    listed_probability = float(np.exp(sum_log_posterior([BASELINE_EXPLANATION, *explanations]) - norm))
    ranked = [
        replace(explanation, probability=explanation.probability * listed_probability)
        for explanation in rank_explanations(model, [BASELINE_EXPLANATION, *explanations])
    ]
    ranked.append(RankedExplanation(("something that no candidate shows",), float(np.exp(log_unlisted - norm)), 0.0, True))
    return tuple(sorted(ranked, key=lambda explanation: -explanation.probability))


def sum_by_labels(ranked: Sequence[RankedExplanation], odds: float = 1.0) -> dict[tuple[str, ...], float]:
    """Sum the probabilities of ranked explanations by their labels, that of each effect times `odds`."""
    sums: dict[tuple[str, ...], float] = {}
    for explanation in ranked:
        labels = UNKNOWN_LABELS if explanation.unlisted else tuple(sorted(explanation.labels))
        sums[labels] = sums.get(labels, 0.0) + explanation.probability * (odds if labels else 1.0)
    return sums


def list_attitude_explanations(attribution: Attribution | None) -> Explanations:
    """List the explanations of the data of a linear model, to a sum of `KEPT`; the empty one without a gap."""
    return (((), 1.0),) if attribution is None else select_likeliest(sum_by_labels(attribution.ranked))


def list_explanations_without_gap(
    ranked: Sequence[RankedExplanation], has_sample_findings: bool, settings: DiagnosisSettings
) -> Explanations:
    """List M0 and effects too weak to identify; beside findings in the samples each counts as one more effect."""
    if not ranked:
        return (((), 1.0),)
    sums = sum_by_labels(ranked, settings.another / (1 - settings.another) if has_sample_findings else 1.0)
    norm = sum(sums.values())
    return select_likeliest({labels: p / norm for labels, p in sums.items()})


# ---- all parts of the data together --------------------------------------------------------------------------------------


class SymptomSummary(NamedTuple):
    """Probabilities of one symptom of the samples."""

    kind: str  # symptoms of one kind have one unlisted cause or none
    listed: float  # probability that nothing unlisted makes it
    # labels of the effects that may make it, with their shares of the probability; none if no effect claims it
    shares: tuple[tuple[str, float], ...]


def compute_conditional_listed(symptoms: Sequence[SymptomSummary]) -> list[float]:
    """Compute for each symptom the probability that no unlisted effect makes it, given that none makes those before it.

    An effect on one gyro acts on the others, too: the symptoms of one kind have one unlisted cause or none.
    """
    conditional: list[float] = []
    least: dict[str, float] = {}
    for symptom in symptoms:
        before = least.get(symptom.kind, 1.0)
        least[symptom.kind] = min(before, symptom.listed)
        conditional.append(least[symptom.kind] / before if before > 0 else 0.0)
    return conditional


def combine_posteriors(symptoms: Sequence[SymptomSummary], attitude: Explanations) -> Explanations:
    """Combine the explanations of the samples and of the attitude; to a sum of `KEPT`."""
    by_samples: dict[tuple[str, ...], float] = {(): 1.0}
    for symptom, listed in zip(symptoms, compute_conditional_listed(symptoms), strict=True):
        if symptom.shares:
            by_samples = {
                (*labels, label): p * listed * share for labels, p in by_samples.items() for label, share in symptom.shares
            }
        else:
            by_samples = {labels: p * listed for labels, p in by_samples.items()}
    sums: dict[tuple[str, ...], float] = {}
    for labels, p in attitude:
        for sample_labels, share in by_samples.items():
            combined = (
                labels if "unknown" in labels else (*sample_labels, *(label for label in labels if label not in sample_labels))
            )
            sums[combined] = sums.get(combined, 0.0) + p * share
    # The rest of the probability is that of an unlisted effect behind a symptom.
    sums[UNKNOWN_LABELS] = sums.get(UNKNOWN_LABELS, 0.0) + 1 - sum(sums.values())
    return select_likeliest({labels: p for labels, p in sums.items() if p > 0})


def join_explanations(attitude: Explanations, sensors: Explanations) -> Explanations:
    """Join the explanations of the attitude and of the raw sensor tables, which are independent of one another."""
    sums: dict[tuple[str, ...], float] = {}
    for attitude_labels, p in attitude:
        for sensor_labels, q in sensors:
            labels = (
                UNKNOWN_LABELS if UNKNOWN_LABELS in (attitude_labels, sensor_labels) else (*attitude_labels, *sensor_labels)
            )
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
