"""Small plans of the test world that its tests share."""

from dataclasses import replace
from functools import cache

import numpy as np

from studies.validation.world.evidence import Evidence
from studies.validation.world.plans import Plan, draw_generic_plan
from studies.validation.world.standard import GRADES, KINDS
from studies.validation.world.world import Spec, World

SMALL = {
    "free": (
        replace(KINDS["slews_and_rests"], intervals=(4, 5), length_s=(300, 600), hz=(2,), spacing_s=(5, 10)),
        "tuned_rotor",
    ),
    "earth": (replace(KINDS["earth_agile"], intervals=(4, 5), length_s=(600, 900), hz=(2,), spacing_s=(5, 10)), "fog_tactical"),
    "hand": (
        replace(KINDS["hand_motion"], intervals=(3, 4), length_s=(60, 90), hz=(50,), spacing_s=(0.5, 1)),
        "mems_tactical",
    ),
}


def small_plan(name: str, seed: int = 1, warm: float = 1.0) -> Plan:
    """A small plan of one of three kinds."""
    kind, grade = SMALL[name]
    return draw_generic_plan(np.random.default_rng(seed), kind, GRADES[grade], "small", warm)


@cache
def small_world(name: str, source: str = "known") -> World:
    """A case's world on a small plan, with the families of a source."""
    plan = small_plan(name)
    return World(Spec(source, 1), 0, name, SMALL[name][1], plan, Evidence(plan))
