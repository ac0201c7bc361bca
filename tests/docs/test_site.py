"""The site is built without a warning, holds every page and loads nothing from elsewhere."""

import io
import re
from html.parser import HTMLParser

import pytest

from tests import ROOT
from tests.docs.blocks import PAGES
from tests.pages import BROWSER, SPILT, browsed

pytest.importorskip("pydata_sphinx_theme", reason="needs the extra docs")
pytest.importorskip("myst_parser", reason="needs the extra docs")

from sphinx.application import Sphinx
from sphinx.util.docutils import docutils_namespace, patch_docutils

WRITTEN = ("docs/index", "docs/theory", "docs/gallery", "docs/api")  # all pages are read and their links resolved
LOADING = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "srcset", "use": "href", "object": "data"}


class Loaded(HTMLParser):
    """What a page loads, and the text alternatives of what it draws."""

    def __init__(self, text):
        super().__init__()
        self.addresses, self.labels = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        if tag in LOADING and LOADING[tag] in attributes:
            self.addresses.append(attributes[LOADING[tag]])
        if attributes.get("class") == "equation":
            self.labels.append(attributes["aria-label"])


@pytest.mark.filterwarnings("default")  # those of Sphinx and its extensions are not ours
def test_the_site_is_built_without_a_warning_and_loads_nothing_from_elsewhere(tmp_path):
    """One test, since the pages are read once: in a process of its own each check would read them again."""
    warned, site = io.StringIO(), tmp_path / "site"
    without_sources = {"extensions": ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]}  # coloured sources are slow
    with patch_docutils(str(ROOT / "docs")), docutils_namespace():
        app = Sphinx(ROOT, ROOT / "docs", site, tmp_path / "read", "html", without_sources, status=None, warning=warned)
        app.builder.search = False  # its index is of all pages or none
        app.build(filenames=[str(ROOT / f"{name}.md") for name in WRITTEN])
    assert warned.getvalue() == ""
    assert {page.removesuffix(".md") for page in PAGES} <= set(app.env.found_docs)
    nothing_is_loaded_from_elsewhere(site)
    equations_are_drawn_and_can_be_read_out((site / "docs" / "theory.html").read_text(encoding="utf-8"))
    if BROWSER is not None:
        a_browser_shows_it_narrow_and_wide_light_and_dark(site)
    shapes = (site / "docs" / "api.html").read_text(encoding="utf-8")
    assert "(..., 3, 3)" in shapes
    assert "inertial to body, scalar last" in shapes


def a_browser_shows_it_narrow_and_wide_light_and_dark(site):
    for dark in (False, True):
        seen = browsed(WRITTEN, site, dark)
        assert {one["dark"] for one in seen.values()} == {dark}
        assert {key: one["spill"] for key, one in seen.items() if one["spill"] > SPILT} == {}
        assert {key: one["faint"] for key, one in seen.items() if one["contrast"] < 4.5} == {}


def nothing_is_loaded_from_elsewhere(site):
    for name in WRITTEN:
        page = Loaded((site / f"{name}.html").read_text(encoding="utf-8"))
        assert page.addresses
        assert [one for one in page.addresses if re.match(r"(https?:)?//", one)] == []
    for sheet in site.rglob("*.css"):
        addresses = re.findall(r"url\(\s*[\"']?([^\"')]+)|@import\s+[\"']([^\"']+)", sheet.read_text(encoding="utf-8"))
        assert [one for pair in addresses for one in pair if re.match(r"(https?:)?//", one)] == [], sheet


def equations_are_drawn_and_can_be_read_out(text):
    source = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8")
    equations = [" ".join(one.split()) for one in re.findall(r"^\$\$\n(.*?)\n\$\$$", source, flags=re.MULTILINE | re.DOTALL)]
    assert Loaded(text).labels == equations
    assert len(equations) > 8
    drawn = re.findall(r'class="equation".*?</svg>', text, flags=re.DOTALL)
    assert all("currentColor" in one and not re.search(r"#[0-9a-f]{6}", one) for one in drawn)  # no paper of their own
