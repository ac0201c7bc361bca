"""The attitude's part of a diagnosis: linear model, explanations, attribution, amplitudes, checks, closure."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from diagnosis.answer import Closure
from diagnosis.budget import Step, convert, measure_causes, select_closing, summarise_closure
from diagnosis.inference.amplitudes import FittedEffect, estimate_amplitudes, refine_explanation
from diagnosis.inference.attribution import (
    Attribution,
    RankedExplanation,
    average_checks,
    build_unknown_attribution,
    compute_bayes_factor_bound,
    infer_attribution,
    is_listed,
    rank_beside_remainder,
    rank_weak_effects,
    weigh_unlisted,
)
from diagnosis.inference.closure import compute_closure
from diagnosis.inference.criticism import Check, check_explanation, combine_checks
from diagnosis.inference.null import compute_null_p
from diagnosis.inference.refinement import search_with_refined_options
from diagnosis.inference.search import BASELINE_EXPLANATION, Explanation, Search
from diagnosis.model.calibration import calibrate_with_effects
from diagnosis.model.candidates import build_linear_model
from diagnosis.model.known_effects import select_known_effects
from diagnosis.model.layout import tabulate_observations
from diagnosis.model.linear import Candidate, LinearModel, SelectedCandidate
from diagnosis.model.misfit import check_baseline, compute_attitude_errors
from diagnosis.model.noise_classification import reclassify_without_effects
from diagnosis.model.prepare import PreparedRecording, Progress
from diagnosis.model.recording_model import RecordingModel
from diagnosis.model.symptoms import list_sample_causes
from diagnosis.remainder_search import BesideRemainder, identify_beside_remainder
from diagnosis.settings import DiagnosisSettings
from simulator.effects.base import Effect

Array = NDArray[np.float64]

Checker = Callable[[LinearModel, tuple[SelectedCandidate, ...]], tuple[Check, ...]]  # checks of an explanation


@dataclass(frozen=True)
class AttitudeInference:
    """What the attitude says."""

    candidates: tuple[Candidate, ...]  # what the linear model of the recording tried
    p_value: float  # that M0 alone departs so far
    attribution: Attribution | None  # None without a gap
    fitted: tuple[FittedEffect, ...]  # amplitudes of the effects that are named
    checks: tuple[Check, ...]  # of what the named effects leave
    closed: Closure | None  # how far the gap closes on held-out data
    # change, covariance: of the calibration with the named effects in the model, (12,), and of it and their amplitudes
    change: Array
    covariance: Array
    # p-value of the checks of all listed explanations together, averaged over their posterior; None without a check
    passed: float | None = None
    left: tuple[Check, ...] = ()  # what M0 leaves of all references, before any averaging
    unseen: tuple[RankedExplanation, ...] = ()  # without a gap, the probability of M0 and of what is too weak to be told
    rejected: tuple[FittedEffect, ...] = ()  # amplitudes of those that would be, but for the checks of what they leave
    first: tuple[FittedEffect, ...] = ()  # amplitudes of the listed effects of the likeliest explanation without a remainder
    # effects identified in the presence of a remainder, where the listed effects alone do not explain the data
    beside: BesideRemainder | None = None
    budget: tuple[Step, ...] = ()  # steps of the gap budget on held-out data; none without a gap


def explain_prepared(
    prepared: PreparedRecording, effects: Sequence[Effect], settings: DiagnosisSettings, seed: int, tell: Progress
) -> tuple[PreparedRecording, AttitudeInference]:
    """Explain what the attitude shows of a prepared recording, which may be judged anew; parameters as of `diagnose`.

    The references' noise was judged with all effects in the residuals, and is judged anew without those that are found. Where
    the checks reject these, a wrong judgement may be why: it is taken back if they are found again without it.
    """
    explained = explain(prepared, effects, settings, seed, tell)
    once_more = partial(_tell_repetition, tell)
    at_work = select_known_effects(explained.fitted or explained.rejected, {effect.name: effect for effect in effects})
    again = reclassify_without_effects(prepared, at_work, settings, once_more)
    if again is not None:
        anew = explain(again, effects, settings, seed, once_more)
        found, before = ({(one.effect, one.axis) for one in part} for part in (anew.fitted, explained.rejected))
        prepared, explained = (again, anew) if before <= found else (prepared, explained)
    return prepared, _add_remainder(prepared, explained, effects, settings, once_more)


def _add_remainder(
    prepared: PreparedRecording,
    explained: AttitudeInference,
    effects: Sequence[Effect],
    settings: DiagnosisSettings,
    tell: Progress,
) -> AttitudeInference:
    """Judge effects in the presence of a remainder where listed effects alone do not explain the data.

    So it is where the samples show something unlisted, and where an explanation needs as many effects as one may have and a
    random process among them. One list of causes has the probabilities, the budget and the share that they close.
    """
    attribution = explained.attribution
    if attribution is None:
        return explained
    full = len(explained.fitted) == settings.largest_set and any(one.process for one in explained.fitted)
    model = prepared.model
    odd = [one for one in list_sample_causes(prepared, effects, settings) if one.effect is None]
    odd = [one for one in odd if one.compute_listed(settings) < 1 - settings.unknown]
    if attribution.verdict in ("named", "group") and not full and not odd:
        whole = _add_budget(model, explained)
        if whole.fitted:
            return whole
    beside = identify_beside_remainder(
        model, effects, settings, tell, explained.first, list(zip(attribution.slots, explained.fitted, strict=True))
    )
    fitted = tuple(
        replace(one, columns=convert(beside.model, model, one.columns), shift=convert(beside.model, model, one.shift))
        for one in beside.fitted
    )
    found = replace(explained, fitted=fitted, closed=beside.closed, beside=beside, budget=beside.budget)
    if not fitted:
        unknown = attribution.unknown if attribution.verdict == "unknown" else 1.0
        nothing = replace(attribution, verdict="unknown", slots=(), unknown=unknown)
        return replace(found, attribution=nothing, change=np.zeros(12), rejected=explained.fitted or explained.rejected)
    unknown = max(attribution.unknown, 1 - min(slot.probability for slot in beside.slots))
    partial_answer = replace(
        attribution, verdict="partial", slots=beside.slots, unknown=unknown, ranked=rank_beside_remainder(beside.slots)
    )
    return replace(found, attribution=partial_answer, change=beside.change, covariance=beside.covariance, checks=())


def _add_budget(model: RecordingModel, explained: AttitudeInference) -> AttitudeInference:
    """Add the budget to an explanation that needs no remainder, and leave out causes that close less than nothing."""
    assert explained.attribution is not None
    slots, fitted = explained.attribution.slots, explained.fitted
    while True:
        held, _, budget = measure_causes(model, model, slots, fitted)
        closing = select_closing(slots, budget)
        if len(closing) == len(slots):
            break
        fitted = tuple(one for slot, one in zip(slots, fitted, strict=True) if slot in closing)
        slots = tuple(closing)
    change, covariance = calibrate_with_effects(model, fitted)
    return replace(
        explained, attribution=replace(explained.attribution, slots=slots), fitted=fitted, budget=budget, change=change,
        covariance=covariance, closed=summarise_closure(held) if fitted else None,
    )  # fmt: skip


def _tell_repetition(tell: Progress, text: str, share: float) -> None:
    """Progress of what is done once more, at the end of all."""
    tell(f"once more: {text}", 0.97 + 0.03 * share)


def explain(
    prepared: PreparedRecording,
    effects: Sequence[Effect],
    settings: DiagnosisSettings,
    seed: int,
    tell: Progress,
) -> AttitudeInference:
    """Infer the causes of a recording's attitude misfit."""
    model = prepared.model
    tell("candidates", 0.1)
    left = check_baseline(model) if prepared.is_white else ()
    by_name = {effect.name: effect for effect in effects}
    table = tabulate_observations(model)

    def check(found: LinearModel, members: tuple[SelectedCandidate, ...]) -> tuple[Check, ...]:
        return (*check_explanation(found, members, table, seed), *_check_all_references(prepared, found, members, by_name))

    of_all = combine_checks(left) if left else None
    told = count_progress(tell, "candidates", 0.1, 0.3, 100)
    # No name for it here: the columns of a long recording are hundreds of megabytes, which are let go before the end.
    explained = infer_causes(
        build_linear_model(model, effects, settings, tell=told), check, settings, seed, tell, left=of_all
    )  # fmt: skip
    change, covariance = calibrate_with_effects(model, explained.fitted)
    return replace(explained, change=change, covariance=covariance, left=left)


def _check_all_references(
    prepared: PreparedRecording, linear: LinearModel, members: tuple[SelectedCandidate, ...], effects: Mapping[str, Effect]
) -> tuple[Check, ...]:
    """What M0 with the named effects leaves of all references, where columns at one set of parameters describe them all."""
    beside = []
    if not prepared.is_white:
        return ()
    for member in members:
        entry, effect = linear.candidate(member), effects.get(linear.candidate(member).effect)
        if effect is None or entry.process or not effect.has_columns or effect.stage == "clock":
            return ()
        beside.append(compute_attitude_errors(prepared.model, effect, entry.axis, linear.option(member).parameters))
        if beside[-1].shape[2] != linear.option(member).count:  # with the rounding of a covariate
            return ()
    return tuple(replace(one, name=f"{one.name}, of all references") for one in check_baseline(prepared.model, beside))


def skip_checks(linear: LinearModel, members: tuple[SelectedCandidate, ...]) -> tuple[Check, ...]:
    """No checks."""
    return ()


def infer_causes(
    linear: LinearModel,
    check: Checker,
    settings: DiagnosisSettings,
    seed: int,
    tell: Progress,
    shown: float = 1.0,
    left: float | None = None,
) -> AttitudeInference:
    """Infer causes from a linear model, whatever it was built from; without a calibration.

    Parameters
    ----------
    linear : the observations and their candidates
    check : checks of what an explanation leaves
    settings, seed, tell : as for `explain`
    shown : p-value of what shows a gap beside the candidates
    left : p-value of what M0 leaves of all references, which is a gap but says nothing of its cause; None if it was not asked
    """
    search = Search(linear, settings, count_progress(tell, "explanations", 0.5, 0.6, 1000))
    told = partial(tell, "null distribution")
    p = compute_null_p(search, seed, settings.null_draws, settings.scanned_share, lambda share: told(0.35 + 0.15 * share))
    quiet: tuple[RankedExplanation, ...] = ()
    share, of_all = (0.0, 1.0) if left is None else (settings.misfit_share, left)
    p, left = min(p / (1 - share), shown), 1.0 if left is None else left / share
    attribution: Attribution | None = None
    fitted: tuple[FittedEffect, ...] = ()
    rejected: tuple[FittedEffect, ...] = ()
    first: tuple[FittedEffect, ...] = ()
    checks: tuple[Check, ...] = ()
    passed: float | None = None
    closed: Closure | None = None
    if p < settings.false_alarm_rate:
        tell("explanations", 0.5)
        linear, explanations = search_with_refined_options(
            search, settings, count_progress(tell, "finer explanations", 0.6, 0.7, 1000)
        )
        weighed = sorted([*explanations, BASELINE_EXPLANATION], key=lambda one: -one.log_posterior)
        attribution = infer_attribution(linear, weighed, settings)
        tell("amplitudes", 0.7)
        # Beside something unlisted, listed effects are fitted with it in the model.
        unlisted = attribution.verdict in ("partial", "unknown")
        members = attribution.best.members if unlisted else tuple(slot.member for slot in attribution.slots)
        if members:
            stated = [member in [slot.member for slot in attribution.slots] for member in members]
            linear, members = refine_explanation(linear, members)
            tell("amplitudes", 0.72)
            parts = estimate_amplitudes(linear, members)
            first = tuple(one for one, member in zip(parts, members, strict=True) if linear.candidate(member).listed)
            fitted = tuple(itertools.compress(parts, stated))
        if attribution.slots:
            tell("checks", 0.74)
            checks = check(linear, members)
            passed = combine_checks(checks) if checks else None
            if passed is not None and compute_bayes_factor_bound(passed) < 1 and not unlisted:
                step = map(count_progress(tell, "checks", 0.75, 0.85, 5), itertools.count()).__next__
                passed = average_checks(weighed, partial(_compute_check_p, linear, check, step), partial(is_listed, linear))
            attribution = weigh_unlisted(linear, attribution, passed, settings)
            if not attribution.slots:
                members, fitted, rejected = (), (), fitted
            tell("held-out data", 0.85)
            closed = compute_closure(linear, members) if members else None
    elif left < settings.false_alarm_rate:
        attribution = build_unknown_attribution(left)
    else:
        quiet = rank_weak_effects(linear, search.score_singles(), of_all, settings)
    return AttitudeInference(
        linear.candidates, min(p, left, 1.0), attribution, fitted, checks, closed, np.zeros(12), np.zeros((12, 12)), passed,
        unseen=quiet, rejected=rejected, first=first,
    )  # fmt: skip


def _compute_check_p(
    linear: LinearModel,
    check: Checker,
    tell: Callable[[], None],
    explanation: Explanation,
) -> float:
    """P-value of all checks of an explanation together, told of before."""
    tell()
    return combine_checks(check(*refine_explanation(linear, explanation.members)))


def count_progress(tell: Progress, text: str, begin: float, stop: float, usual: int) -> Callable[[int], None]:
    """Progress of a stage by what is done of it, where how much there is to do is known only roughly."""
    return lambda count: tell(text, begin + (stop - begin) * count / (count + usual))
