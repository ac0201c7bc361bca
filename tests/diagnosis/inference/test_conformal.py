"""Conformal sets of explanations, and their coverage."""

import pytest

from diagnosis.inference.conformal import build_conformal_set, compute_scores, name_of, score

POSTERIOR = [(["a"], 0.3), (["unknown"], 0.1), (["b", "a"], 0.6)]


def test_sets_grow_with_the_limit_on_how_much_less_likely_their_members_are():
    assert compute_scores(POSTERIOR) == {"a + b": 0.0, "a": pytest.approx(0.5), "unknown": pytest.approx(5 / 6)}
    assert score(POSTERIOR, ["a", "b"]) == 0.0
    assert score(POSTERIOR, ["c"]) == 1.0
    assert compute_scores([([], 1.0)]) == {"none": 0.0, "unknown": 1.0}
    assert name_of(["z", "a"]) == "a + z"
    assert build_conformal_set(POSTERIOR, 0.0) == ("a + b",)
    assert build_conformal_set(POSTERIOR, 0.7) == ("a + b", "a")
    assert build_conformal_set(POSTERIOR, 0.9) == ("a + b", "a", "unknown")
