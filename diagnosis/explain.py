"""What the attitude shows: a gap or none, and in one search the causes, their sizes and the remainder beside them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from diagnosis.answer import MOST, Closure, RemainderSummary, label_by_character
from diagnosis.budget import Step, is_surely_closing, measure_causes, summarise_closure
from diagnosis.inference.amplitudes import FittedEffect, estimate_amplitudes, refine_explanation
from diagnosis.inference.criticism import Check, combine_checks
from diagnosis.inference.joint_search import Inferred, infer_set
from diagnosis.inference.null import compute_null_p
from diagnosis.inference.search import Search
from diagnosis.model.calibration import calibrate_beside_remainder, calibrate_with_effects
from diagnosis.model.candidates import build_linear_model
from diagnosis.model.linear import Candidate, LinearModel
from diagnosis.model.misfit import check_baseline
from diagnosis.model.prepare import PreparedRecording, Progress, reclassify_without_effects, select_known_effects
from diagnosis.model.recording_model import RecordingModel
from diagnosis.posterior import Attribution, CredibleGroup, RankedExplanation, build_unknown_attribution, rank_weak_effects
from diagnosis.remainder import summarise_remainder
from diagnosis.settings import DiagnosisSettings
from diagnosis.verdict import attribute
from gyrocal.arrays import Array
from simulator.effects.base import Effect


@dataclass(frozen=True)
class AttitudeInference:
    """What the data of a linear model say.

    Attributes
    ----------
    candidates : what the linear model tried
    p_value : that M0 alone departs so far
    attribution : None without a gap
    fitted : amplitudes of the causes, in the order of the attribution's slots
    unnamed : amplitudes of the members of the model that are no stated cause
    closed : how far the gap closes on held-out data; None without a cause
    change, covariance : of the calibration with causes and remainder in the model, (12,), and of it and all amplitudes
    baseline_checks : checks of the innovations of all references under M0, before any averaging
    p_bounds : by the label of each member, the bound on the p-value of its evidence beside the others, all candidates counted
    unseen : without a gap, the probability of M0 and of what is too weak to be told
    budget : steps of the gap budget on held-out data; none without a gap
    remainder : what no cause explains; None where nothing is left
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
    """Explain what the attitude shows of a prepared recording, which may be judged anew; parameters as of `diagnose`.

    The references' noise was judged with all effects in the residuals, and is judged anew without those that are found.
    """
    explained = explain(prepared, effects, settings, seed, report)
    once_more = partial(_report_repetition, report)
    at_work = select_known_effects(explained.fitted, {effect.name: effect for effect in effects})
    again = reclassify_without_effects(prepared, at_work, settings)
    return (prepared, explained) if again is None else (again, explain(again, effects, settings, seed, once_more))


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
    # No name for it here: the columns of a long recording are hundreds of megabytes, which are let go before the end.
    of_all = combine_checks(baseline_checks) if baseline_checks else None
    explained, _ = infer_causes(
        build_linear_model(model, effects, settings, report_count=report_count), settings, seed, report, misfit_p=of_all
    )
    report("held-out data", 0.7)
    return replace(measure_explained(model, explained, settings), baseline_checks=baseline_checks)


def measure_explained(model: RecordingModel, explained: AttitudeInference, settings: DiagnosisSettings) -> AttitudeInference:
    """Measure on held-out data what the causes of a recording close, and the calibration with them in the model.

    A cause that closes less than nothing is not stated; what it describes is not explained. The same holds beside a remainder
    of more than half of the misfit, unless the 90 % interval of what the cause closes beside all others is above zero.
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
        held, budget = measure_causes(model, fitted, unnamed, [slot.group_probability for slot in slots])
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
        # A shape that is not stated would take the size of another of its kind, such as a slip's from a delay.
        unnamed += [dropped] if dropped.process else []
        attribution = replace(attribution, unknown=1.0)  # what it describes has no name
    sizes = [(float(step.size or 0.0), float(step.sigma or 0.0)) for step in budget[1:]]
    sized = tuple(replace(effect, size=size, sigma=sigma) for effect, (size, sigma) in zip(fitted, sizes, strict=False))
    change, covariance = calibrate_beside_remainder(model, fitted, unnamed)
    return replace(
        explained,
        attribution=attribute(attribution, tuple(slots), bool(unnamed) or len(slots) < len(explained.fitted), settings),
        fitted=sized,
        unnamed=tuple(unnamed),
        closed=summarise_closure(held) if fitted else None,
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
) -> tuple[AttitudeInference, Inferred | None]:
    """Infer causes from a linear model, whatever it was built from; nothing is measured on held-out data.

    Parameters
    ----------
    linear : the observations and their candidates
    settings, seed, report : as for `explain`
    shown : p-value of what shows a gap beside the candidates
    misfit_p : p-value of the checks of all references under M0: a gap without a word on its cause; None without checks

    Returns
    -------
    What the data say, and the set with its model, None without a gap
    """
    search = Search(linear, settings, count_progress(report, "explanations", 0.5, 0.7, 1000))
    report_null = partial(report, "null distribution")
    draws, scanned = settings.null_draws, settings.scanned_share
    # Without a degree of freedom the statistic is rounding.
    p = compute_null_p(search, seed, draws, scanned, lambda share: report_null(0.35 + 0.15 * share)) if linear.dof > 0 else 1.0
    share, of_all = (0.0, 1.0) if misfit_p is None else (settings.misfit_share, misfit_p)
    p, misfit_p = min(p / (1 - share), shown), 1.0 if misfit_p is None else misfit_p / share
    inference = AttitudeInference(linear.candidates, min(p, misfit_p, 1.0))
    if p >= settings.false_alarm_rate:
        if misfit_p < settings.false_alarm_rate:
            return replace(inference, attribution=build_unknown_attribution(misfit_p)), None
        return replace(inference, unseen=rank_weak_effects(linear, search.score_singles(), of_all, settings)), None
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
    attribution = attribute(attribution, attribution.slots, bool(unnamed), settings)
    # Of n averages of likelihood ratios, the largest reaches c with a probability of n/c at most.
    bounds = {
        linear.candidates[number].label: float(min(1.0, len(linear.candidates) * np.exp(-max(log, 0.0))))
        for number, log in inferred.log_evidence.items()
    }
    fitted_causes = tuple(effect for effect, _ in stated)
    return replace(inference, attribution=attribution, fitted=fitted_causes, unnamed=unnamed, p_bounds=bounds), inferred


def count_progress(report: Progress, text: str, begin: float, stop: float, usual: int) -> Callable[[int], None]:
    """Progress of a stage by what is done of it, where how much there is to do is known only roughly."""
    return lambda count: report(text, begin + (stop - begin) * count / (count + usual))
