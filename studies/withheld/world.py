"""The world of a case: its plan, the random streams of its own, and what effects do to its samples and references."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from gyrocal.arrays import Array
from gyrocal.recording import Recording
from simulator.effects import EFFECTS, Effect, Setting, Surroundings
from simulator.effects.chain import ActiveEffect, simulate_readings, simulate_references
from simulator.simulate import build_surroundings
from simulator.streams import generator
from simulator.truth.rotation import separation
from studies.withheld.families import FAMILIES, Family
from studies.withheld.plans import Plan
from studies.withheld.snr import Change, ResidualModel, measure_attitude

RANDOM_DRAWS = 4  # of a random change
FIXED = ("rate", "reference", "filter", "clock", "threshold")  # stages whose errors are the same whatever the noise
SIDES = {"clock": "time", "filter": "time"}  # of the stages that act neither on the gyro's rates nor on the references


def find_effect(name: str) -> Effect:
    """An effect of the list, or a family outside of it."""
    return EFFECTS[name] if name in EFFECTS else FAMILIES[name]


def find_side(name: str) -> str:
    """Side that an effect is on: gyro, reference or time."""
    effect = find_effect(name)
    own = effect.side if isinstance(effect, Family) else ""
    return own or SIDES.get(effect.stage, "reference" if effect.on_references else "gyro")


@dataclass(frozen=True)
class World:
    """A plan, and what effects do to it; every random stream is the case's own."""

    entropy: int
    case: int
    attempt: int
    plan: Plan
    model: ResidualModel
    noises: dict[int, tuple[Array, Array]] = field(default_factory=dict)  # rates and references with noise alone, by draw

    @cached_property
    def around(self) -> Surroundings:
        """The truth as effects see it."""
        return build_surroundings(self.plan.plain, self.plan.motion)

    def rng(self, name: str) -> np.random.Generator:
        """A stream of the case."""
        return generator(self.entropy, self.case, f"withheld:{self.attempt}:{name}")

    def simulate(self, settings: Sequence[Setting], draw: int = 0) -> tuple[Array, Array]:
        """Raw rates and reference attitudes with noise and effects; draw 0 is that of the recording."""
        if not settings and draw in self.noises:
            return self.noises[draw]
        active = [ActiveEffect(find_effect(one.effect), one, self.rng(f"effect:{draw}:{one.label()}")) for one in settings]
        noise = self.rng(f"gyro:{draw}"), self.rng(f"reference:{draw}")
        made = simulate_readings(self.around, active, noise[0]), simulate_references(self.around, active, noise[1])
        if not settings:
            self.noises[draw] = made
        return made

    def record(self, settings: Sequence[Setting], draw: int = 0) -> Recording:
        """The recording that a diagnosis sees, and further ones with other noise."""
        rates, quaternions = self.simulate(settings, draw)
        plain = self.plan.plain
        attitudes = replace(plain.attitudes, quaternions=quaternions)
        return replace(plain, gyro=replace(plain.gyro, rates=rates), attitudes=attitudes)

    def change(self, one: Setting, draw: int = 0) -> Change:
        """What an effect changes under the same noise."""
        (raw, references), (plain_raw, plain_references) = self.simulate([one], draw), self.simulate((), draw)
        return Change(raw - plain_raw, separation(plain_references, references))

    def noise(self, draw: int) -> Change:
        """The noise as stated."""
        raw, references = self.simulate((), draw)
        return Change(raw - self.plan.plain.gyro.rates, separation(self.plan.motion.quaternions, references))

    def list_changes(self, one: Setting) -> list[Change]:
        """What an effect changes, in one draw if it is the same in all."""
        draws = 1 if find_effect(one.effect).stage in FIXED else RANDOM_DRAWS
        return [self.change(one, draw) for draw in range(draws)]

    def measure(self, changes: Sequence[Change]) -> tuple[float, float]:
        """Signal-to-noise ratios in the attitude and in the samples of a change in some draws."""
        noises = [self.noise(draw) for draw in range(len(changes))] if len(changes) > 1 else []
        attitude = measure_attitude([self.model.respond(one) for one in changes], [self.model.respond(one) for one in noises])
        levels = [self.model.measure_samples(one.raw, n.raw) for one, n in zip(changes, noises, strict=False)]
        return attitude, float(np.median(levels)) if levels else self.model.measure_samples(changes[0].raw, None)

    def respond(self, change: Change) -> Array:
        """(M,) whitened change of attitude and samples."""
        return np.concatenate([self.model.respond(change), self.model.roughen(change.raw).ravel()])
