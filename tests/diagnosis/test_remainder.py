"""Sides of a remainder."""

from types import SimpleNamespace

import pytest

from diagnosis.model.processes import BIAS_WANDERS, REFERENCES_WANDER, TAGS_WANDER
from diagnosis.remainder import find_remainder_side


@pytest.mark.parametrize(
    ("powers", "side"), [((8.0, 1.0, 1.0), "gyro"), ((1.0, 9.0, 0.0), "reference"), ((4.0, 5.0, 1.0), "undecided")]
)
def test_a_side_has_two_thirds_of_the_power_of_all_members(powers, side):
    members = [SimpleNamespace(effect=effect) for effect in (BIAS_WANDERS, REFERENCES_WANDER, TAGS_WANDER)]
    assert find_remainder_side(members, powers) == side
    assert find_remainder_side([SimpleNamespace(effect="rate_lag")], (1.0,)) == "time tags"
