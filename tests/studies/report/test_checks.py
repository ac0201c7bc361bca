"""A check's verdict follows from its value and bounds, and what is written and shown are its numbers."""

import math

import pytest

from studies.report import checks
from studies.report.checks import Check, bound_above, bound_below


@pytest.mark.parametrize(
    ("check", "verdict"),
    [
        (Check("inside", 1.0, (0.5, 1.5)), "pass"),
        (Check("above", 1.6, (0.5, 1.5)), "fail"),
        (Check("control inside", 1.0, (0.5, 1.5), outside=True), "fail"),
        (Check("limit", 3, bound_above(3)), "pass"),
        (Check("count", 49, bound_below(50)), "fail"),
        (Check("other word", "biased", "consistent"), "fail"),
        (Check("control's word", "biased", "consistent", outside=True), "pass"),
        (Check("no bounds", 7.0), "note"),
        (Check("not known", math.nan, (0.0, 1.0)), "note"),
        (Check("not near", 1.4, checks.bound_near(1.0, 0.3)), "fail"),
    ],
)
def test_verdict(check, verdict):
    assert check.verdict == verdict
    assert checks.build_check_frame([check])["verdict"].tolist() == [verdict]
    assert checks.format_checks([check])["verdict"].tolist() == [verdict]


def test_extremes_leave_out_what_is_not_known():
    smallest, largest = checks.check_extremes("order", [1.1, math.nan, 0.9], (0.95, 1.2))
    assert (smallest.value, smallest.verdict) == (0.9, "fail")
    assert (largest.value, largest.verdict) == (1.1, "pass")
    assert [check.verdict for check in checks.check_extremes("order", [math.nan], (0, 1))] == ["note", "note"]
