"""The cases of the test world, each by its number: the plan, what is in it, and how strongly that shows.

The kinds come in blocks of twenty-five, shuffled, in which their shares are exact (`MIX`): recordings without effect, with one
listed effect, with two, with one outside the library, and *mixed* ones with one to four listed effects together with one
outside the library. Listed effects are whatever the registry holds; each draws axis, parameters and, if it does so, size
itself. All other sizes are set so that the evidence (`studies.validation.world.evidence`) is log-uniform.

An effect counts as outside the library only if more than three sigma of what it does remain when the listed effect that
explains most of it is fitted; steps are tried at several times, parameters as the effects themselves say.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np

from gyrocal.errors import InputError
from gyrocal.recording import Recording
from simulator.effects import EFFECTS, Setting
from simulator.effects.base import Array
from studies.validation.world.evidence import Evidence
from studies.validation.world.novelty import compute_novelty
from studies.validation.world.plans import draw_generic_plan
from studies.validation.world.size_search import search_settings
from studies.validation.world.world import Spec, World

Kind = Literal["none", "single", "pair", "unlisted", "mixed"]
KIND_ORDER: tuple[Kind, ...] = ("none", "single", "pair", "unlisted", "mixed")
MIX = (5, 8, 4, 4, 4)
MOST_LISTED = 4  # effects of the library in a mixed recording

MOST_PLAN_DRAWS = 60  # tried for a case
PAIRS = 5  # plans with a grade, tried for a case
DESCRIBED = 0.3  # norm of the error of a plan's own samples, up to which the baseline describes it
DETERMINED = 0.03  # sigma of an element of G, up to which a plan determines it
INDISTINGUISHABLE_COSINE = 0.8  # cosine of two responses above which a pair is one effect to any diagnosis
NOVEL = 3.0  # sigma that no listed effect explains


@dataclass(frozen=True)
class DrawnCase:
    """A case.

    Attributes
    ----------
    kind : what it is about
    world : its plan, and what effects do to it
    settings : its effects, one outside the library last
    snr : evidence of each effect
    separate_snr : of the two effects of a pair, with what the other explains taken out; else as snr
    novelty : norm of what no listed effect explains of one outside the library; NaN without one
    """

    kind: Kind
    world: World
    settings: tuple[Setting, ...]
    snr: tuple[float, ...]
    separate_snr: tuple[float, ...]
    novelty: float

    def recording(self) -> Recording:
        """Make the recording that a diagnosis sees."""
        return self.world.recording(self.settings)

    def truth(self) -> list[dict[str, Any]]:
        """List effects with axis, size, unit, parameters, evidence and whether they are listed, as JSON."""
        return [
            {
                "effect": one.effect,
                "axis": one.axis,
                "size": one.size,
                "unit": self.world.spec.effect(one.effect).unit,
                "parameters": dict(one.parameters),
                "snr": snr,
                "separate_snr": separate,
                "listed": one.effect in EFFECTS,
            }
            for one, snr, separate in zip(self.settings, self.snr, self.separate_snr, strict=True)
        ]


Found = tuple[Setting, float, Array]  # an effect, its evidence, and its response


def draw_case_kind(spec: Spec, case: int) -> Kind:
    """Draw the kind of a case."""
    block, place = divmod(case, sum(MIX))
    return KIND_ORDER[int(spec.rng(block, "kinds").permutation(np.repeat(np.arange(len(MIX)), MIX))[place])]


def draw_world(spec: Spec, case: int, plan: str | None = None) -> World:
    """Draw the plan of a case, of a given name or any: the first that the baseline describes and that determines G.

    A grade of the gyro may suit no draw of a plan. Another plan and grade then are drawn.

    Raises
    ------
    InputError
        None of many does.
    """
    lot = spec.rng(case, "plan")
    for _ in range(PAIRS):
        name, grade_name = plan or str(lot.choice(sorted(spec.source.plans))), str(lot.choice(sorted(spec.source.grades)))
        world = _draw_world(spec, case, name, grade_name)
        if world is not None:
            return world
    raise InputError(f"case {case}: no plan of {PAIRS} that the baseline describes and that determines G")


def _draw_world(spec: Spec, case: int, name: str, drawn_grade: str) -> World | None:
    """Draw a plan of one name and grade; None where no draw of it can be used."""
    kind = spec.source.plans[name]
    grade, grade_name = (kind.grade, name) if kind.grade else (spec.source.grades[drawn_grade], drawn_grade)
    draw_plan = kind.draw or partial(draw_generic_plan, kind=kind)
    for number in range(MOST_PLAN_DRAWS):
        try:
            made = draw_plan(spec.rng(case, f"plan:{number}"), grade=grade, title=f"{spec.name} {case}")
        except InputError:  # an interval without two references
            continue
        evidence = Evidence(made)
        if evidence.model_error < DESCRIBED and evidence.sigmas[:9].max() < DETERMINED:
            return World(spec, case, name, grade_name, made, evidence)
    return None


def draw_world_case(spec: Spec, case: int, kind: Kind | None = None, plan: str | None = None) -> DrawnCase:
    """Draw a case.

    Parameters
    ----------
    spec, case : what it depends on
    kind, plan : of the case and its plan, where they are not to be drawn

    Raises
    ------
    InputError
        No plan, or no effect for it, was found.
    """
    kind, world = kind or draw_case_kind(spec, case), draw_world(spec, case, plan)
    if kind == "none":
        return DrawnCase(kind, world, (), (), (), np.nan)
    if kind == "unlisted":
        found, novel = _draw_unlisted(world, [])
        return _build_drawn_case(kind, world, [found], novel)
    count = {"single": 1, "pair": 2}.get(kind) or int(world.rng("count").integers(1, MOST_LISTED, endpoint=True))
    listed = _draw_listed(world, count)
    if kind != "mixed":
        if len(listed) < count:
            raise InputError(f"case {case}: too few listed effects that can show in its plan")
        return _build_drawn_case(kind, world, listed, np.nan)
    if not listed:
        raise InputError(f"case {case}: no listed effect that can show in its plan")
    found, novel = _draw_unlisted(world, listed)
    return _build_drawn_case(kind, world, [*listed, found], novel)


def _build_drawn_case(kind: Kind, world: World, found: list[Found], novel: float) -> DrawnCase:
    snrs = tuple(snr for _, snr, _ in found)
    cosine = _compute_cosine(found[0][2], found[1][2]) if kind == "pair" else 0.0
    separate = tuple(float(snr * np.sqrt(1 - cosine**2)) for snr in snrs)
    return DrawnCase(kind, world, tuple(one for one, *_ in found), snrs, separate, novel)


def _draw_listed(world: World, count: int) -> list[Found]:
    """Draw so many listed effects, or fewer, whose responses differ."""
    found: list[Found] = []
    for name in sort_by_lot(world, [name for name, effect in EFFECTS.items() if effect.drawn]):
        kin = {EFFECTS[one.effect].kin for one, *_ in found} - {""}
        first = next(search_settings(world, EFFECTS[name]), None) if EFFECTS[name].kin not in kin else None
        if first is not None and _is_distinct(world, first[0], found):
            found.append((*first, world.evidence.combine_evidence(world.difference([first[0]]))))
        if len(found) == count:
            break
    return found


def _draw_unlisted(world: World, listed: list[Found]) -> tuple[Found, float]:
    """Draw an effect outside the library, with its novelty."""
    for one, snr in _place_families(world):
        novel = compute_novelty(world, one)
        if novel > NOVEL and _is_distinct(world, one, listed):
            return (one, snr, np.zeros(0)), novel
    raise InputError(f"case {world.case}: no effect outside the library that differs from the listed ones")


def _place_families(world: World) -> Iterator[tuple[Setting, float]]:
    families = world.spec.source.families
    for name in sort_by_lot(world, families):
        yield from search_settings(world, families[name])


def _is_distinct(world: World, one: Setting, others: list[Found]) -> bool:
    if not others:
        return True
    shown = world.evidence.combine_evidence(world.difference([one]))
    return all(abs(_compute_cosine(shown, other)) < INDISTINGUISHABLE_COSINE for *_, other in others)


def sort_by_lot(world: World, names: Iterable[str]) -> list[str]:
    """Sort names in an order drawn for the case; a further name changes nothing of that of the others."""
    return sorted(names, key=lambda name: float(world.rng(f"lot:{name}").random()))


def _compute_cosine(a: Array, b: Array) -> float:
    """Compute the cosine of two changes; zero where one is nothing."""
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b / size) if size > 0 else 0.0
