"""Causes that the samples show: the symptoms, the effects that claim them, and symptoms that effects of the attitude explain.

Each symptom has one posterior over the effects that claim it and the alternatives (`diagnosis.posterior`).

The evidence of a symptom is a test with a p-value under M0, such as readings on a lattice, which noise cannot produce. It
hardly depends on the attitude errors nor they on it, so that the two are separate factors of one likelihood and need no common
search.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.answer import Cause, Finding
from diagnosis.arrays import AXES
from diagnosis.detectors.sample_report import SampleTest, Symptom
from diagnosis.model.prepare import PreparedRecording
from diagnosis.posterior import SymptomPosterior, SymptomSummary, compute_symptom_posterior
from diagnosis.settings import DiagnosisSettings
from simulator.effects.base import Detection, Effect, SampleView
from simulator.effects.recording_view import find_interval_slices

OF_NOISE = ("white_noise_level", "readout_noise")


@dataclass(frozen=True)
class SampleCause:
    """A symptom and the effect that claims it."""

    symptom: Symptom
    effect: str | None  # its name, None if no effect that may be named claims the symptom
    finding: Finding  # for the list of where the recording departs
    rivals: tuple[tuple[str, float], ...] = ()  # effects that may be at work in its place, with their shares of the probability

    def compute_listed(self, settings: DiagnosisSettings) -> float:
        """Compute the probability that listed effects make the symptom; where none claims it, that nothing unlisted does."""
        posterior = weigh_symptom(self.symptom, settings, self.effect is not None)
        return posterior.listed if self.effect is not None else 1 - posterior.unlisted

    def summarise(self, settings: DiagnosisSettings) -> SymptomSummary:
        """Summarise the probabilities of the symptom for those of explanations."""
        kind = "noise" if self.symptom.kind in OF_NOISE else self.symptom.kind
        shares = (self.share, *(share for _, share in self.rivals))
        labels = self.cause(settings).group if self.effect is not None else ()
        return SymptomSummary(kind, self.compute_listed(settings), tuple(zip(labels, shares, strict=False)))

    @property
    def share(self) -> float:
        """Share of the probability that is the effect's own and not its alternatives'."""
        return 1.0 - sum(share for _, share in self.rivals)

    def cause(self, settings: DiagnosisSettings) -> Cause:
        """Return the symptom as a cause of the answer."""
        assert self.effect is not None
        symptom = self.symptom
        names = (self.effect, *(name for name, _ in self.rivals))
        group = tuple(name if symptom.axis is None else f"{name}:{symptom.axis}" for name in names)
        probability = weigh_symptom(symptom, settings).listed
        return Cause(
            self.effect, symptom.axis, symptom.size, symptom.unit, symptom.sigma, symptom.parameters,
            probability * self.share, group, probability,
        )  # fmt: skip


def weigh_symptom(symptom: Symptom, settings: DiagnosisSettings, is_claimed: bool = True) -> SymptomPosterior:
    """Compute the posterior of a symptom's explanations, see `diagnosis.posterior.compute_symptom_posterior`."""
    return compute_symptom_posterior(symptom.p_value, symptom.likeness, symptom.probability, settings, is_claimed)


def list_sample_causes(
    prepared: PreparedRecording, effects: Sequence[Effect], settings: DiagnosisSettings
) -> tuple[SampleCause, ...]:
    """List the causes that the samples and the references' noise show by themselves, also those that no effect claims.

    An effect may detect itself, with its own test and numbers, and then explains the general symptom as well: the probability
    of that symptom is multiplied by the probability that the detection is wrong. Symptoms that chance or a motion explains
    with more than half of the probability are left out.
    """
    symptoms, view = prepared.samples.symptoms, _build_prepared_view(prepared)
    if prepared.model.recording.gyro.arw_estimated:  # an import's estimate departs from itself by its error
        symptoms = tuple(symptom for symptom in symptoms if symptom.kind != "white_noise_level")
    results = [result for effect in effects for result in effect.detect(view)]
    detections = [_convert_detection(result) for result in results if result.p_value < settings.sample_event]
    with_own_test = {effect.name for effect in effects if effect.implements("detect")}
    causes = []
    for symptom in (*symptoms, *list_reference_symptoms(prepared)):
        claimants = _list_claimants(symptom.kind, effects)
        detected = [weigh_symptom(cause.symptom, settings).listed for cause in detections if cause.effect in claimants]
        weighed = replace(symptom, probability=symptom.probability * (1 - max(detected, default=0.0)))
        if _is_more_than_chance(weighed, settings):
            names = [name for name in claimants if name not in with_own_test]
            finding = _build_finding(prepared.samples.tests, symptom)
            causes.append(SampleCause(weighed, names[0] if names else None, finding, _list_rivals(names, symptom, effects)))
    return (*causes, *detections)


def _list_claimants(kind: str, effects: Sequence[Effect]) -> list[str]:
    return [effect.name for effect in effects if effect.symptom == kind]


def _list_rivals(names: Sequence[str], symptom: Symptom, effects: Sequence[Effect]) -> tuple[tuple[str, float], ...]:
    """List alternatives to the first effect that claims a symptom, and their shares of the probability.

    They are effects that claim a rival of the symptom, and others that claim the same one: these have equal shares.
    """
    others = [(name, share) for kind, share in symptom.rivals for name in _list_claimants(kind, effects)]
    remaining = 1.0 - sum(share for _, share in others)
    return (*((name, remaining / len(names)) for name in names[1:]), *others)


def _is_more_than_chance(symptom: Symptom, settings: DiagnosisSettings) -> bool:
    """Check whether an effect, listed or not, is likelier than chance and motion together."""
    posterior = weigh_symptom(symptom, settings)
    return posterior.listed + posterior.unlisted >= settings.unknown


def weigh_consequences(
    samples: Sequence[SampleCause], named: Sequence[tuple[Effect, str | None, float]], settings: DiagnosisSettings
) -> list[SampleCause]:
    """Reduce the probability of symptoms that effects identified in the attitude explain; drop those that chance explains then.

    An effect causes its symptoms, too; one more effect that causes the same symptom has the prior probability
    `DiagnosisSettings.another`. `named` holds the identified effects with their axes and probabilities.
    """
    weighed_causes = []
    for sample in samples:
        axis, explained = sample.symptom.axis, 0.0
        if sample.symptom.kind == "reference_noise_level":  # a random process of the references has noise at all frequencies
            wandering = [(effect_axis, p) for effect, effect_axis, p in named if effect.is_process and effect.on_references]
            explained = max((p for effect_axis, p in wandering if axis in (None, effect_axis)), default=0.0)
        weighed = replace(sample.symptom, probability=sample.symptom.probability * (1 - explained * (1 - settings.another)))
        if _is_more_than_chance(weighed, settings):
            weighed_causes.append(replace(sample, symptom=weighed))
    return weighed_causes


def list_reference_symptoms(prepared: PreparedRecording) -> list[Symptom]:
    """Return the symptom of references whose noise is not white noise of the stated size; empty if it is."""
    noise = prepared.reference_noise
    if noise is None or not noise.departs or prepared.model.recording.attitudes.sigma_estimated:
        return []
    axis = None if noise.axis is None else AXES[noise.axis]
    k = 0 if noise.axis is None else noise.axis  # without one axis all factors are equal
    sigma = float(1 / np.sqrt(np.sum(1 / noise.sigma**2))) if noise.axis is None else float(noise.sigma[k])
    size = float(noise.factors[k])
    text = f"second differences of the references scatter {size:.3g} times as much as stated"
    return [Symptom("reference_noise_level", axis, size, "factor", sigma, {}, noise.p_value, text, likeness=noise.likeness)]


def _build_finding(sample_tests: Sequence[SampleTest], symptom: Symptom) -> Finding:
    tests = [test for test in sample_tests if test.symptom == symptom.kind and symptom.axis in (None, test.axis)]
    if symptom.text or not tests:
        signal = "attitude" if symptom.text and symptom.kind.startswith("reference") else "gyro stream"
        text = symptom.text or symptom.kind
        return Finding(signal, None, symptom.axis, None, symptom.kind, symptom.size, symptom.p_value, text)
    test = min(tests, key=lambda test: test.p_value)
    return Finding("gyro stream", None, symptom.axis, None, test.statistic, test.value, test.p_value, test.text)


def _build_prepared_view(prepared: PreparedRecording) -> SampleView:
    recording, report = prepared.model.recording, prepared.samples
    inside = np.zeros(recording.gyro.t_s.size, dtype=bool)
    slices = find_interval_slices(recording)
    for interval in slices:
        inside[interval] = True
    return SampleView(
        t_s=recording.gyro.t_s + 0.5 * recording.gyro.sample_s,
        sample_s=recording.gyro.sample_s,
        rates=recording.gyro.rates,
        sigma=report.noise,
        inside=inside,
        intervals=slices,
        motion=report.smooth,
    )


def _convert_detection(detection: Detection) -> SampleCause:
    symptom = Symptom(
        detection.effect, detection.axis, detection.size, detection.unit, detection.sigma, dict(detection.parameters),
        detection.p_value, detection.text,
    )  # fmt: skip
    where = ("gyro stream", None, detection.axis, None)
    finding = Finding(*where, detection.effect, detection.size, detection.p_value, detection.text)
    return SampleCause(symptom, detection.effect, finding)
