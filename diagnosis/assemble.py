"""The answer of a diagnosis from what its steps have found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from diagnosis import notes, posterior
from diagnosis.answer import Amplitudes, Cause, Explanations, Finding, Verdict
from diagnosis.detail_tables import details
from diagnosis.identifiable import blind_spot
from diagnosis.inference.amplitudes import Fitted
from diagnosis.inference.attribution import REMAINDER, Attribution
from diagnosis.model import localization
from diagnosis.model.calibration import calibrated
from diagnosis.model.misfit import finding as misfit_finding
from diagnosis.model.prepare import Prepared
from diagnosis.model.symptoms import SampleCause
from diagnosis.result import Details, Diagnosis
from diagnosis.settings import DiagnosisSettings
from gyrocal.calibration.trackers import differences
from simulator.effects import ALL_EFFECTS

if TYPE_CHECKING:
    from diagnosis.explain import Explained

Array = NDArray[np.float64]

SHOWN_EXPLANATIONS = 12
WORTH_SHOWING = 1e-4  # probability of an alternative
TINY = 1e-300
JUMPS = ("outliers", "noise_constancy", "noise_pattern")  # symptoms that readings make which jump at an edge


def assembled(
    prepared: Prepared,
    samples: Sequence[SampleCause],
    explained: Explained,
    settings: DiagnosisSettings,
    runtime_s: float,
) -> Diagnosis:
    """The whole answer."""
    model = prepared.model
    gap = explained.p_value < settings.false_alarm_rate
    table = localization.statistics(model, model.y)
    sigma = np.sqrt(np.diag(explained.covariance)[:12])
    seen = Seen(
        recording=model.recording.title,
        where=_of_attitude(explained, table, settings) if gap else (),
        p_values=p_values(prepared, explained),
        G=model.G + explained.change[:9].reshape(3, 3),
        bias=model.bias + explained.change[9:],
        sigma_G=sigma[:9].reshape(3, 3),
        sigma_bias=sigma[9:],
        baseline_G=model.G,
        baseline_bias=model.bias,
        motions=(*notes.of_motions(prepared), *notes.of_shaking(samples, prepared)),
        notes=(*notes.though_it_fits(prepared, samples, explained, gap), *notes.of_rounding(explained), *prepared.notes),
        details=details(prepared, explained, table),
        amplitudes=amplitudes(explained.fitted, explained.covariance),
        sigma_nominal=_nominal_sigma(prepared, explained),
        blind=blind_spot(model.degrees_of_freedom, model.G, prepared.sigma[:9].reshape(3, 3), model.recording.gyro.apriori_G),
    )
    return answered(seen, samples, explained, settings, runtime_s)


def _nominal_sigma(prepared: Prepared, explained: Explained) -> Array | None:
    """Sigmas (12,) of G and b with the causes in the model under the stated noise alone, where a remainder is estimated."""
    if explained.beside is None or not explained.fitted:
        return None
    return np.asarray(np.sqrt(np.diag(calibrated(prepared.model, explained.fitted)[1])[:12]))


def _of_attitude(explained: Explained, table: pd.DataFrame, settings: DiagnosisSettings) -> tuple[Finding, ...]:
    """Parts of the recording, and statistics of all references, that depart; the strongest first."""
    found = [*localization.findings(table), *misfit_finding(explained.left, settings.misfit_share * settings.false_alarm_rate)]
    return tuple(sorted(found, key=lambda one: one.p_value))


@dataclass(frozen=True)
class Seen:
    """What an answer states beside causes and probabilities, named as in `Diagnosis`; `where` is that of the linear model.

    `blind` says why no gap could be seen, where that is so.
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
    motions: tuple[str, ...]
    notes: tuple[str, ...]
    details: Details
    amplitudes: Amplitudes = field(default_factory=Amplitudes)
    gyros: tuple[str, ...] = ("x", "y", "z")
    blind: str | None = None
    sigma_nominal: Array | None = None


def answered(
    seen: Seen, samples: Sequence[SampleCause], explained: Explained, settings: DiagnosisSettings, runtime_s: float
) -> Diagnosis:
    """The answer of what is seen and explained, whatever the linear model was built from."""
    attribution = explained.attribution
    gap = explained.p_value < settings.false_alarm_rate
    where = [*(one.finding for one in samples), *seen.where]
    samples = [
        one for one in samples if not (_is_of_a_process(one, explained.fitted) or _is_of_a_zone(one, explained, settings))
    ]
    unlisted = any(one.unlisted for one in samples)
    shown = [one.cause(settings) for one in samples if one.effect is not None]
    sure = all(cause.probability >= settings.named for cause in shown)
    verdict = _verdict(attribution, gap, bool(samples), unlisted, sure)
    unknown = 0.0 if attribution is None else attribution.unknown
    unknown = 1 - (1 - unknown) * float(np.prod(posterior.not_imitated(samples, settings)))
    if verdict == "none" and seen.blind:
        verdict = "not identifiable"
    return Diagnosis(
        recording=seen.recording,
        verdict=verdict,
        present=gap or bool(samples),
        p_value=float(min([explained.p_value, *(one.symptom.p_value for one in samples)])),
        false_alarm_rate=settings.false_alarm_rate,
        where=tuple(where),
        causes=_causes(samples, attribution, explained.fitted, settings),
        alternatives=alternatives(attribution),
        unknown_probability=float(unknown),
        closure=explained.closed,
        G=seen.G,
        bias=seen.bias,
        sigma_G=seen.sigma_G,
        sigma_bias=seen.sigma_bias,
        baseline_G=seen.baseline_G,
        baseline_bias=seen.baseline_bias,
        notes=(
            *filter(None, (seen.blind,)),
            *notes.of_checks(explained),
            *notes.imitations(samples, settings),
            *notes.of_units(samples),
            *seen.motions,
            *notes.likely(explained, settings),
            *seen.notes,
        ),
        runtime_s=runtime_s,
        details=seen.details,
        p_values=seen.p_values,
        posterior=posterior.of_all(samples, explained, gap, settings),
        amplitudes=seen.amplitudes,
        gyros=seen.gyros,
        budget=explained.budget,
        remainder=None if explained.beside is None else explained.beside.remainder,
        sigma_nominal=seen.sigma_nominal,
    )


def amplitudes(fitted: Sequence[Fitted], covariance: Array) -> Amplitudes:
    """Joint posterior of the effects that have columns of their own.

    The joint covariance holds nonlinear parameters and priors' scales at their best; where the mixture over them is wider, its
    sigmas are taken with the correlations of the joint one.

    Parameters
    ----------
    fitted : the effects that are named
    covariance : joint covariance of G, b and all amplitudes, see `diagnosis.model.calibration.calibrated`
    """
    labels: list[str] = []
    values: list[float] = []
    sigmas: list[float] = []
    places: list[int] = []
    start = 12
    for one in fitted:
        count = one.columns.shape[1]
        # The columns of a random process are draws of it, those of a dead zone are edges of it: neither are its amplitudes.
        if ALL_EFFECTS[one.effect].has_columns and not one.process and one.amplitudes.size == count:
            labels += [one.label] * count
            values += one.amplitudes.tolist()
            sigmas += one.sigmas.tolist()
            places += range(start, start + count)
        start += count
    joint = covariance[np.ix_(places, places)]
    wider = np.maximum(1.0, np.array(sigmas) / np.maximum(np.sqrt(np.diag(joint)), TINY))
    return Amplitudes(tuple(labels), np.array(values), joint * np.outer(wider, wider))


def _is_of_a_process(cause: SampleCause, fitted: Sequence[Fitted]) -> bool:
    """Whether noise that a test has seen is that of a random process which the attitude shows about the same axis.

    A process has noise at all frequencies: that of the rates shows in the samples as noise that is stronger at lower
    frequencies, that of the references in their second differences.
    """
    on_references = {"slow_noise": False, "reference_noise_level": True}.get(cause.symptom.kind)
    return on_references is not None and any(
        one.process and ALL_EFFECTS[one.effect].on_references == on_references and cause.symptom.axis in (None, one.axis)
        for one in fitted
    )


def _is_of_a_zone(cause: SampleCause, explained: Explained, settings: DiagnosisSettings) -> bool:
    """Whether what a test has seen of a gyro is what jumps at the edges of its dead zone leave, which the attitude shows."""
    if cause.symptom.kind not in JUMPS or explained.attribution is None:
        return False
    slots = zip(explained.attribution.slots, explained.fitted, strict=True)
    blind = {one.axis for slot, one in slots if slot.probability >= settings.named and _is_zone(one)}
    return cause.symptom.axis in blind


def _is_zone(one: Fitted) -> bool:
    return ALL_EFFECTS[one.effect].symptom == "dead_zone"


def _causes(
    samples: Sequence[SampleCause], attribution: Attribution | None, fitted: Sequence[Fitted], settings: DiagnosisSettings
) -> tuple[Cause, ...]:
    """The causes that the samples show, and those of the attitude; one that both show is as the samples show it."""
    shown = [one.cause(settings) for one in samples if not one.unlisted]
    labels = {cause.label for cause in shown}
    others = tuple(cause for cause in causes_of(attribution, fitted) if cause.label not in labels)
    # Beside a remainder, the causes that close most of the misfit come first.
    first = attribution is not None and attribution.verdict == "partial"
    return (*others, *shown) if first else (*shown, *others)


def causes_of(attribution: Attribution | None, fitted: Sequence[Fitted]) -> tuple[Cause, ...]:
    """The causes that the data of a linear model show."""
    if attribution is None:
        return ()
    return tuple(
        Cause(
            one.effect, one.axis, one.size, one.unit, one.sigma, one.parameters, slot.probability,
            tuple(label for label, _ in slot.group), sum(p for _, p in slot.group),
        )
        for slot, one in zip(attribution.slots, fitted, strict=True)
    )  # fmt: skip


def p_values(prepared: Prepared, explained: Explained) -> dict[str, float]:
    """P-values of all tests: of the attitude, of the samples by statistic and axis, of what a named explanation leaves."""
    out = {"attitude": explained.p_value}
    for test in prepared.samples.tests:
        name = test.statistic if test.axis is None else f"{test.statistic}:{test.axis}"
        out[name] = float(test.p_value)
    if prepared.reference_noise is not None:
        out["reference_noise"] = float(prepared.reference_noise.p_value)
    for name, noise in prepared.tracker_noise:
        out[f"tracker_noise:{name}"] = float(noise.p_value)
    for one in differences(prepared.model.recording):
        if one.dof > 0:
            out[f"trackers {one.first} and {one.second}"] = one.p_value
    out.update({f"misfit: {check.name}": check.p_value for check in explained.left})
    out.update({f"check: {check.name}": check.p_value for check in explained.checks})
    if explained.passed is not None:
        out["all checks, over the posterior"] = explained.passed
    return out


def _verdict(attribution: Attribution | None, gap: bool, shown: bool, unlisted: bool, sure: bool) -> Verdict:
    """The verdict; `sure` of what the samples show."""
    if not gap and not shown:
        return "none"
    if attribution is not None and attribution.verdict == "partial":
        return "partial"
    if unlisted:  # also beside a named cause, which it may have imitated
        return "unknown"
    verdict: Verdict = "named" if sure else "group"
    return verdict if attribution is None or attribution.verdict == "named" else attribution.verdict


def alternatives(attribution: Attribution | None) -> Explanations:
    """The next best explanations with their probabilities."""
    if attribution is None:
        return ()
    best = tuple(slot.group[0][0] for slot in attribution.slots)
    chosen = {best, (*best, REMAINDER)} if best else set()
    return tuple(
        (one.labels, one.probability)
        for one in attribution.ranked[:SHOWN_EXPLANATIONS]
        if one.labels and one.labels not in chosen and one.probability > WORTH_SHOWING
    )
