"""Sphinx reads README, docs/ and the committed reports where they are: `make docs` writes site/.

The repository is the source folder, so that a link between two pages is the same for who reads the files and for the site.
Nothing that a page needs is outside it: the system's fonts, equations as drawings, the search's index beside the pages.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

import matplotlib as mpl
from docutils import nodes
from matplotlib.mathtext import math_to_image
from sphinx.application import Sphinx

import gyrocal

project = "gyrocal"
author = "The gyrocal developers"
copyright = f"2026, {author}"
version = release = gyrocal.__version__

root_doc = "docs/index"
include_patterns = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "docs/**.md", "results/**/report.md"]
include_patterns += ["results/reproduction/tables.md"]
exclude_patterns = [".*", "build", "dist", "site", "tests", "**/__pycache__", "**/parts", "**/work"]
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
suppress_warnings = [
    "myst.header",  # a table of results is a page that begins with a heading of the second level
    "ref.python",  # several classes have an attribute of one name, which the field lists link to
]

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # docstrings say what arrays have in place of ndarray: shapes and units
default_role = "code"
smartquotes = False  # three points in a shape are three points
napoleon_google_docstring = False
napoleon_use_ivar = True

html_theme = "pydata_sphinx_theme"
html_title = f"gyrocal {version}"
html_theme_options = {"navigation_with_keys": False, "show_toc_level": 2, "navbar_center": [], "navbar_end": ["theme-switcher"]}
html_show_sourcelink = False
html_math_renderer = "drawn"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_sidebars = {"**": ["globaltoc.html"]}

FIELDS = ("Parameters", "Attributes", "Returns")
FIRST_PAGE = (
    '<!doctype html><html lang="en"><meta charset="utf-8"><title>gyrocal</title>'
    '<meta http-equiv="refresh" content="0; url={0}"><a href="{0}">gyrocal</a></html>\n'
)


def visit_math(self: Any, node: nodes.math | nodes.math_block) -> None:
    """An equation as a drawing in the text's colour: MathML without a font for mathematics has no subscripts."""
    out, tex = io.BytesIO(), " ".join(node.astext().split())
    with mpl.rc_context({"svg.fonttype": "path", "svg.hashsalt": project, "mathtext.fontset": "stix"}):
        math_to_image(f"${tex}$", out, dpi=72, format="svg", color="#123456")
    svg = re.sub(r"<metadata>.*?</metadata>", "", out.getvalue().decode(), flags=re.DOTALL)
    svg = svg[svg.index("<svg") :].replace("#123456", "currentColor").replace("#ffffff", "none")
    svg = re.sub(r'width="([\d.]+)pt" height="([\d.]+)pt"', lambda found: f'width="{1.9 * float(found[1]):.0f}"', svg, count=1)
    tag = "div" if isinstance(node, nodes.math_block) else "span"
    self.body.append(f'<{tag} class="equation" role="img" aria-label="{escape(tex)}">{svg}</{tag}>\n')
    raise nodes.SkipNode


def as_restructured_text(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """The project's docstrings are plain text with the sections of numpydoc; this says so to Sphinx."""
    lines[:] = list(_lines(lines))


def _lines(lines: list[str]) -> Iterator[str]:
    """Equations are set off by their indentation, and ``name : what it is`` names no type."""
    section, literal = "", False
    for number, line in enumerate(lines):
        bare, indented = line.strip(), line.startswith("    ")
        if number + 1 < len(lines) and bare and re.fullmatch(r"-{3,}", lines[number + 1].strip()):
            section = bare
        if section:
            field = re.match(r"(\S.*?) : (.*)", line)
            if section in FIELDS and field:
                yield from (field[1], f"    {_escaped(field[2])}")
            else:
                yield line if re.fullmatch(r"\S*", line) else _escaped(line)
            continue
        if indented and not literal and bare and not (number and lines[number - 1].strip()):
            literal = True
            yield from ("::", "")
        literal = literal and (indented or not bare)
        yield line if literal else _escaped(line)


def _escaped(line: str) -> str:
    """A line of text without the signs that have a meaning of their own, those in backticks left."""
    parts = re.split(r"(`+[^`]*`+)", line)
    return "".join(part if number % 2 else re.sub(r"([*|\\]|_(?=\W|$))", r"\\\1", part) for number, part in enumerate(parts))


def with_first_page(app: Sphinx, exception: Exception | None) -> None:
    """A page at the top of the folder, from which a browser goes to the first."""
    if exception is None and app.builder.format == "html":
        (Path(app.outdir) / "index.html").write_text(FIRST_PAGE.format(f"{root_doc}.html"), encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """What this site has beyond Sphinx's own."""
    app.add_html_math_renderer("drawn", inline_renderers=(visit_math, None), block_renderers=(visit_math, None))
    app.connect("autodoc-process-docstring", as_restructured_text, priority=400)
    app.connect("build-finished", with_first_page)
    return {"parallel_read_safe": True}
