"""Probabilities of explanations, which are sets of effects: of the attitude, of what the samples show, and of both together.

The probability of one cause is made by `diagnosis.inference.joint_search.build_slot`; that of a cause which the samples show,
by `diagnosis.model.symptoms.compute_posterior`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from diagnosis.answer import Explanations
from diagnosis.inference.attribution import Attribution, RankedExplanation
from diagnosis.model.symptoms import OF_NOISE, SampleCause
from diagnosis.settings import DiagnosisSettings

if TYPE_CHECKING:
    from diagnosis.explain import AttitudeInference


KEPT = 0.999  # of the posterior


def combine_posteriors(
    samples: Sequence[SampleCause], explained: AttitudeInference, gap: bool, settings: DiagnosisSettings
) -> Explanations:
    """Probability of each explanation, those of the samples and of the attitude together; to a sum of `KEPT`."""
    shown: dict[tuple[str, ...], float] = {(): 1.0}
    for one, likely in zip(samples, list_listed(samples, settings), strict=True):
        if one.effect is None:
            shown = {labels: p * likely for labels, p in shown.items()}
            continue
        cause = one.cause(settings)
        shares = (one.share, *(share for _, share in one.rivals))
        shown = {
            (*labels, name): p * likely * share
            for labels, p in shown.items()
            for name, share in zip(cause.group, shares, strict=True)
        }
    found: dict[tuple[str, ...], float] = {}
    attitude = (
        list_attitude_explanations(explained.attribution)
        if gap
        else _rank_without_gap(explained.unseen, bool(samples), settings)
    )
    for labels, p in attitude:
        for own, share in shown.items():
            both = labels if "unknown" in labels else (*own, *(label for label in labels if label not in own))
            found[both] = found.get(both, 0.0) + p * share
    # Something unlisted may have made what the samples show.
    found[("unknown",)] = found.get(("unknown",), 0.0) + 1 - sum(found.values())
    return select_likeliest({labels: p for labels, p in found.items() if p > 0})


def list_listed(samples: Sequence[SampleCause], settings: DiagnosisSettings) -> list[float]:
    """List the probability of each symptom that nothing unlisted makes it, given that of those before.

    What acts on one gyro acts on others: the symptoms of one kind have one unlisted cause or none.
    """
    found: list[float] = []
    least: dict[str, float] = {}
    for one in samples:
        kind = "noise" if one.symptom.kind in OF_NOISE else one.symptom.kind
        before = least.get(kind, 1.0)
        listed = one.compute_listed(settings)
        least[kind] = min(before, listed)
        found.append(least[kind] / before if before > 0 else 0.0)
    return found


def _rank_without_gap(unseen: Sequence[RankedExplanation], beside: bool, settings: DiagnosisSettings) -> Explanations:
    """Rank M0 and effects too weak to identify; beside findings in the samples each counts as one more effect."""
    if not unseen:
        return (((), 1.0),)
    odds = settings.another / (1 - settings.another) if beside else 1.0
    found: dict[tuple[str, ...], float] = {}
    for one in unseen:
        labels = ("unknown",) if one.unlisted else tuple(sorted(one.labels))
        found[labels] = found.get(labels, 0.0) + one.probability * (odds if labels else 1.0)
    norm = sum(found.values())
    return select_likeliest({labels: p / norm for labels, p in found.items()})


def list_attitude_explanations(attribution: Attribution | None) -> Explanations:
    """Probability of each explanation of the data of a linear model, to a sum of `KEPT`; the empty one without a gap."""
    if attribution is None:
        return (((), 1.0),)
    found: dict[tuple[str, ...], float] = {}
    for one in attribution.ranked:
        labels = ("unknown",) if one.unlisted else tuple(sorted(one.labels))
        found[labels] = found.get(labels, 0.0) + one.probability
    return select_likeliest(found)


def select_likeliest(found: Mapping[tuple[str, ...], float]) -> Explanations:
    """Explanations with their probabilities, the likeliest first, to a sum of `KEPT`."""
    out, total = [], 0.0
    for labels, probability in sorted(found.items(), key=lambda pair: -pair[1]):
        out.append((labels, probability))
        total += probability
        if total >= KEPT:
            break
    return tuple(out)
