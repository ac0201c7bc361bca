"""Figures as SVG, and as pieces of a page."""

import re

import numpy as np
import pandas as pd
import pytest

from studies.report import html, svg
from studies.report.html import Picture
from studies.report.panels import Line, curves, drawn, heat_map
from tests.pages import checked


def two(log=""):
    panel = curves([Line([1.0, 10.0], [2.0, 20.0], "a line")], title="ω of x", x="time (s)", y="deg", log=log)
    return drawn(panel, panel, size=(6, 3), sharey=True)


def test_text_is_text_and_bytes_are_the_same():
    data = svg.svg_bytes(two())
    assert data == svg.svg_bytes(two())
    assert data.decode().count(">time (s)</text>") == 2
    assert "DejaVuSans-" not in data.decode()  # outlines of letters


def test_panels_stack_only_where_each_has_its_labels():
    text = svg.svg_bytes(two()).decode()
    places = [[float(one) for one in part.split()] for part in re.search('data-panels="([^"]+)"', text)[1].split(",")]
    (left, top, width, height), (other, *_) = places
    assert left + width <= other + 2 * svg.MARGIN + 1
    assert left + svg.MARGIN + 1e-6 >= 0
    assert top + height <= 3 * svg.POINTS + 2 * svg.MARGIN
    alone = two()
    alone.axes[1].tick_params(labelleft=False)
    assert "data-panels" not in svg.svg_bytes(alone).decode()


def test_scales_give_a_markers_value_back():
    """As the page's script does it: a marker's place in points, through its axes' limits."""
    for log in ("", "xy"):
        text = svg.svg_bytes(two(log)).decode()
        first = re.search('data-axes="([^"]+)"', text)[1].split(",")[0].split()
        x0, y0, x1, y1, low_x, high_x, low_y, high_y = map(float, first[:8])
        marks = [(float(x), float(y)) for x, y in re.findall(r'<use [^>]*x="([\d.]+)" y="([\d.]+)"', text)]
        inside = [(x, y) for x, y in marks if x0 + 0.5 < x < x1 - 0.5 and y0 + 0.5 < y < y1 - 0.5]
        shares = np.array([((x - x0) / (x1 - x0), (y - y1) / (y0 - y1)) for x, y in inside])
        low, high = np.array([low_x, low_y]), np.array([high_x, high_y])
        values = low * (high / low) ** shares if log else low + shares * (high - low)
        np.testing.assert_allclose(values, [[1, 2], [10, 20]], rtol=5e-3)


def test_a_map_keeps_its_colours_and_a_line_follows_the_page():
    map_ = drawn(heat_map(pd.DataFrame([[1.0, 2.0]])), size=(3, 2))
    kept = svg.inline(svg.svg_bytes(map_), "m", "a map")
    assert "var(--c-" not in kept
    assert 'class="whole fixed"' in kept
    assert "var(--c-" in svg.inline(svg.svg_bytes(two()), "l", "lines")


def test_two_figures_share_no_id():
    pictures = [Picture(name, two, "Two panels with the same line from 2 to 20 deg, twice.", "A line.") for name in ("a", "b")]
    page = checked(html.document("Title", [html.heading("Part"), *(html.shown(one) for one in pictures)]))
    assert set(page.figures) == {"a", "b"}


@pytest.mark.parametrize("colour", ["#cc3311", "#0077bb", "#30343f", "#f2c14e", "#000080"])
def test_colours_at_night_stand_out_and_keep_their_hue(colour):
    night = svg.at_night(colour)
    assert svg.contrast(night, svg.DARK[0]) >= svg.CONTRAST
    spread = [
        max(int(one[k : k + 2], 16) for k in (1, 3, 5)) - min(int(one[k : k + 2], 16) for k in (1, 3, 5))
        for one in (colour, night)
    ]
    assert spread[0] < 30 or spread[1] > 30


def test_contrast_is_that_of_wcag():
    assert svg.contrast("#ffffff", "#000000") == pytest.approx(21.0)
    assert svg.contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)
    assert svg.at_night("#ffffff") == svg.DARK[0]
    assert svg.at_night("#000000") == svg.DARK[1]


def test_markers_of_one_style_share_it():
    mark = '<use href="#m" x="{}" y="2" style="fill: red"/>'
    drawn = f'<svg viewBox="0 0 9 9"><defs><path id="m" d="M 0 0"/></defs><g> {" ".join(map(mark.format, range(4)))} </g></svg>'
    piece = svg.inline(drawn.encode(), "a", "markers")
    assert piece.count("fill: red") == 1
    assert [f'x="{k}"' in piece for k in range(4)] == [True] * 4
