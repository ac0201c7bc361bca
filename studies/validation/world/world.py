"""The world of a case: its plan, and what effects do to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gyrocal.recording import Recording
from simulator.effects import EFFECTS, Effect, Setting, Surroundings
from simulator.effects.base import Array
from simulator.effects.chain import ActiveEffect, simulate_readings, simulate_references
from simulator.simulate import build_surroundings
from simulator.streams import generator
from simulator.truth.rotation import separation
from studies.validation.world.evidence import Change, Evidence, compute_noise_evidence, compute_process_evidence
from studies.validation.world.plans import Plan
from studies.validation.world.sources import Source, find_source

WORLD_SNR = (5.0, 60.0)
RANDOM_CHANGE_DRAWS = 6  # of a random change


@dataclass(frozen=True)
class Spec:
    """What the drawing depends on: the name of a source, the root of all random streams, and the range of the evidence."""

    name: str
    entropy: int
    snr: tuple[float, float] = WORLD_SNR

    @property
    def source(self) -> Source:
        """Source of the cases."""
        return find_source(self.name)

    def rng(self, case: int, name: str) -> np.random.Generator:
        """A stream of a case, which is its source's own."""
        return generator(self.entropy, case, f"world:{self.name}:{name}")

    def effect(self, name: str) -> Effect:
        """An effect of the library, or a family outside of it."""
        return EFFECTS[name] if name in EFFECTS else self.source.families[name]


@dataclass(frozen=True)
class World:
    """A case's plan, and what effects do to it."""

    spec: Spec
    case: int
    kind: str
    grade: str
    plan: Plan
    evidence: Evidence

    @cached_property
    def surroundings(self) -> Surroundings:
        """The truth as effects see it."""
        return build_surroundings(self.plan.plain, self.plan.motion)

    def rng(self, name: str) -> np.random.Generator:
        """A stream of the case."""
        return self.spec.rng(self.case, name)

    def active(self, settings: Sequence[Setting], draw: int = 0) -> list[ActiveEffect]:
        """Effects with streams of their own; draw 0 is that of the recording."""
        return [ActiveEffect(self.spec.effect(one.effect), one, self.rng(f"effect:{draw}:{one.label()}")) for one in settings]

    def simulate_observations(self, settings: Sequence[Setting], draw: int = 0) -> tuple[Array, Array]:
        """Raw rates and reference attitudes with noise and effects."""
        noise = self.rng(f"gyro:{draw}"), self.rng(f"reference:{draw}")
        active = self.active(settings, draw)
        return simulate_readings(self.surroundings, active, noise[0]), simulate_references(self.surroundings, active, noise[1])

    def difference(self, settings: Sequence[Setting], draw: int = 0) -> Change:
        """Difference by effects under the same noise."""
        raw, references = self.simulate_observations(settings, draw)
        plain_raw, plain_references = self.simulate_observations((), draw)
        return Change(raw - plain_raw, separation(plain_references, references))

    def noise(self, draw: int = 0) -> Change:
        """The noise as stated."""
        raw, references = self.simulate_observations((), draw)
        return Change(raw - self.plan.plain.gyro.rates, separation(self.plan.motion.quaternions, references))

    def strength(self, one: Setting) -> float:
        """Evidence of an effect."""
        effect = self.spec.effect(one.effect)
        if _has_a_shape(effect):
            seen = self.evidence.attitude if one.effect in EFFECTS else self.evidence.combine_evidence
            return float(np.linalg.norm(seen(self.difference([one]))))
        evidence, draws, levels = self.evidence, [], []
        for draw in range(1, RANDOM_CHANGE_DRAWS + 1):
            change, noise = self.difference([one], draw), self.noise(draw)
            draws.append(evidence.combine_evidence(change))
            both = Change(change.raw + noise.raw, change.reference + noise.reference)
            levels.append(
                np.hypot(
                    compute_noise_evidence(evidence.attitude(noise), evidence.attitude(both)),
                    compute_noise_evidence(evidence.samples(noise), evidence.samples(both)) if change.raw.any() else 0.0,
                )
            )
        return max(compute_process_evidence(draws), float(np.median(levels)))

    def compute_attitude_evidence(self, one: Setting) -> float:
        """The same in the attitude alone, which is what reaches a calibration."""
        see = self.evidence.attitude
        if _has_a_shape(self.spec.effect(one.effect)):
            return float(np.linalg.norm(see(self.difference([one]))))
        return compute_process_evidence([see(self.difference([one], draw)) for draw in range(1, RANDOM_CHANGE_DRAWS + 1)])

    def recording(self, settings: Sequence[Setting], draw: int = 0) -> Recording:
        """Make the recording that a diagnosis sees; other draws have other noise."""
        plain = self.plan.plain
        rates, quaternions = self.simulate_observations(settings, draw)
        return replace(
            plain, gyro=replace(plain.gyro, rates=rates), attitudes=replace(plain.attitudes, quaternions=quaternions)
        )


def _has_a_shape(effect: Effect) -> bool:
    """Whether a change is of known shape: made of columns, of a change of the tags, or, as in a dead zone, of the motion."""
    made = ("columns", "reference_columns", "retimed")
    return effect.symptom == "dead_zone" or any(effect.implements(one) for one in made)
