"""The page of a reproduction, made of the committed results."""

import json
import re
import shutil

import pandas as pd
import pytest

from studies.natanson.claims import NATANSON_CLAIMS as NATANSON
from studies.report import committed_results, index_page
from studies.report.claims import PaperResults, judge_claims
from studies.report.pages import ProvenanceFooter
from studies.robertson.claims import ROBERTSON_CLAIMS as ROBERTSON
from tests import ROOT
from tests.pages import checked

RESULTS = ROOT / "results"
FOLDERS = {"natanson": RESULTS / "reproduction", "robertson": RESULTS / "mission"}
MADE = ProvenanceFooter("1", "2026-01-01", "gyrocal reproduce", "0" * 64)


@pytest.fixture(scope="module")
def text():
    return index_page.build_index_page(FOLDERS, RESULTS / "studies", MADE)


@pytest.fixture(scope="module")
def page(text):
    return checked(text, most_bytes=5_000_000)


def test_the_first_screen_answers_both_papers_questions_before_the_evidence(text):
    first = text[text.index("<main") : text.index("Every claim of both papers</h2>")]
    assert first.index('<figure id="agreement">') < first.index("<nav")
    for question in ("Do simulation and flight agree?", "Where not?", "Which cause?", "How sure?", "What next?"):
        assert first.count(question) == first.count("How far does the gap shrink?") == 2
    gap = pd.read_csv(FOLDERS["natanson"] / "flight_gap.csv")
    worst = gap.loc[gap["clean_gap_deg"].abs().idxmax()]
    assert f"Most in interval {worst['interval']}, {worst['axis']}, by {worst['clean_gap_deg']:+.4f} deg" in first
    assert "which is circular" in first


def test_every_claim_leads_to_its_evidence(page, text):
    claims = text[text.index("Every claim of both papers</h2>") : text.index('<h2 id="n-natanson-1998')]
    links = re.findall(r'href="#([^"]+)"', claims)
    assert len(links) == len(NATANSON) + len(ROBERTSON)
    sections = set(re.findall(r'<h3 id="([^"]+)"', text))
    assert [one for one in links if one not in sections] == []


def test_all_figures_are_there_with_what_makes_them(page, text):
    files = [path for folder in FOLDERS.values() for path in folder.glob("*.svg")]
    assert {f"{path.parent.name}-{path.stem}" for path in files} <= set(page.figures)
    manifest = json.loads((FOLDERS["natanson"] / "manifest.json").read_text())
    assert manifest["files"]["flight_gap.svg"][:16] in text
    assert manifest["commit"][:12] in text
    assert MADE.sha256 in text


def test_a_verdict_follows_the_numbers():
    """A negative control: with other numbers the same claim has another verdict."""
    results = committed_results.read(FOLDERS["natanson"])
    found = PaperResults(results, RESULTS / "studies")
    verdicts = {one.claim.text: one.verdict for one in judge_claims(NATANSON, found)}
    assert verdicts["-y forward turns about x with +1 RPO"] == "the paper slips"
    turned = {**results.summary, "minus_y_rate_rpo.favoured": 1, "clean_gap_rms_deg.assumed": 0.1}
    other = PaperResults(committed_results.Results(results.folder, {}, turned, results.tables), RESULTS / "studies")
    verdicts = {one.claim.text: one.verdict for one in judge_claims(NATANSON, other)}
    assert verdicts["-y forward turns about x with +1 RPO"] == "agrees"
    assert verdicts["18 residuals before calibration"] == "open"


def test_what_was_not_flown_is_open(tmp_path):
    empty = PaperResults(committed_results.Results(tmp_path, {}, {}, {}), tmp_path)
    assert {one.verdict for one in judge_claims(ROBERTSON, empty)} == {"open"}
    shutil.copy(FOLDERS["robertson"] / "manifest.json", tmp_path)
    (tmp_path / "summary.json").write_text("{}")
    checked(index_page.build_index_page({"robertson": tmp_path}, tmp_path, MADE))
