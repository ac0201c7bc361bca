"""Every kind of page in a browser: narrow and wide, light and dark."""

import pytest

import simulator
from gyrocal import calibrate
from studies.index_page import build_index_page
from studies.report.calibration import build_calibration_page
from studies.report.diagnosis import build_diagnosis_page
from tests import ROOT
from tests.diagnosis_cases import CASES
from tests.pages import BROWSER, SPILT, browsed

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no browser is here")
LEAST = 4.5  # contrast of text, as WCAG 2 asks
RESULTS = ROOT / "results"


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    coarse = {"gyro.sample_s": 5.0, "reference.at": "series", "reference.every_s": 600.0}
    recording = simulator.simulate(simulator.override(simulator.load("trmm"), coarse), seed=3)
    papers = {"natanson": RESULTS / "reproduction", "robertson": RESULTS / "mission"}
    return {
        "diagnosis": build_diagnosis_page(CASES["pair"]()).render_html(),
        "calibration": build_calibration_page(calibrate(recording), "").render_html(),
        "index": build_index_page(papers, tmp_path_factory.mktemp("none")),
    }


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_pages_fit_their_window_and_can_be_read(pages, tmp_path, dark):
    seen = browsed(pages, tmp_path, dark=dark)
    assert {one["dark"] for one in seen.values()} == {dark}
    assert {key: one["spill"] for key, one in seen.items() if one["spill"] > SPILT} == {}
    assert {key: one["faint"] for key, one in seen.items() if one["contrast"] < LEAST} == {}
    assert all(one["figures"] and min(one["figures"]) > 0 for one in seen.values())  # each figure is drawn
    assert all(one["unreachable"] == [] for one in seen.values())
    assert {key: one["cut"] for key, one in seen.items() if key[0] == "index" and one["cut"] > SPILT} == {}
