"""Pieces of a page: what names, titles and messages of a file say is text in each of them, never a part of the page."""

from html import escape

import pandas as pd
import pytest

from studies.report import html

SAID = '<script>alert("a & b")</script>'
PICTURE = b'<svg width="72pt" height="72pt" viewBox="0 0 72 72"><g/></svg>'
PIECES = {
    "paragraph": lambda: html.paragraph(SAID),
    "list": lambda: html.bullets([SAID]),
    "heading": lambda: html.heading(SAID),
    "summary": lambda: html.folded(SAID, ""),
    "cell": lambda: html.table_of(pd.DataFrame({"a": [SAID]})),
    "column": lambda: html.table_of(pd.DataFrame({SAID: ["a"]})),
    "caption of a table": lambda: html.table_of(pd.DataFrame({"a": ["a"]}), caption=SAID),
    "caption of a figure": lambda: html.figure("f", PICTURE, "", SAID),
    "words for a figure": lambda: html.figure("f", PICTURE, SAID, ""),
    "title": lambda: html.document("t", [], short=SAID),
    "heading of the page": lambda: html.document(SAID, [], short="t"),
}


@pytest.mark.parametrize("piece", PIECES)
def test_what_is_said_is_text(piece):
    made = PIECES[piece]()
    assert "<script" not in made
    assert escape(SAID) in made


def test_a_cell_that_is_html_stays_so():
    assert "<td><b>1</b></td>" in html.table_of(pd.DataFrame({"a": [html.Html("<b>1</b>")]}, dtype=object))
