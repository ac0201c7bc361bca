"""The site is built without a warning and loads nothing from elsewhere; pictures, lists and examples are those of the code."""

import doctest
import io
import re
import runpy
import sys

import pytest

import simulator
from simulator.mission_mode import flight
from studies.natanson.claims import NATANSON_CLAIMS
from studies.report import committed_results
from studies.report.claims import PaperResults, judge_claims
from studies.robertson.claims import ROBERTSON_CLAIMS
from tests import ROOT
from tests.docs.blocks import PAGES

EXAMPLES = ROOT / "docs" / "examples"
PICTURES = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
DRAWN = re.findall(r"\(examples/(\w+)\.svg\)", PICTURES)
WRITTEN = ("docs/index", "docs/theory", "docs/api")  # all pages are read and their links resolved


@pytest.mark.filterwarnings("default")  # those of Sphinx and its extensions are not ours
def test_the_site_is_built_without_a_warning_and_loads_nothing_from_elsewhere(tmp_path):
    pytest.importorskip("pydata_sphinx_theme", reason="needs the extra docs")
    from sphinx.application import Sphinx
    from sphinx.util.docutils import docutils_namespace, patch_docutils

    warned, site = io.StringIO(), tmp_path / "site"
    without_sources = {"extensions": ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]}  # coloured sources are slow
    with patch_docutils(str(ROOT / "docs")), docutils_namespace():
        app = Sphinx(ROOT, ROOT / "docs", site, tmp_path / "read", "html", without_sources, status=None, warning=warned)
        app.builder.search = False  # its index is of all pages or none
        app.build(filenames=[str(ROOT / f"{name}.md") for name in WRITTEN])
    assert warned.getvalue() == ""
    assert {page.removesuffix(".md") for page in PAGES} <= set(app.env.found_docs)
    pages = {name: (site / f"{name}.html").read_text(encoding="utf-8") for name in WRITTEN}
    for text in pages.values():
        loaded = re.findall(r"<(?:script|img|iframe|source|link|object)\b[^>]*?(?:src|srcset|href|data)=\"([^\"]+)\"", text)
        assert not [address for address in loaded if re.match(r"(https?:)?//", address)]
    for sheet in site.rglob("*.css"):
        assert not re.search(r"(url\(\s*[\"']?|@import\s+[\"'])(https?:)?//", sheet.read_text(encoding="utf-8")), sheet
    assert pages["docs/theory"].count('class="equation"') > 8


@pytest.mark.parametrize("name", DRAWN)
def test_an_example_draws_the_picture_that_is_shown(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(EXAMPLES)
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    sys.modules.pop("own_log", None)
    assert capsys.readouterr().out
    made, shown = ((folder / f"{name}.svg").read_text(encoding="utf-8") for folder in (tmp_path, EXAMPLES))
    assert re.findall(r"<text[^>]*>([^<]+)</text>", made) == re.findall(r"<text[^>]*>([^<]+)</text>", shown)


def test_examples_of_docstrings():
    for module in (simulator, simulator.scenario, flight):
        result = doctest.testmod(module)
        assert (result.failed, result.attempted > 0) == (0, True)


def test_slips_of_the_papers_are_those_of_the_reproduction():
    listed = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8").split("## Where the papers slip")[1]
    slips = []
    for folder, claims in (("reproduction", NATANSON_CLAIMS), ("mission", ROBERTSON_CLAIMS)):
        results = PaperResults(committed_results.read(ROOT / "results" / folder), ROOT / "results" / "studies")
        slips += [one.claim.where for one in judge_claims(claims, results) if one.verdict == "the paper slips"]
    assert re.findall(r"^\| ([NR] .*?) \| .* \|$", listed, flags=re.MULTILINE) == slips
