"""Side, axis and character of a place: sums of its posterior, and what every effect of the library is."""

import numpy as np
import pytest

from diagnosis.inference.conformal import build_conformal_set, compute_scores, name_of
from diagnosis.inference.levels import compute_levels
from simulator.effects import EFFECTS
from tests.diagnosis.linear_models import candidate

COLUMN = [np.ones((4, 1))]


def named(effect, axis=None, **changes):
    return candidate(0, COLUMN, 0, 0.0, effect=effect, axis=axis, **changes)


def test_levels_are_sums_over_all_that_share_a_side_an_axis_or_a_character():
    candidates = (
        named("bias_step", "x"), named("bias_drift", "x"), named("references step at a time", "x", listed=False),
        named("random bias, correlated in time", "y", listed=False, process=True),
    )  # fmt: skip
    found = compute_levels({0: 0.3, 1: 0.25, 2: 0.35, 3: 0.1}, candidates, EFFECTS)
    assert found.side == ("gyro", pytest.approx(0.65))
    assert found.axis == ("x", pytest.approx(0.9))
    assert found.character == ("step", pytest.approx(0.65))
    assert found.to_json()["side"] == {"name": "gyro", "probability": pytest.approx(0.65)}


POSTERIOR = [(["a"], 0.3), (["unknown"], 0.1), (["b", "a"], 0.6)]


def test_sets_grow_with_the_limit_on_how_much_less_likely_their_members_are():
    assert compute_scores(POSTERIOR) == {"a + b": 0.0, "a": pytest.approx(0.5), "unknown": pytest.approx(5 / 6)}
    assert compute_scores([([], 1.0)]) == {"none": 0.0, "unknown": 1.0}
    assert name_of(["z", "a"]) == "a + z"
    assert build_conformal_set(POSTERIOR, 0.0) == ("a + b",)
    assert build_conformal_set(POSTERIOR, 0.7) == ("a + b", "a")
    assert build_conformal_set(POSTERIOR, 0.9) == ("a + b", "a", "unknown")
