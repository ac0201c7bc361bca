"""Draw a case: its kind, its plan, and its effects, each as strong as its drawn signal-to-noise ratio.

The kinds come in shuffled blocks with exact shares (`MIX`): no effect, one listed effect, two, one **withheld** (listed, but
excluded from the diagnosis), one that was never listed (**unlisted**), and **mixed** ones, one to three listed effects and an
unlisted one. Sizes are log-uniform in the signal-to-noise ratio (`studies.withheld.snr`), the root of the sum of the squares
of that in the attitude and that in the samples. A plan that does not determine G, or in which an effect cannot act, is drawn
again.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from gyrocal.errors import InputError
from simulator.effects import EFFECTS, Effect, Setting, Surroundings, setting
from simulator.effects.base import Value
from simulator.streams import generator
from studies.withheld.families import FAMILIES
from studies.withheld.listed import LISTED, SIZES, draw_phase
from studies.withheld.plans import draw_plan, log_uniform
from studies.withheld.snr import ResidualModel
from studies.withheld.world import World, find_effect

MIX = {"none": 3, "single": 5, "pair": 3, "withheld": 3, "unlisted": 3, "mixed": 3}  # cases in a block
SNR = (5.0, 60.0)  # range of the drawn signal-to-noise ratios
SNR_TOLERANCE = 0.3  # of the logarithm, by which a drawn size may miss its ratio
MOST_LISTED = 3  # listed effects of a mixed case
MOST_PLANS = 60  # tried for a case
DESCRIBED = 0.3  # norm of the error of a plan's own samples, up to which M0 describes it
DETERMINED = 0.03  # sigma of an element of G, up to which a plan determines it
ALIKE = 0.8  # cosine of two responses from which two effects of a case are one to any diagnosis
LINEAR = ("rate", "random_rate", "reference", "random_reference")  # stages whose errors are in proportion to the size


class Placed(NamedTuple):
    """An effect of a case with its signal-to-noise ratios in attitude and samples."""

    setting: Setting
    attitude: float
    samples: float

    @property
    def snr(self) -> float:
        """Signal-to-noise ratio in attitude and samples together."""
        return float(np.hypot(self.attitude, self.samples))


class DrawnCase(NamedTuple):
    """A case: its kind, its plan, and its effects, one outside the library last."""

    kind: str
    world: World
    effects: tuple[Placed, ...]

    @property
    def settings(self) -> list[Setting]:
        """Settings of the effects, without their ratios."""
        return [effect.setting for effect in self.effects]

    @property
    def allowed_names(self) -> list[str] | None:
        """Names that the diagnosis may use; None for all."""
        if self.kind != "withheld":
            return None
        withheld = list_effects_with_symptom_of(self.effects[0].setting.effect)
        return [name for name in EFFECTS if name not in withheld]


def list_effects_with_symptom_of(name: str) -> list[str]:
    """List the effects with the symptom of a given one, itself included; no recording distinguishes these."""
    symptom = EFFECTS[name].symptom
    return [candidate for candidate, effect in EFFECTS.items() if candidate == name or (symptom and effect.symptom == symptom)]


def draw_kind(entropy: int, case: int) -> str:
    """Draw the kind of a case."""
    block, place = divmod(case, sum(MIX.values()))
    return str(generator(entropy, block, "withheld:kinds").permutation(np.repeat(list(MIX), list(MIX.values())))[place])


def draw_case(entropy: int, case: int) -> DrawnCase:
    """Draw a case; raises an `InputError` if none of `MOST_PLANS` plans shows its effects."""
    kind = draw_kind(entropy, case)
    for attempt in range(MOST_PLANS):
        try:
            plan = draw_plan(generator(entropy, case, f"withheld:{attempt}:plan"), f"withheld {case}")
        except InputError:  # such as an interval with one reference
            continue
        world = World(entropy, case, attempt, plan, ResidualModel(plan))
        if world.model.model_error < DESCRIBED and world.model.parameter_basis[1][:9].max() < DETERMINED:
            effects = _place_effects(world, kind)
            if effects is not None:
                return DrawnCase(kind, world, tuple(effects))
    raise InputError(f"case {case}: no plan of {MOST_PLANS} in which its effects can show")


def _place_effects(world: World, kind: str) -> list[Placed] | None:
    """Draw the effects of a kind of case; None where too few can act."""
    mixed_count = int(world.rng("count").integers(1, MOST_LISTED, endpoint=True))
    listed = {"single": 1, "pair": 2, "withheld": 1, "mixed": mixed_count}.get(kind, 0)
    placed_effects: list[Placed] = []
    for names, wanted in ((list(LISTED), listed), (list(FAMILIES), listed + (kind in ("unlisted", "mixed")))):
        for name in sorted(names, key=lambda name: float(world.rng(f"lot:{name}").random())):
            if len(placed_effects) == wanted:
                break
            placed = place_effect(world, name)
            if placed is not None and _is_distinct(world, placed, placed_effects):
                placed_effects.append(placed)
        if len(placed_effects) < wanted:
            return None
    return placed_effects


def _is_distinct(world: World, placed: Placed, others: Iterable[Placed]) -> bool:
    """Check whether the response of an effect differs in shape from those of others."""
    a = world.respond(world.change(placed.setting))
    responses = [world.respond(world.change(other.setting)) for other in others]
    return all(abs(a @ b) < ALIKE * np.linalg.norm(a) * np.linalg.norm(b) for b in responses)


def place_effect(world: World, name: str) -> Placed | None:
    """Draw the numbers of an effect and solve for the size of a drawn signal-to-noise ratio; None where there is none."""
    effect, rng = find_effect(name), world.rng(f"draw:{name}")
    if effect.missing(world.around) is not None:
        return None
    target, axis = log_uniform(rng, *SNR), str(rng.choice(effect.axes)) if effect.axes else None
    axis = None if effect.axis_optional and rng.random() < 0.5 else axis
    parameters = draw_parameters(name, rng, world.around)
    sign = 1.0 if effect.sign == "positive" or effect.bounds[0] >= 0 or rng.random() < 0.5 else -1.0

    def build(log_size: float) -> Setting:
        return build_setting(name, axis, sign * float(np.exp(log_size)), parameters)

    try:
        log_size = solve_log_size(world, effect, build, target)
        if log_size is None:
            return None
        placed = Placed(build(log_size), *world.measure(world.list_changes(build(log_size))))
    except InputError:  # with these numbers it has no effect in this plan
        return None
    return placed if abs(np.log(placed.snr / target)) < SNR_TOLERANCE else None


def draw_parameters(name: str, rng: np.random.Generator, around: Surroundings) -> dict[str, Value]:
    """Draw the parameters of an effect of the list, or the three numbers of a law outside of it."""
    if name in LISTED:
        return {key: draw(rng, around) for key, draw in LISTED[name].items()}
    return {"phase_deg": draw_phase(rng, around), "share": float(rng.random()), "pace": float(rng.random())}


def build_setting(name: str, axis: str | None, size: float, parameters: dict[str, Value]) -> Setting:
    """Build the setting of an effect with size and phase in the form that its amplitudes have."""
    if name not in EFFECTS:
        return Setting(name, axis, size, parameters)
    effect = EFFECTS[name]
    drawn = effect.completed(setting(name, axis, size, parameters))
    if not effect.has_columns:
        return drawn
    size, fitted = effect.from_amplitudes(effect.amplitudes(drawn))  # a phase holds the sign
    return replace(drawn, size=size, parameters={**drawn.parameters, **fitted})


def solve_log_size(world: World, effect: Effect, build: Callable[[float], Setting], target: float) -> float | None:
    """Solve for the logarithm of the size at which an effect has the signal-to-noise ratio `target`; None if there is none."""
    low, high = SIZES.get(effect.name, (max(effect.prior[0], effect.bounds[0]), min(effect.prior[1], effect.bounds[1])))
    unit = world.list_changes(build(np.log(low))) if effect.stage in LINEAR else []

    def compare(log_size: float) -> float:
        changes = [change.scale(float(np.exp(log_size)) / low) for change in unit] or world.list_changes(build(log_size))
        return float(np.log(max(np.hypot(*world.measure(changes)), 1e-3) / target))

    ends = np.log(low), np.log(high)
    if compare(ends[0]) * compare(ends[1]) > 0:
        return None
    return float(brentq(compare, *ends, xtol=0.05, rtol=1e-3, maxiter=25, disp=False))
