"""The verdict follows from causes and probabilities."""

from dataclasses import replace

import pytest

from diagnosis.answer import Cause
from diagnosis.settings import DEFAULT
from diagnosis.verdict import decide_verdict

SURE = Cause("bias_drift", "x", 1.0, "deg/h per day", 0.1, {}, 0.95, ("bias_drift:x",), 0.95)
OPEN = replace(SURE, probability=0.6)


@pytest.mark.parametrize(
    ("present", "causes", "unlisted", "further", "verdict"),
    [
        (False, [], 0.0, {}, "none"),
        (False, [], 0.0, {"blind": True}, "not identifiable"),
        (True, [SURE], 0.1, {}, "named"),
        (True, [SURE, OPEN], 0.1, {}, "group"),
        (True, [SURE], 0.51, {}, "unknown"),
        (True, [], 0.1, {}, "unknown"),
        (True, [SURE], 0.99, {"beside_remainder": True}, "partial"),
        (True, [SURE], 0.1, {"blind": True}, "named"),
    ],
)
def test_the_verdict_of_causes_and_probabilities(present, causes, unlisted, further, verdict):
    assert decide_verdict(present, causes, unlisted, DEFAULT, **further) == verdict
