"""Causes that the samples show: the symptoms, the effects that claim them, and what effects make of one another's symptoms.

Each symptom has one posterior over the effects that claim it and the alternatives (`diagnosis.posterior`).

The evidence of a symptom is a test with a p-value under M0, such as readings that lie on a lattice, which noise cannot do. It
says little of the attitude and the attitude little of it, so that the two are separate parts of one likelihood and need no
common search.
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

    symptom: Symptom  # what was seen
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


def weigh_symptom(symptom: Symptom, settings: DiagnosisSettings, claimed: bool = True) -> SymptomPosterior:
    """Compute the posterior of a symptom's explanations, see `diagnosis.posterior.compute_symptom_posterior`."""
    return compute_symptom_posterior(symptom.p_value, symptom.likeness, symptom.probability, settings, claimed)


def list_sample_causes(
    prepared: PreparedRecording, effects: Sequence[Effect], settings: DiagnosisSettings
) -> tuple[SampleCause, ...]:
    """The causes that the samples and the references' noise show by themselves, and the unlisted ones among them.

    The test of an effect's own, with its numbers, stands for the general symptom as well. Something else makes that symptom
    with the probability which the own test leaves. Symptoms that chance or a motion makes with more than half of the
    probability are left out.
    """
    symptoms, view = prepared.samples.symptoms, _build_prepared_view(prepared)
    if prepared.model.recording.gyro.arw_estimated:  # an import's estimate departs from itself by its error
        symptoms = tuple(one for one in symptoms if one.kind != "white_noise_level")
    own = [_convert_detection(one) for effect in effects for one in effect.detect(view) if one.p_value < settings.sample_event]
    own_test = {effect.name for effect in effects if effect.implements("detect")}
    causes = []
    for symptom in (*symptoms, *list_reference_symptoms(prepared)):
        claimants = _list_claimants(symptom.kind, effects)
        explained = [weigh_symptom(one.symptom, settings).listed for one in own if one.effect in claimants]
        weighed = replace(symptom, probability=symptom.probability * (1 - max(explained, default=0.0)))
        if _is_more_than_chance(weighed, settings):
            names = [name for name in claimants if name not in own_test]
            finding = _build_finding(prepared.samples.tests, symptom)
            causes.append(SampleCause(weighed, names[0] if names else None, finding, _list_rivals(names, symptom, effects)))
    return (*causes, *own)


def _list_claimants(kind: str, effects: Sequence[Effect]) -> list[str]:
    return [effect.name for effect in effects if effect.symptom == kind]


def _list_rivals(names: Sequence[str], symptom: Symptom, effects: Sequence[Effect]) -> tuple[tuple[str, float], ...]:
    """List alternatives to the first effect that claims a symptom, and their shares of the probability.

    They are effects that claim a rival of the symptom, and others that claim the same one: these have equal shares.
    """
    others = [(name, share) for kind, share in symptom.rivals for name in _list_claimants(kind, effects)]
    left = 1.0 - sum(share for _, share in others)
    return (*((name, left / len(names)) for name in names[1:]), *others)


def _is_more_than_chance(symptom: Symptom, settings: DiagnosisSettings) -> bool:
    """Tell whether an effect, listed or not, is likelier than chance and motion together."""
    posterior = weigh_symptom(symptom, settings)
    return posterior.listed + posterior.unlisted >= settings.unknown


def weigh_consequences(
    samples: Sequence[SampleCause], named: Sequence[tuple[Effect, str | None, float]], settings: DiagnosisSettings
) -> list[SampleCause]:
    """Weigh symptoms against what the effects that the attitude shows make in the samples.

    An effect that is at work makes its symptoms, too. One more effect beside it has the prior probability
    `DiagnosisSettings.another`. The effects are named with their axes and probabilities.
    """
    out = []
    for one in samples:
        axis, made = one.symptom.axis, 0.0
        if one.symptom.kind == "reference_noise_level":  # a random process of the references has noise at all frequencies
            wandering = [(its, p) for effect, its, p in named if effect.is_process and effect.on_references]
            made = max((p for its, p in wandering if axis in (None, its)), default=0.0)
        less = replace(one.symptom, probability=one.symptom.probability * (1 - made * (1 - settings.another)))
        if _is_more_than_chance(less, settings):
            out.append(replace(one, symptom=less))
    return out


def list_reference_symptoms(prepared: PreparedRecording) -> list[Symptom]:
    """The references' noise, where it is not white noise of the stated size."""
    noise = prepared.reference_noise
    if noise is None or not noise.departs or prepared.model.recording.attitudes.sigma_estimated:
        return []
    axis = None if noise.axis is None else AXES[noise.axis]
    place = 0 if noise.axis is None else noise.axis
    sigma = float(1 / np.sqrt(np.sum(1 / noise.sigma**2))) if noise.axis is None else float(noise.sigma[place])
    size = float(noise.factors[place])
    text = f"second differences of the references scatter {size:.3g} times as much as stated"
    return [Symptom("reference_noise_level", axis, size, "factor", sigma, {}, noise.p_value, text, likeness=noise.likeness)]


def _build_finding(all_tests: Sequence[SampleTest], symptom: Symptom) -> Finding:
    tests = [t for t in all_tests if t.symptom == symptom.kind and symptom.axis in (None, t.axis)]
    if symptom.text or not tests:
        signal = "attitude" if symptom.text and symptom.kind.startswith("reference") else "gyro stream"
        text = symptom.text or symptom.kind
        return Finding(signal, None, symptom.axis, None, symptom.kind, symptom.size, symptom.p_value, text)
    test = min(tests, key=lambda t: t.p_value)
    return Finding("gyro stream", None, symptom.axis, None, test.statistic, test.value, test.p_value, test.text)


def _build_prepared_view(prepared: PreparedRecording) -> SampleView:
    recording, report = prepared.model.recording, prepared.samples
    inside = np.zeros(recording.gyro.t_s.size, dtype=bool)
    slices = find_interval_slices(recording)
    for part in slices:
        inside[part] = True
    return SampleView(
        t_s=recording.gyro.t_s + 0.5 * recording.gyro.sample_s,
        sample_s=recording.gyro.sample_s,
        rates=recording.gyro.rates,
        sigma=report.noise,
        inside=inside,
        intervals=slices,
        motion=report.smooth,
    )


def _convert_detection(found: Detection) -> SampleCause:
    symptom = Symptom(
        found.effect, found.axis, found.size, found.unit, found.sigma, dict(found.parameters), found.p_value, found.text
    )
    finding = Finding("gyro stream", None, found.axis, None, found.effect, found.size, found.p_value, found.text)
    return SampleCause(symptom, found.effect, finding)
