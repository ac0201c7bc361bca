"""Tables for people have units and few digits; files have the numbers; a report has its files by their names."""

import io
import math

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from studies.report import checks, entry, panels
from studies.report.checks import Check, bound_above, bound_below
from studies.report.tables import Table

DATA = pd.DataFrame({"step_s": [0.5, 1.0], "error_G_xx_ppm": [1 / 3, np.nan], "inside": [True, False], "what": ["a|b", "[c]"]})


def test_a_report_is_written_and_shown_by_names(tmp_path):
    made = entry.Report(
        {"all": Table("All", DATA), "short": Table("Short", DATA, shown=["step_s"])},
        {"curve": panels.build_sheet(panels.make_curves([panels.Line([1, 2], [3, 4])]), size=(3, 2))},
        (Check("largest error", 0.5, (0.0, 1.0), "ppm", "It is small."),),
    )
    entry.write(made, "Study", tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"all.csv", "short.csv", "checks.csv", "curve.svg", "report.md"}
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "short.csv"), DATA, rtol=1e-5)
    found = pd.read_csv(tmp_path / "checks.csv").iloc[0]
    assert found[["check", "value", "lower", "upper", "verdict"]].tolist() == ["largest error", 0.5, 0.0, 1.0, "pass"]
    page = (tmp_path / "report.md").read_text()
    assert page.index("- It is small.") < page.index("| largest error | 0.5 | ppm | 0 to 1 | pass |") < page.index("## All")
    assert "## Short\n\n| step (s) |\n" in page
    assert "![curve](curve.svg)" in page
    out = io.StringIO()
    entry.show(made, Console(file=out, width=120))
    assert out.getvalue().index("Short") < out.getvalue().index("largest error")
    assert made.check("largest error").verdict == "pass"


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
