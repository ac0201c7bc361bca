"""The world of a case: its plan, its random streams, and the simulation of effects in its samples and references."""

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
    """Find an effect of the library, or a family outside of it, by its name."""
    return EFFECTS[name] if name in EFFECTS else FAMILIES[name]


def find_side(name: str) -> str:
    """Find the side of an effect: gyro, reference or time."""
    effect = find_effect(name)
    side = effect.side if isinstance(effect, Family) else ""
    return side or SIDES.get(effect.stage, "reference" if effect.on_references else "gyro")


@dataclass(frozen=True)
class World:
    """A plan with its random streams, in which effects are simulated."""

    entropy: int
    case: int
    attempt: int
    plan: Plan
    model: ResidualModel
    noises: dict[int, tuple[Array, Array]] = field(default_factory=dict)  # rates and references with noise alone, by draw

    @cached_property
    def around(self) -> Surroundings:
        """True motion and references that effects act on."""
        return build_surroundings(self.plan.plain, self.plan.motion)

    def rng(self, name: str) -> np.random.Generator:
        """Return the random generator of the case with this name."""
        return generator(self.entropy, self.case, f"withheld:{self.attempt}:{name}")

    def simulate(self, settings: Sequence[Setting], draw: int = 0) -> tuple[Array, Array]:
        """Simulate raw rates and reference attitudes with noise and effects; draw 0 is that of the recording."""
        if not settings and draw in self.noises:
            return self.noises[draw]
        active = [
            ActiveEffect(find_effect(setting.effect), setting, self.rng(f"effect:{draw}:{setting.label()}"))
            for setting in settings
        ]
        noise = self.rng(f"gyro:{draw}"), self.rng(f"reference:{draw}")
        simulated = simulate_readings(self.around, active, noise[0]), simulate_references(self.around, active, noise[1])
        if not settings:
            self.noises[draw] = simulated
        return simulated

    def record(self, settings: Sequence[Setting], draw: int = 0) -> Recording:
        """Simulate the recording that is diagnosed, draw 0, or further ones with other noise."""
        rates, quaternions = self.simulate(settings, draw)
        plain = self.plan.plain
        attitudes = replace(plain.attitudes, quaternions=quaternions)
        return replace(plain, gyro=replace(plain.gyro, rates=rates), attitudes=attitudes)

    def change(self, setting: Setting, draw: int = 0) -> Change:
        """Compute the change of rates and references by an effect under the same noise."""
        (raw, references), (plain_raw, plain_references) = self.simulate([setting], draw), self.simulate((), draw)
        return Change(raw - plain_raw, separation(plain_references, references))

    def noise(self, draw: int) -> Change:
        """Simulate the stated noise alone as a change of rates and references."""
        raw, references = self.simulate((), draw)
        return Change(raw - self.plan.plain.gyro.rates, separation(self.plan.motion.quaternions, references))

    def list_changes(self, setting: Setting) -> list[Change]:
        """List the changes by an effect in several draws of the noise; one draw if it is the same in all."""
        draws = 1 if find_effect(setting.effect).stage in FIXED else RANDOM_DRAWS
        return [self.change(setting, draw) for draw in range(draws)]

    def measure(self, changes: Sequence[Change]) -> tuple[float, float]:
        """Compute the signal-to-noise ratios in the attitude and in the samples of a change in some draws."""
        noises = [self.noise(draw) for draw in range(len(changes))] if len(changes) > 1 else []
        attitude = measure_attitude(list(map(self.model.respond, changes)), list(map(self.model.respond, noises)))
        levels = [self.model.measure_samples(change.raw, noise.raw) for change, noise in zip(changes, noises, strict=False)]
        return attitude, float(np.median(levels)) if levels else self.model.measure_samples(changes[0].raw, None)

    def respond(self, change: Change) -> Array:
        """Compute the whitened change (M,) of attitude and samples."""
        return np.concatenate([self.model.respond(change), self.model.roughen(change.raw).ravel()])
