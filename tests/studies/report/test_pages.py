"""The one template of all pages: names, titles and messages of a file are text in it, never a part of the page."""

import hashlib
import json
from html import escape

import pandas as pd
import pytest

from studies.report.pages import Answer, Page, PageTable, Picture, ProvenanceFooter, Section
from tests import ROOT

SAID = '<script>alert("a & b")</script>'
PICTURE = b'<svg width="72pt" height="72pt" viewBox="0 0 72 72"><g/></svg>'
FOLDERS = sorted(path.parent for path in (ROOT / "results" / "studies").glob("*/manifest.json"))


def picture(alt="", caption=""):
    return Picture("f", lambda: PICTURE, alt, caption)


ITEMS = {
    "paragraph": SAID,
    "term": {SAID: "a"},
    "definition": {"a": SAID},
    "cell": PageTable(pd.DataFrame({"a": [SAID]})),
    "words for a figure": picture(alt=SAID),
}
PAGES = {name: Page("t", [Section("s", [item])]) for name, item in ITEMS.items()} | {
    "heading": Page("t", [Section(SAID, [])]),
    "title": Page("t", [], short=SAID),
    "answer": Page("t", [], Answer("", picture(), SAID, {})),
    "footer": Page("t", [], provenance=ProvenanceFooter("1", "2026-01-01", SAID)),
}


@pytest.mark.parametrize("name", PAGES)
def test_what_is_said_is_text(name):
    page = PAGES[name].render_html()
    assert "<script" not in page
    assert escape(SAID).replace("&quot;", "&#34;") in page.replace("&quot;", "&#34;")


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_a_figures_hash_is_that_of_its_file(folder):
    files = json.loads((folder / "manifest.json").read_text())["files"]
    for path in folder.glob("*.svg"):
        if path.name in files:  # the oldest manifests have only their rows'
            assert files[path.name] == hashlib.sha256(path.read_bytes()).hexdigest()
