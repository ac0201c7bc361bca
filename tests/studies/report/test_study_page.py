"""A study as a page, made of committed studies."""

import pytest

from studies.report import study_page
from studies.report.made import Made
from tests import ROOT
from tests.pages import checked

STUDIES = ROOT / "results" / "studies"
MADE = Made("1", "2026-01-01", "gyrocal study flight")


@pytest.mark.parametrize("name", ["flight", "timestep"])
def test_page_is_whole(name):
    page = checked(study_page.page(STUDIES / name, MADE))
    drawn = {f"{name}-{path.stem}" for path in (STUDIES / name).glob("*.svg")}
    assert drawn == set(page.figures)
    assert "SHA-256" in page.words


def test_checks_that_fail_are_named(tmp_path):
    assert study_page.verdict(tmp_path) == "This study has no checks."
    lines = ["check,verdict", "one,pass", "two,fail", "three,note"]
    (tmp_path / "checks.csv").write_text("\n".join(lines))
    assert study_page.verdict(tmp_path) == "1 of 2 checks pass. Not: two."
