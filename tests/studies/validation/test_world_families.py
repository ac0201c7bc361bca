import contextlib
from dataclasses import replace

import numpy as np
import pytest

from gyrocal.errors import InputError
from simulator.effects import REGISTRY, Registry, Setting
from simulator.effects.base import ON_REFERENCES, STAGE_NAMES
from studies.validation.world.evidence import Change
from studies.validation.world.families import FAMILIES as KNOWN
from studies.validation.world.families import FAMILY_MODULES, Family
from studies.validation.world.sources import find_source
from tests.studies.validation.world_plans import SMALL, small_world

DRAWS = 12
SOURCES = ("known", "fresh", "exam/001", "exam/002")
FAMILIES = {name: family for source in SOURCES for name, family in find_source(source).families.items()}


def source_of(family: Family) -> str:
    """The source that holds a family."""
    return next(name for name in SOURCES if family.name in find_source(name).families)


def settings(family: Family, name: str) -> list[Setting]:
    """Draws of a family on a small plan, at a size well inside its plausible range."""
    around, rng = small_world(name, source_of(family)).surroundings, np.random.default_rng(5)
    usual = {"share": 0.5, "s": 0.3, "ppm": 2e4, "deg/h": 50.0, "deg/s": 0.01, "deg": 0.05}[family.unit]
    return [Setting(family.name, *_drawn(family, rng, around, usual)) for _ in range(DRAWS)]


def _drawn(family, rng, around, size):
    axis, parameters = family.draw(rng, around)
    return axis, size, parameters


def changes(family: Family, name: str) -> list[Change]:
    """What draws of a family change; one with which it would do nothing is refused, as of any effect."""
    out = []
    for one in settings(family, name):
        with contextlib.suppress(InputError):
            out.append(small_world(name, source_of(family)).difference([one]))
    return out


def acts(family: Family) -> list[str]:
    return [name for name in SMALL if family.missing(small_world(name, source_of(family)).surroundings) is None]


def test_there_are_many_and_no_registry_holds_them():
    assert len(KNOWN) == sum(len(module.EFFECTS) for module in FAMILY_MODULES)
    assert len(FAMILIES) == sum(len(find_source(name).families) for name in SOURCES)
    assert not set(FAMILIES) & set(REGISTRY)
    assert {family.stage for family in FAMILIES.values()} <= set(STAGE_NAMES)


def test_a_registry_takes_every_file():
    registry = Registry()
    for module in FAMILY_MODULES:
        registry.register_all(module.EFFECTS)
    assert set(KNOWN) <= set(registry)


@pytest.mark.parametrize("family", FAMILIES.values(), ids=FAMILIES.keys())
def test_each_has_its_physics_and_source_in_words(family):
    assert "(" in family.meaning
    assert family.summary
    assert len(family.summary) < len(family.meaning)


@pytest.mark.parametrize("name", FAMILIES)
def test_each_acts_on_a_small_plan_and_changes_what_it_says(name):
    family = FAMILIES[name]
    places = acts(family)
    assert places, "no small plan has what it needs"
    for place in places:
        found = changes(family, place)
        on_references = family.stage in ON_REFERENCES
        for one in found:
            assert np.isfinite(one.raw).all()
            assert np.isfinite(one.reference).all()
            assert not (one.raw if on_references else one.reference).any()
        assert any((one.reference if on_references else one.raw).any() for one in found)


@pytest.mark.parametrize("name", FAMILIES)
def test_a_draw_is_the_same_again_and_no_size_is_no_change(name):
    family = FAMILIES[name]
    place = acts(family)[0]
    world = small_world(place, source_of(family))
    plain = world.simulate_observations([])
    for one in settings(family, place):
        try:
            first, second = world.simulate_observations([one]), world.simulate_observations([one])
        except InputError:
            continue
        assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))
        without = world.simulate_observations([replace(one, size=0.0)])
        assert all(np.array_equal(a, b) for a, b in zip(plain, without, strict=True))
        return
    raise AssertionError("no draw does anything")
