"""The cases of the wide check, each by its number: the plan, what is in it, how strongly it shows.

The kinds come in blocks of twenty, shuffled, in which their shares are exact: five without effect, eight with one listed
effect, three with two, four with an unlisted one. Listed effects are whatever the registry holds; each draws axis, parameters
and, if it does so, size itself. All other sizes are set so that the evidence (`studies.validation.wide.evidence`) is
log-uniform.

An unlisted effect counts as such only if more than three sigma of what it does are left when the listed effect that explains
most of it is fitted; steps are tried at several times, parameters as the effects themselves say.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from gyrocal.errors import InputError
from gyrocal.recording import Recording
from simulator.effects import EFFECTS, Setting
from simulator.effects.base import Array
from studies.validation.wide.evidence import Evidence
from studies.validation.wide.families import FAMILIES
from studies.validation.wide.kinds import GRADES, KINDS
from studies.validation.wide.novelty import novelty
from studies.validation.wide.placing import placed
from studies.validation.wide.plans import drawn_plan
from studies.validation.wide.split import part
from studies.validation.wide.world import Spec, World, effect_of

Kind = Literal["none", "single", "pair", "unlisted"]
ORDER: tuple[Kind, ...] = ("none", "single", "pair", "unlisted")
MIX = (5, 8, 3, 4)

PLANS = 60  # tried for a case
DESCRIBED = 0.3  # norm of the error of a plan's own samples, up to which the baseline describes it
DETERMINED = 0.03  # sigma of an element of G, up to which a plan determines it
ALIKE = 0.8  # cosine of two responses above which a pair is one effect to any diagnosis
NOVEL = 3.0  # sigma that no listed effect explains


@dataclass(frozen=True)
class Drawn:
    """A case: its world, its effects with their evidence, and what of an unlisted one no listed effect explains (or NaN)."""

    kind: Kind
    world: World
    settings: tuple[Setting, ...]
    snr: tuple[float, ...]
    separate_snr: tuple[float, ...]
    novelty: float

    def recording(self) -> Recording:
        """What a diagnosis sees."""
        return self.world.recording(self.settings)

    def truth(self) -> list[dict[str, Any]]:
        """Effects with axis, size, unit, parameters and evidence, as JSON."""
        return [
            {
                "effect": one.effect,
                "axis": one.axis,
                "size": one.size,
                "unit": effect_of(one.effect).unit,
                "parameters": dict(one.parameters),
                "snr": snr,
                "separate_snr": separate,
            }
            for one, snr, separate in zip(self.settings, self.snr, self.separate_snr, strict=True)
        ]


def kind_of(spec: Spec, case: int) -> Kind:
    """Kind of a case."""
    block, place = divmod(case, sum(MIX))
    return ORDER[int(spec.rng(block, "kinds").permutation(np.repeat(np.arange(4), MIX))[place])]


def world_of(spec: Spec, case: int) -> World:
    """Plan of a case: the first drawn that the baseline describes and that determines G.

    Raises
    ------
    InputError
        None of many does.
    """
    chosen, lot = part(spec.part), spec.rng(case, "plan")
    kind, grade = str(lot.choice(chosen.plans)), str(lot.choice(chosen.grades))
    for number in range(PLANS):
        try:
            plan = drawn_plan(spec.rng(case, f"plan:{number}"), KINDS[kind], GRADES[grade], f"wide {spec.part} {case}")
        except InputError:  # an interval without two references
            continue
        evidence = Evidence(plan)
        if evidence.model_error < DESCRIBED and evidence.sigmas[:9].max() < DETERMINED:
            return World(spec, case, kind, grade, plan, evidence)
    raise InputError(f"case {case}: no plan '{kind}' of grade {grade} that the baseline describes and that determines G")


def draw(spec: Spec, case: int) -> Drawn:
    """Draw a case.

    Raises
    ------
    InputError
        No plan, or no effect for it, was found.
    """
    kind, world = kind_of(spec, case), world_of(spec, case)
    if kind == "none":
        return Drawn(kind, world, (), (), (), np.nan)
    if kind == "unlisted":
        for name in by_lot(world, part(spec.part).families):
            for one, snr in placed(world, FAMILIES[name]):
                novel = novelty(world, one)
                if novel > NOVEL:
                    return Drawn(kind, world, (one,), (snr,), (snr,), novel)
        raise InputError(f"case {case}: no unlisted effect that differs from the listed ones")
    found: list[tuple[Setting, float, Array]] = []
    for name in by_lot(world, EFFECTS):
        kin = {EFFECTS[one.effect].kin for one, *_ in found} - {""}
        first = next(placed(world, EFFECTS[name]), None) if EFFECTS[name].kin not in kin else None
        if first is None:
            continue
        shown = world.evidence.seen(world.difference([first[0]]))
        if all(abs(_cosine(shown, other)) < ALIKE for *_, other in found):
            found.append((*first, shown))
        if len(found) == (2 if kind == "pair" else 1):
            snrs = tuple(snr for _, snr, _ in found)
            cosine = _cosine(found[0][2], found[-1][2]) if len(found) == 2 else 0.0
            separate = tuple(float(snr * np.sqrt(1 - cosine**2)) for snr in snrs)
            return Drawn(kind, world, tuple(one for one, *_ in found), snrs, separate, np.nan)
    raise InputError(f"case {case}: too few listed effects that can show in its plan")


def by_lot(world: World, names: Iterable[str]) -> list[str]:
    """Names in an order drawn for the case; a further name changes nothing of that of the others."""
    return sorted(names, key=lambda name: float(world.rng(f"lot:{name}").random()))


def _cosine(a: Array, b: Array) -> float:
    """Of two changes, zero where one is nothing."""
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b / size) if size > 0 else 0.0
