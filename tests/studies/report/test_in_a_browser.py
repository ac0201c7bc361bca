"""Every kind of page in a browser: narrow and wide, light and dark, its values under the pointer, and a panel enlarged."""

import pytest

import simulator
from gyrocal import calibrate
from studies.report import calibration_page, diagnosis_page, study_page
from tests import ROOT
from tests.diagnosis_cases import CASES
from tests.pages import BROWSER, SPILT, browsed

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no browser is here")
LEAST = 4.5  # contrast of text, as WCAG 2 asks


@pytest.fixture(scope="module")
def pages():
    coarse = {"gyro.sample_s": 5.0, "reference.at": "series", "reference.every_s": 600.0}
    recording = simulator.simulate(simulator.override(simulator.load("trmm"), coarse), seed=3)
    return {
        "diagnosis": diagnosis_page.page(CASES["pair"]()),
        "calibration": calibration_page.page(calibrate(recording), recording),
        "study": study_page.page(ROOT / "results" / "studies" / "heads"),
    }


@pytest.fixture(scope="module", params=[False, True], ids=["light", "dark"])
def seen(request, pages, tmp_path_factory):
    found = browsed(pages, tmp_path_factory.mktemp("pages"), dark=request.param)
    assert {one["dark"] for one in found.values()} == {request.param}
    return found


def test_no_page_is_wider_than_its_window(seen):
    assert {key: one["spill"] for key, one in seen.items() if one["spill"] > SPILT} == {}


def test_text_stands_out_from_what_is_behind_it(seen):
    assert {key: one["faint"] for key, one in seen.items() if one["contrast"] < LEAST} == {}


def test_a_narrow_window_stacks_the_panels(seen):
    assert all(one["pieces"] > 0 for (_, width), one in seen.items() if width == 390)
    assert not any(one["pieces"] for (_, width), one in seen.items() if width == 1280)


def test_figures_tell_values_and_enlarge_a_panel(seen):
    wide = {name: one for (name, width), one in seen.items() if width == 1280}
    for name, one in wide.items():
        assert one["value"], name  # two numbers under the pointer
        assert one["enlarged"] > 1.5, name
        assert one["restored"], name


def test_the_page_shows_each_control_to_a_keyboard(seen):
    assert all(one["unreachable"] == [] for one in seen.values())
