"""Figures as SVG: text is text, and names do not depend on the last bits of floats."""

import re

from matplotlib.figure import Figure

from studies.report import svg
from studies.report.panels import Line, draw_panels, make_curves


def figure_at(shift: float) -> Figure:
    """A figure with a clipped line, markers and a hatch, on axes and at points that lie so far apart from the plain ones."""
    figure = Figure(figsize=(3, 2))
    axes = figure.add_axes((0.1 + shift, 0.1, 0.8, 0.8))
    axes.plot([0, 1 + shift], [0, 1], marker="o")
    axes.fill_between([0, 1], [0, 1 + shift], hatch="//")
    axes.scatter([0.1 + shift, 0.5], [0.2, 0.3], s=10 + shift)
    return figure


def test_text_is_text_and_a_compact_figure_keeps_it():
    panel = make_curves([Line([1.0, 10.0], [2.0, 20.0], "a line")], title="ω of x", x="time (s)", y="deg")
    data, again = (svg.render_svg(draw_panels(panel, panel, size=(6, 3), sharey=True)) for _ in range(2))
    assert data == again
    assert data.decode().count(">time (s)</text>") == 2
    assert "DejaVuSans-" not in data.decode()  # outlines of letters
    data = b'<text x="1.2345">0.123456</text>\n   <path d="M 1.999 2.0"/>'
    assert svg.shorten_svg(data) == b'<text x="1.2">0.123456</text> <path d="M 1.9 2.0"/>'


def test_names_in_an_svg_do_not_depend_on_the_last_bits(monkeypatch):
    plain, moved = (svg.render_svg(figure_at(shift)) for shift in (0.0, 1e-13))
    assert b"clipPath" in plain
    assert b"<pattern" in plain
    assert plain == moved
    assert svg.render_svg(figure_at(0.01)) != plain
    # Every name that is used is defined.
    defined = set(re.findall(rb' id="([^"]+)"', plain))
    used = set(re.findall(rb'(?:href="#|url\(#)([^")]+)', plain))
    assert used <= defined
    assert len(used) > 5
    monkeypatch.setattr(svg, "name_by_content", lambda data: data)
    assert len({svg.render_svg(figure_at(shift)) for shift in (0.0, 1e-13)}) == 2
