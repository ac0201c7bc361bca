"""Assemble the answer of a diagnosis from the results of its steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from diagnosis import notes, posterior
from diagnosis.answer import Amplitudes, Cause, Explanations, Finding
from diagnosis.arrays import AXES
from diagnosis.detail_tables import build_details
from diagnosis.detectors.sample_report import Line
from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.inference.levels import compute_levels
from diagnosis.model import localization
from diagnosis.model.calibration import calibrate_with_effects
from diagnosis.model.linear import Candidate
from diagnosis.model.misfit import list_findings
from diagnosis.model.prepare import PreparedRecording
from diagnosis.model.symptoms import SampleCause, weigh_consequences
from diagnosis.result import Details, Diagnosis
from diagnosis.settings import DiagnosisSettings
from diagnosis.verdict import decide_verdict
from gyrocal.arrays import Array
from gyrocal.calibration.plausible_ranges import estimate_plausible_ranges
from simulator.effects import ALL_EFFECTS

if TYPE_CHECKING:
    from diagnosis.explain import AttitudeInference


SHOWN_EXPLANATIONS = 12  # in the list of the likeliest ones
WORTH_SHOWING = 1e-4  # probability of an alternative

LEAST_POSITIVE = 1e-300
OFFSET = 0.1  # rad, prior sigma of a constant rotation of references that are mounted otherwise than stated


def build_diagnosis(
    prepared: PreparedRecording,
    samples: Sequence[SampleCause],
    explained: AttitudeInference,
    settings: DiagnosisSettings,
    runtime_s: float,
) -> Diagnosis:
    """Build the whole answer from a prepared recording, the causes in its samples and those in its attitude."""
    model = prepared.model
    gap = explained.p_value < settings.false_alarm_rate
    table = localization.compute_statistics(model)
    sigma = np.sqrt(np.diag(explained.covariance)[:12])
    inputs = AnswerInputs(
        recording=model.recording.title,
        where=_list_attitude_findings(explained, table, settings) if gap else (),
        p_values=collect_p_values(prepared, explained),
        G=model.G + explained.change[:9].reshape(3, 3),
        bias=model.bias + explained.change[9:],
        sigma_G=sigma[:9].reshape(3, 3),
        sigma_bias=sigma[9:],
        baseline_G=model.G,
        baseline_bias=model.bias,
        lines=list_line_findings(prepared.samples.lines),
        notes=(*notes.explain_fitting_residuals(prepared, samples, explained, gap), *prepared.notes),
        details=build_details(prepared, explained, table),
        amplitudes=compute_joint_amplitudes(explained.fitted, explained.covariance),
        sigma_nominal=_compute_nominal_sigma(prepared, explained),
        blind=_explain_blindness(prepared, settings),
        unobserved=prepared.unobserved,
    )
    return build_answer(inputs, samples, explained, settings, runtime_s)


def list_line_findings(lines: Sequence[Line]) -> tuple[Finding, ...]:
    """List the lines in the spectrum of the samples as findings, with frequency, axis and amplitude in deg/s."""
    return tuple(
        Finding("gyro stream", None, AXES[line.axis], None, "line", float(np.rad2deg(line.amplitude)), line.p_value, line.text)
        for line in lines
    )


def _explain_blindness(prepared: PreparedRecording, settings: DiagnosisSettings) -> str | None:
    model = prepared.model
    plausible = estimate_plausible_ranges(model.recording)
    sigma_G = prepared.sigma[:9].reshape(3, 3)
    return explain_blindness(model.degrees_of_freedom, model.G, sigma_G, model.recording.gyro.apriori_G, plausible.G, settings)


def explain_blindness(
    degrees_of_freedom: int, G: Array, sigma_G: Array, apriori_G: Array, plausible_G: float, settings: DiagnosisSettings
) -> str | None:
    """Explain why a recording without a visible misfit cannot show whether there is one; None if it can.

    The calibrated rotation of the axes is a misalignment that gyros of the grade have, or the sum of that and a rotation of the
    references. The priors of the three components are normal, that of the references with the sigma `OFFSET`.

    Parameters
    ----------
    degrees_of_freedom : observations less nuisance parameters
    G, sigma_G : (3, 3) as calibrated under M0, and standard errors
    apriori_G : (3, 3) what the gyro is known to be
    plausible_G : plausible range of an element of G, dimensionless
    settings : priors
    """
    if degrees_of_freedom <= 0:
        return "M0 has as many parameters as this recording has observations, so that no gap could be seen"
    U, _, V = np.linalg.svd(G @ np.linalg.inv(apriori_G))
    rotation = Rotation.from_matrix(U @ V if np.linalg.det(U @ V) > 0 else np.eye(3)).as_rotvec()
    gyro_sigma = float(np.sqrt(plausible_G**2 + np.sum(sigma_G**2) / 9))
    prior = settings.another * settings.unlisted_share
    joint_sigma = float(np.hypot(gyro_sigma, OFFSET))  # ratio of the densities of two normal variables of these sigmas
    log_odds = np.log(prior / (1 - prior)) + np.sum(
        0.5 * rotation**2 * (gyro_sigma**-2 - joint_sigma**-2) - np.log(joint_sigma / gyro_sigma)
    )
    if log_odds < np.log(settings.unknown / (1 - settings.unknown)):
        return None
    angle = float(np.linalg.norm(rotation))
    components_deg = ", ".join(f"{value:.3g}" for value in np.rad2deg(rotation))
    return (
        f"The calibration turns the gyro's axes by {np.rad2deg(angle):.3g} deg ({components_deg} deg about x, y, z), more than "
        "any plausible misalignment; a constant offset of the references does the same, and this recording cannot tell them "
        "apart"
    )


def _compute_nominal_sigma(prepared: PreparedRecording, explained: AttitudeInference) -> Array | None:
    """Compute the sigmas (12,) of G and b with the causes under the stated noise alone; None without a remainder."""
    if not (explained.unnamed and explained.fitted):
        return None
    return np.asarray(np.sqrt(np.diag(calibrate_with_effects(prepared.model, explained.fitted)[1])[:12]))


def _list_attitude_findings(
    explained: AttitudeInference, table: pd.DataFrame, settings: DiagnosisSettings
) -> tuple[Finding, ...]:
    """List the intervals, and statistics of all references, that depart from M0; the strongest first."""
    findings = [
        *localization.list_findings(table),
        *list_findings(explained.baseline_checks, settings.misfit_share * settings.false_alarm_rate),
    ]
    return tuple(sorted(findings, key=lambda finding: finding.p_value))


@dataclass(frozen=True)
class AnswerInputs:
    """Fields of an answer beside causes and probabilities, named as in `Diagnosis`; `where` is that of the linear model.

    `lines` are those in the samples, which are no misfit by themselves: the body may move so. `blind` says why the recording
    cannot show a misfit, if it cannot.
    """

    recording: str
    where: tuple[Finding, ...]
    p_values: dict[str, float]
    G: Array
    bias: Array
    sigma_G: Array
    sigma_bias: Array
    baseline_G: Array
    baseline_bias: Array
    lines: tuple[Finding, ...]
    notes: tuple[str, ...]
    details: Details
    amplitudes: Amplitudes = field(default_factory=Amplitudes)
    blind: str | None = None
    sigma_nominal: Array | None = None
    unobserved: tuple[str, ...] = ()


def build_answer(
    inputs: AnswerInputs,
    samples: Sequence[SampleCause],
    explained: AttitudeInference,
    settings: DiagnosisSettings,
    runtime_s: float,
) -> Diagnosis:
    """Build the answer from its fields and the causes of the samples and the attitude; decide the verdict."""
    attribution = explained.attribution
    gap = explained.p_value < settings.false_alarm_rate
    where = [*(sample.finding for sample in samples), *inputs.where, *inputs.lines]
    slots = () if attribution is None else attribution.slots
    named = [
        (ALL_EFFECTS[effect.effect], effect.axis, slot.probability)
        for slot, effect in zip(slots, explained.fitted, strict=False)
    ]
    samples = weigh_consequences(samples, named, settings)
    causes = _merge_causes(samples, explained, settings)
    unknown = 0.0 if attribution is None else attribution.unknown
    symptoms = [sample.summarise(settings) for sample in samples]
    unknown = 1 - (1 - unknown) * float(np.prod(posterior.compute_conditional_listed(symptoms)))
    attitude_explanations = (
        posterior.list_attitude_explanations(attribution)
        if gap
        else posterior.list_explanations_without_gap(explained.unseen, bool(samples), settings)
    )
    present = gap or bool(samples)
    is_partial = attribution is not None and attribution.verdict == "partial"
    verdict = decide_verdict(present, causes, unknown, settings, has_remainder=is_partial, blind=bool(inputs.blind))
    return Diagnosis(
        recording=inputs.recording,
        verdict=verdict,
        present=present,
        p_value=float(min([explained.p_value, *(sample.symptom.p_value for sample in samples)])),
        false_alarm_rate=settings.false_alarm_rate,
        where=tuple(where),
        causes=causes,
        alternatives=list_next_explanations(attribution),
        unknown_probability=float(unknown),
        closure=explained.closed,
        G=inputs.G,
        bias=inputs.bias,
        sigma_G=inputs.sigma_G,
        sigma_bias=inputs.sigma_bias,
        baseline_G=inputs.baseline_G,
        baseline_bias=inputs.baseline_bias,
        notes=(
            *filter(None, (inputs.blind,)),
            *notes.list_odd_symptoms(samples, settings),
            *notes.list_unit_mistakes(samples),
            *notes.list_likely_effects(explained, settings),
            *inputs.notes,
        ),
        runtime_s=runtime_s,
        details=inputs.details,
        p_values=inputs.p_values,
        posterior=posterior.combine_posteriors(symptoms, attitude_explanations),
        amplitudes=inputs.amplitudes,
        budget=explained.budget,
        remainder=explained.remainder,
        sigma_nominal=inputs.sigma_nominal,
        unobserved=inputs.unobserved,
    )


def compute_joint_amplitudes(fitted: Sequence[FittedEffect], covariance: Array) -> Amplitudes:
    """Compute the joint posterior of the amplitudes of all effects that have columns of their own.

    The joint covariance has nonlinear parameters and priors' scales fixed at their best; where the mixture over them is wider,
    its sigmas are used with the correlations of the joint one.

    Parameters
    ----------
    fitted : the effects that are named
    covariance : joint covariance of G, b and all amplitudes, see `diagnosis.model.calibration.calibrate_with_effects`
    """
    labels: list[str] = []
    values: list[float] = []
    sigmas: list[float] = []
    rows: list[int] = []
    start = 12
    for effect in fitted:
        count = effect.columns.shape[1]
        # The columns of a random process are draws of it, not its amplitudes.
        if ALL_EFFECTS[effect.effect].has_columns and not effect.process and effect.amplitudes.size == count:
            labels += [effect.label] * count
            values += effect.amplitudes.tolist()
            sigmas += effect.sigmas.tolist()
            rows += range(start, start + count)
        start += count
    joint = covariance[np.ix_(rows, rows)]
    wider = np.maximum(1.0, np.array(sigmas) / np.maximum(np.sqrt(np.diag(joint)), LEAST_POSITIVE))
    return Amplitudes(tuple(labels), np.array(values), joint * np.outer(wider, wider))


def _merge_causes(
    samples: Sequence[SampleCause], explained: AttitudeInference, settings: DiagnosisSettings
) -> tuple[Cause, ...]:
    """Merge the causes of the samples and of the attitude; a cause in both has the smaller sigma and both probabilities.

    A symptom of the samples is a finding and no cause where an unlisted effect is likelier to make it.
    """
    sample_causes = [sample.cause(settings) for sample in samples if sample.effect is not None]
    sample_causes = [cause for cause in sample_causes if cause.group_probability >= settings.unknown]
    attitude_causes = list_attitude_causes(explained.attribution, explained.fitted, explained.candidates)
    both = {cause.label: cause for cause in attitude_causes if cause.label in {sample.label for sample in sample_causes}}
    sample_causes = [_combine_cause(cause, both[cause.label]) if cause.label in both else cause for cause in sample_causes]
    others = [cause for cause in attitude_causes if cause.label not in both]
    # Beside a remainder, the causes that close most of the misfit come first.
    attitude_first = explained.attribution is not None and explained.attribution.verdict == "partial"
    return tuple([*others, *sample_causes] if attitude_first else [*sample_causes, *others])


def _combine_cause(first: Cause, second: Cause) -> Cause:
    """Combine the probabilities of one cause that two independent parts of the data show; the size is the more accurate one."""
    better = min(first, second, key=lambda cause: cause.sigma)
    p = posterior.combine_independent(first.probability, second.probability)
    group_p = posterior.combine_independent(first.group_probability, second.group_probability)
    return replace(better, probability=p, group_probability=group_p)


def list_attitude_causes(
    attribution: posterior.Attribution | None, fitted: Sequence[FittedEffect], candidates: tuple[Candidate, ...] = ()
) -> tuple[Cause, ...]:
    """List the causes that the data of a linear model show, with levels where its candidates are given."""
    if attribution is None:
        return ()
    levels = [compute_levels(slot.shares, candidates, ALL_EFFECTS) if candidates else None for slot in attribution.slots]
    return tuple(
        Cause(
            effect.effect, effect.axis, effect.size, effect.unit, effect.sigma, effect.parameters, slot.probability,
            tuple(label for label, _ in slot.group), slot.group_probability, level, slot.named,
        )
        for slot, effect, level in zip(attribution.slots, fitted, levels, strict=True)
    )  # fmt: skip


def collect_p_values(prepared: PreparedRecording, explained: AttitudeInference) -> dict[str, float]:
    """Collect the p-values of all tests: of the attitude, and of the samples by statistic and axis."""
    p_values = {"attitude": explained.p_value}
    for test in prepared.samples.tests:
        name = test.statistic if test.axis is None else f"{test.statistic}:{test.axis}"
        p_values[name] = float(test.p_value)
    if prepared.reference_noise is not None:
        p_values["reference_noise"] = float(prepared.reference_noise.p_value)
    p_values.update({f"misfit: {check.name}": check.p_value for check in explained.baseline_checks})
    return p_values


def list_next_explanations(attribution: posterior.Attribution | None) -> Explanations:
    """List the next best explanations with their probabilities."""
    if attribution is None:
        return ()
    best = tuple(slot.label for slot in attribution.slots)
    return tuple(
        (explanation.labels, explanation.probability)
        for explanation in attribution.ranked[:SHOWN_EXPLANATIONS]
        if explanation.labels and set(explanation.labels) != set(best) and explanation.probability > WORTH_SHOWING
    )
