"""A bias that wanders and returns: named, or in a group with the other wandering biases, from which it can hardly be told."""

import pytest

from diagnosis.diagnose import diagnose
from tests.diagnosis.recordings import recorded


@pytest.mark.parametrize(
    ("seed", "axis", "size", "time_constant_s"),
    [
        (50, "x", 0.2, 300),
        pytest.param(51, "y", 0.3, 600, marks=pytest.mark.long),
        pytest.param(53, "z", 0.3, 300, marks=pytest.mark.long),
    ],
)
def test_it_is_in_the_group_with_its_size(seed, axis, size, time_constant_s):
    answer = diagnose(recorded(seed, f"bias_markov:{axis}={size},time_constant_s={time_constant_s}"))
    assert answer.verdict in ("named", "group")
    (cause,) = answer.causes
    assert f"bias_markov:{axis}" in cause.group
    if cause.label == f"bias_markov:{axis}":
        assert abs(cause.size - size) < 3 * cause.sigma
