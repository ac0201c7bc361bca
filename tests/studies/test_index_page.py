"""The page of the reproduction, made from the committed results."""

import json

import pytest

from studies import index_page
from studies.natanson.claims import NATANSON_CLAIMS
from studies.natanson.reproduce import FIGURE_TITLES
from studies.report import committed_results
from studies.report.claims import PaperResults, judge_claims
from studies.report.pages import ProvenanceFooter
from studies.robertson.claims import ROBERTSON_CLAIMS
from studies.robertson.figures import MISSION_FIGURE_TITLES
from tests import ROOT
from tests.pages import checked

RESULTS = ROOT / "results"
FOLDERS = {"natanson": RESULTS / "reproduction", "robertson": RESULTS / "mission"}
MADE = ProvenanceFooter("1", "2026-01-01", "gyrocal reproduce", "0" * 64)


@pytest.fixture(scope="module")
def text():
    return index_page.build_index_page(FOLDERS, RESULTS / "studies", MADE)


def test_the_page_shows_tables_figures_claims_and_the_flight_beside_the_simulation(text):
    page = checked(text, most_bytes=1_500_000)
    assert text.index('<figure id="residuals">') < text.index('<figure id="factors">') < text.index("N Table 2")
    heads = [f"{paper} Table {k}" for paper, tables in (("N", (2, 3, 4, 5)), ("R", (1, 2, 3))) for k in tables]
    places = [text.index(f"{head}: ") for head in [*heads, "Claims of N", "Claims of R"]]
    assert places == sorted(places)
    shown = [f"reproduction-{name}" for name in FIGURE_TITLES] + [f"mission-{name}" for name in MISSION_FIGURE_TITLES]
    assert set(page.figures) == {"residuals", "factors", *shown}
    commit = json.loads((FOLDERS["natanson"] / "manifest.json").read_text())["commit"]
    assert commit[:12] in text
    # N Table 2, interval 3, pitch; R Table 2, roll before calibration.
    for flown, simulated in (("-0.433", "-0.427 ± 0.021"), ("0.248", "0.216 ± 0.006")):
        cells = text[text.index(f">{flown}</td>") :].split("</td>")
        assert cells[1].endswith(f">{simulated}")


def test_a_verdict_follows_the_numbers():
    """A negative control: with other numbers the same claim has another verdict."""
    results = committed_results.read(FOLDERS["natanson"])
    verdicts = {one.claim.text: one.verdict for one in judge_claims(NATANSON_CLAIMS, PaperResults(results, RESULTS))}
    assert verdicts["-y forward turns about x with +1 RPO"] == "the paper slips"
    assert verdicts["About 60 000 points for all six maneuvers"] == "our reading"
    turned = {**results.summary, "minus_y_rate_rpo.favoured": 1, "clean_gap_rms_deg.assumed": 0.1}
    other = PaperResults(committed_results.Results(results.folder, {}, turned, results.tables), RESULTS)
    verdicts = {one.claim.text: one.verdict for one in judge_claims(NATANSON_CLAIMS, other)}
    assert verdicts["-y forward turns about x with +1 RPO"] == "agrees"
    assert verdicts["18 residuals before calibration"] == "open"


def test_claims_without_results_are_open(tmp_path):
    empty = PaperResults(committed_results.Results(tmp_path, {}, {}, {}), tmp_path)
    assert {one.verdict for one in judge_claims(ROBERTSON_CLAIMS, empty)} == {"open"}
    (tmp_path / "summary.json").write_text("{}")
    (tmp_path / "manifest.json").write_text("{}")
    checked(index_page.build_index_page({"robertson": tmp_path}, tmp_path, MADE))
