"""Explain the attitude: test for a misfit, and infer in one search its causes, their sizes and the remainder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from diagnosis.answer import MOST, Closure, RemainderSummary, label_by_character
from diagnosis.budget import Step, is_surely_closing, measure_causes, summarise_closure
from diagnosis.inference.amplitudes import FittedEffect, estimate_amplitudes, refine_explanation
from diagnosis.inference.criticism import Check, combine_checks
from diagnosis.inference.joint_search import InferredSet, infer_set
from diagnosis.inference.null import compute_null_p
from diagnosis.inference.search import Search
from diagnosis.model.calibration import calibrate_with_effects, calibrate_with_remainder
from diagnosis.model.candidates import build_linear_model
from diagnosis.model.linear import Candidate, LinearModel
from diagnosis.model.misfit import check_baseline
from diagnosis.model.prepare import PreparedRecording, Progress, reclassify_without_effects, select_known_effects
from diagnosis.model.recording_model import RecordingModel
from diagnosis.posterior import Attribution, CredibleGroup, RankedExplanation, build_unknown_attribution, rank_weak_effects
from diagnosis.remainder import summarise_remainder
from diagnosis.settings import DiagnosisSettings
from diagnosis.verdict import decide_attitude_verdict
from gyrocal.arrays import Array
from simulator.effects.base import Effect


@dataclass(frozen=True)
class AttitudeInference:
    """Causes and remainder inferred from the data of a linear model.

    Attributes
    ----------
    candidates : those of the linear model
    p_value : under M0 alone
    attribution : None without a misfit
    fitted : amplitudes of the causes, in the order of the attribution's slots
    unnamed : amplitudes of the members of the model that are no stated cause
    closed : reduction of the misfit on held-out data; None without a cause
    change, covariance : of the calibration with causes and remainder in the model, (12,), and of it and all amplitudes
    baseline_checks : checks of the innovations of all references under M0, before any averaging
    p_bounds : by the label of each member, the bound on the p-value of its evidence beside the others, all candidates counted
    unseen : without a misfit, the probabilities of M0 and of effects too weak to identify
    budget : steps of the gap budget on held-out data; none without a misfit
    remainder : the part of the misfit that no cause explains; None without one
    """

    candidates: tuple[Candidate, ...]
    p_value: float
    attribution: Attribution | None = None
    fitted: tuple[FittedEffect, ...] = ()
    unnamed: tuple[FittedEffect, ...] = ()
    closed: Closure | None = None
    change: Array = field(default_factory=lambda: np.zeros(12))
    covariance: Array = field(default_factory=lambda: np.zeros((12, 12)))
    baseline_checks: tuple[Check, ...] = ()
    p_bounds: Mapping[str, float] = field(default_factory=dict)
    unseen: tuple[RankedExplanation, ...] = ()
    budget: tuple[Step, ...] = ()
    remainder: RemainderSummary | None = None


def explain_prepared(
    prepared: PreparedRecording, effects: Sequence[Effect], settings: DiagnosisSettings, seed: int, report: Progress
) -> tuple[PreparedRecording, AttitudeInference]:
    """Explain the attitude of a prepared recording, whose noise may be classified again; parameters as of `diagnose`.

    The references' noise was classified with all effects in the residuals, and is classified again without the fitted ones.
    """
    explained = explain(prepared, effects, settings, seed, report)
    known_effects = select_known_effects(explained.fitted, {effect.name: effect for effect in effects})
    reclassified = reclassify_without_effects(prepared, known_effects, settings)
    if reclassified is None:
        return prepared, explained
    return reclassified, explain(reclassified, effects, settings, seed, partial(_report_repetition, report))


def _report_repetition(report: Progress, text: str, share: float) -> None:
    """Report the progress of a repeated step, in the last 3 % of all."""
    report(f"once more: {text}", 0.97 + 0.03 * share)


def explain(
    prepared: PreparedRecording, effects: Sequence[Effect], settings: DiagnosisSettings, seed: int, report: Progress
) -> AttitudeInference:
    """Infer the causes of a recording's attitude misfit; parameters as of `diagnose`."""
    model = prepared.model
    report("candidates", 0.1)
    baseline_checks = check_baseline(model) if prepared.is_white else ()
    report_count = count_progress(report, "candidates", 0.1, 0.3, 100)
    # The linear model gets no name here: its columns, hundreds of megabytes for a long recording, are freed before the end.
    checks_p = combine_checks(baseline_checks) if baseline_checks else None
    explained, _ = infer_causes(
        build_linear_model(model, effects, settings, report_count=report_count), settings, seed, report, misfit_p=checks_p
    )
    report("held-out data", 0.7)
    return replace(measure_explained(model, explained, settings), baseline_checks=baseline_checks)


def measure_explained(model: RecordingModel, explained: AttitudeInference, settings: DiagnosisSettings) -> AttitudeInference:
    """Measure on held-out data how much of the misfit the causes close, and calibrate with them in the model.

    A cause that closes less than nothing is not stated, and its part of the misfit counts as unexplained. With a remainder of
    more than half of the misfit, a cause is also not stated unless the 90 % interval of what it closes is above zero.
    """
    attribution, fitted, unnamed = explained.attribution, list(explained.fitted), list(explained.unnamed)
    if attribution is None:
        change, covariance = calibrate_with_effects(model, ())
        return replace(explained, change=change, covariance=covariance)
    powers = [float(np.sum(model.project_out_nuisance(effect.contribution) ** 2)) for effect in fitted]
    slots = list(attribution.slots)
    order = sorted(range(len(fitted)), key=lambda k: (not slots[k].named, -powers[k]))
    fitted, slots = [fitted[k] for k in order], [slots[k] for k in order]
    while True:
        prediction, budget = measure_causes(model, fitted, unnamed, [slot.group_probability for slot in slots])
        unexplained = len(budget) > 1 and (budget[-2].closed or 0.0) > MOST
        doubtful = sorted(
            (step.closed, k)
            for k, step in enumerate(budget[1 : 1 + len(fitted)])
            if step.closed is not None and step.interval_90 is not None and min(step.closed, step.interval_90[0]) < 0
        )
        worst = next(
            (k for share, k in doubtful if share < 0 or (unexplained and not is_surely_closing(model, fitted, unnamed, k))),
            None,
        )
        if worst is None:
            break
        dropped = fitted.pop(worst)
        slots.pop(worst)
        # A shape that is not stated would absorb the size of a similar one, such as a slip that of a delay.
        unnamed += [dropped] if dropped.process else []
        attribution = replace(attribution, unknown=1.0)  # its part of the misfit has no cause then
    sizes = [(float(step.size or 0.0), float(step.sigma or 0.0)) for step in budget[1:]]
    sized = tuple(replace(effect, size=size, sigma=sigma) for effect, (size, sigma) in zip(fitted, sizes, strict=False))
    change, covariance = calibrate_with_remainder(model, fitted, unnamed)
    has_remainder = bool(unnamed) or len(slots) < len(explained.fitted)
    return replace(
        explained,
        attribution=decide_attitude_verdict(attribution, tuple(slots), has_remainder, settings),
        fitted=sized,
        unnamed=tuple(unnamed),
        closed=summarise_closure(prediction) if fitted else None,
        change=change,
        covariance=covariance,
        budget=budget,
        remainder=summarise_remainder(model, budget, fitted, unnamed, explained.p_bounds) if unnamed else None,
    )


def infer_causes(
    linear: LinearModel,
    settings: DiagnosisSettings,
    seed: int,
    report: Progress,
    shown: float = 1.0,
    misfit_p: float | None = None,
) -> tuple[AttitudeInference, InferredSet | None]:
    """Infer causes from any linear model, of an attitude or of sensor tables; no held-out data are used.

    Parameters
    ----------
    linear : the observations and their candidates
    settings, seed, report : as for `explain`
    shown : p-value of another test for a misfit that the candidates may explain
    misfit_p : p-value of the checks of all references under M0, which show a misfit but not its cause; None without checks

    Returns
    -------
    The inference, and the best set with its model, None without a misfit that a candidate explains
    """
    search = Search(linear, settings, count_progress(report, "explanations", 0.5, 0.7, 1000))
    report_null = partial(report, "null distribution")
    draws, scanned = settings.null_draws, settings.scanned_share
    # Without a degree of freedom the statistic is rounding.
    p = compute_null_p(search, seed, draws, scanned, lambda share: report_null(0.35 + 0.15 * share)) if linear.dof > 0 else 1.0
    share, checks_p = (0.0, 1.0) if misfit_p is None else (settings.misfit_share, misfit_p)
    p, misfit_p = min(p / (1 - share), shown), 1.0 if misfit_p is None else misfit_p / share
    inference = AttitudeInference(linear.candidates, min(p, misfit_p, 1.0))
    if p >= settings.false_alarm_rate:
        if misfit_p < settings.false_alarm_rate:
            return replace(inference, attribution=build_unknown_attribution(misfit_p)), None
        return replace(inference, unseen=rank_weak_effects(linear, search.score_singles(), checks_p, settings)), None
    report("explanations", 0.5)
    inferred = infer_set(search, settings)
    report("amplitudes", 0.7)
    named = {slot.member.candidate: slot for slot in inferred.slots}
    fitted: list[tuple[FittedEffect, CredibleGroup | None]] = []
    if inferred.best.members:
        fine, members = refine_explanation(inferred.linear, inferred.best.members)
        parts = estimate_amplitudes(fine, members)
        slots = [named.get(member.candidate) for member in members]
        fitted = [
            (effect if slot is None or slot.named else replace(effect, label=label_by_character(effect.label)), slot)
            for effect, slot in zip(parts, slots, strict=True)
        ]
    stated = [(effect, slot) for effect, slot in fitted if slot is not None]
    attribution = Attribution("unknown", inferred.best, tuple(slot for _, slot in stated), inferred.unknown, inferred.ranked)
    unnamed = tuple(effect for effect, slot in fitted if slot is None)
    attribution = decide_attitude_verdict(attribution, attribution.slots, bool(unnamed), settings)
    # Of n averages of likelihood ratios, the largest reaches c with a probability of n/c at most.
    bounds = {
        linear.candidates[number].label: float(min(1.0, len(linear.candidates) * np.exp(-max(log, 0.0))))
        for number, log in inferred.log_evidence.items()
    }
    fitted_causes = tuple(effect for effect, _ in stated)
    return replace(inference, attribution=attribution, fitted=fitted_causes, unnamed=unnamed, p_bounds=bounds), inferred


def count_progress(report: Progress, text: str, begin: float, stop: float, expected_count: int) -> Callable[[int], None]:
    """Build a function that reports a stage's progress by a count whose final value is known only roughly."""
    return lambda count: report(text, begin + (stop - begin) * count / (count + expected_count))
