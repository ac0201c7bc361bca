from dataclasses import replace

import pytest

from studies.validation.world.sources import find_source
from tests.studies.validation.world_plans import SMALL


@pytest.fixture
def small_plans_only(monkeypatch):
    """Every source has a small plan in place of its own, of which a draw takes a tenth of the time."""
    plans = {"small": SMALL["free"][0]}
    monkeypatch.setattr("studies.validation.world.world.find_source", lambda name: replace(find_source(name), plans=plans))
