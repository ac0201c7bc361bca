"""From what the samples show to causes: a symptom is a cause if an effect claims it, and otherwise something unlisted.

The evidence of a symptom is a test with a p-value under M0, such as readings that lie on a lattice, which noise cannot do. It
says little of the attitude and the attitude little of it, so that the two are separate parts of one likelihood and need no
common search; a dead zone, which both see, is a candidate of the linear model instead (`diagnosis.model.dead_zone`), and so is
a line, which the attitude judges (`diagnosis.model.lines`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.answer import Cause, Finding
from diagnosis.detectors.reference_noise import ReferenceNoise
from diagnosis.detectors.report import SampleTest, Symptom
from diagnosis.inference.attribution import against
from diagnosis.model.prepare import Prepared
from diagnosis.settings import DiagnosisSettings
from simulator.effects.base import Detection, Effect, SampleView
from simulator.effects.recorded import interval_slices

AXES = "xyz"
SHARED = "noise_correlation"
OF_NOISE = ("white_noise_level", "readout_noise", "noise_colour", "slow_noise", "noise_constancy", "noise_pattern")
CHANCE = 1e3  # tests and looks that the p-value of one symptom is corrected for


@dataclass(frozen=True)
class SampleCause:
    """A symptom and the effect that claims it.

    Attributes
    ----------
    symptom : what was seen
    effect : its name, None if no effect that may be named claims the symptom
    imitated : whether it behaves so unlike that effect that something unlisted is named instead
    finding : for the list of where the recording departs
    rivals : effects that may be at work in its place, with their shares of the probability
    """

    symptom: Symptom
    effect: str | None
    finding: Finding
    rivals: tuple[tuple[str, float], ...] = ()
    imitated: bool = False

    @property
    def unlisted(self) -> bool:
        """Whether the answer has to be that something unlisted is at work."""
        return self.effect is None or self.imitated

    @property
    def share(self) -> float:
        """Of the probability, that it is the effect itself and none of the rivals."""
        return 1.0 - sum(share for _, share in self.rivals)

    def cause(self, settings: DiagnosisSettings) -> Cause:
        """As a cause of the answer."""
        assert self.effect is not None
        symptom = self.symptom
        names = (self.effect, *(name for name, _ in self.rivals))
        group = tuple(name if symptom.axis is None else f"{name}:{symptom.axis}" for name in names)
        probability = min(1.0 - imitated(symptom, settings), symptom.probability, 1.0 - min(symptom.p_value * CHANCE, 0.5))
        return Cause(
            self.effect, symptom.axis, symptom.size, symptom.unit, symptom.sigma, symptom.parameters,
            probability * self.share, group, probability,
        )  # fmt: skip


def imitated(symptom: Symptom, settings: DiagnosisSettings) -> float:
    """Probability that something unlisted imitates a symptom: its prior share, or more by how the symptom behaves.

    Most symptoms are asked for a single way in which an imitation might differ, or for none, so that nothing speaks for them.
    """
    odds = settings.imitation_in_samples / (1 - settings.imitation_in_samples) / min(against(symptom.likeness), 1.0)
    return odds / (1 + odds)


def sample_causes(prepared: Prepared, effects: Sequence[Effect], settings: DiagnosisSettings) -> tuple[SampleCause, ...]:
    """The causes that the samples and the references' noise show by themselves, and the unlisted ones among them."""
    symptoms = [*prepared.samples.symptoms, *reference_symptoms(prepared, settings)]
    return claimed(symptoms, prepared.samples.tests, effects, _view(prepared), settings)


def claimed(
    symptoms: Sequence[Symptom],
    tests: Sequence[SampleTest],
    effects: Sequence[Effect],
    view: SampleView,
    settings: DiagnosisSettings,
) -> tuple[SampleCause, ...]:
    """Symptoms with the effects that claim them, and what the effects' own tests find."""
    claims: dict[str | None, str] = {effect.symptom: effect.name for effect in effects if effect.symptom is not None}
    symptoms = symptoms if SHARED in claims else without_shaking(symptoms)
    detected = {
        effect: [one for one in effect.detect(view) if one.p_value < settings.sample_event]
        for effect in effects
        if effect.implements("detect")
    }
    # Where an effect's own test has found it, that says more than the general symptom which it makes as well.
    covered = {effect.symptom for effect, own in detected.items() if own}
    own_test = {effect.symptom for effect in detected}
    found = [
        SampleCause(
            one,
            None if one.kind in own_test else claims.get(one.kind),
            _finding(tests, one),
            _rivals(one, claims),
            imitated(one, settings) > settings.unknown,
        )
        for one in symptoms
        if one.kind not in covered
    ]
    return (*found, *(_detected(one) for own in detected.values() for one in own))


def without_shaking(symptoms: Sequence[Symptom]) -> list[Symptom]:
    """Symptoms without noise that gyros have in common, and what it does to the noise of each of them.

    A body that shakes faster than any reference sees turns all of its gyros. What they have in common is taken for that, and
    nothing is said of their noise, unless an effect on the list makes it.
    """
    shaken = {axis for one in symptoms if one.kind == SHARED for axis in str(one.parameters["gyros"])}
    return [
        one
        for one in symptoms
        if one.kind != SHARED and not (one.kind in OF_NOISE and shaken & (set(AXES) if one.axis is None else {one.axis}))
    ]


def _rivals(symptom: Symptom, claims: Mapping[str | None, str]) -> tuple[tuple[str, float], ...]:
    """The effects that the symptom's rivals are signs of."""
    return tuple((claims[kind], share) for kind, share in symptom.rivals if kind in claims)


def reference_symptoms(prepared: Prepared, settings: DiagnosisSettings) -> list[Symptom]:
    """The references' noise, where it is not white noise of the stated size."""
    if prepared.tracker_noise:
        return [one for name, noise in prepared.tracker_noise for one in _of_noise(noise, settings, name)]
    return [] if prepared.reference_noise is None else _of_noise(prepared.reference_noise, settings)


def _of_noise(noise: ReferenceNoise, settings: DiagnosisSettings, tracker: str | None = None) -> list[Symptom]:
    """The same of one test; the noise of one of several trackers has its name in the place of an axis."""
    found = []
    whose, them = ("the references'", "the references") if tracker is None else (f"{tracker}'s", tracker)
    if noise.correlation_p < settings.sample_event:
        text = f"{whose} noise about two axes correlates by {noise.correlation:.2f}"
        found.append(
            Symptom(
                "reference_noise_correlation", tracker, noise.correlation, "of the noise", 0.0, {}, noise.correlation_p, text
            )
        )
    if noise.constancy_p < settings.sample_event:
        text = f"{whose} noise has {noise.constancy:.2f} times the power of the rest in one part of the recording"
        found.append(
            Symptom("reference_noise_constancy", tracker, noise.constancy, "of its power", 0.0, {}, noise.constancy_p, text)
        )
    if noise.departs:
        axis = None if noise.axis is None else AXES[noise.axis]
        place = 0 if noise.axis is None else noise.axis
        sigma = float(1 / np.sqrt(np.sum(1 / noise.sigma**2))) if noise.axis is None else float(noise.sigma[place])
        size = float(noise.factors[place])
        text = f"second differences of {them} scatter {size:.3g} times as much as stated"
        kind = "reference_noise_level" if tracker is None else "tracker_noise_level"
        found.append(Symptom(kind, axis if tracker is None else tracker, size, "factor", sigma, {}, noise.p_value, text))
    return found


def _finding(all_tests: Sequence[SampleTest], symptom: Symptom) -> Finding:
    if symptom.text:
        signal = "attitude" if symptom.kind.startswith(("reference", "tracker")) else "gyro stream"
        return Finding(signal, None, symptom.axis, None, symptom.kind, symptom.size, symptom.p_value, symptom.text)
    tests = [t for t in all_tests if t.symptom == symptom.kind and symptom.axis in (None, t.axis)]
    if not tests:
        return Finding("gyro stream", None, symptom.axis, None, symptom.kind, symptom.size, symptom.p_value, symptom.kind)
    test = min(tests, key=lambda t: t.p_value)
    return Finding("gyro stream", None, symptom.axis, None, test.statistic, test.value, test.p_value, test.text)


def _view(prepared: Prepared) -> SampleView:
    recording, report = prepared.model.recording, prepared.samples
    inside = np.zeros(recording.gyro.t_s.size, dtype=bool)
    slices = interval_slices(recording)
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


def _detected(found: Detection) -> SampleCause:
    symptom = Symptom(
        found.effect, found.axis, found.size, found.unit, found.sigma, dict(found.parameters), found.p_value, found.text
    )
    finding = Finding("gyro stream", None, found.axis, None, found.effect, found.size, found.p_value, found.text)
    return SampleCause(symptom, found.effect, finding)
