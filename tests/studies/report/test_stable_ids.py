import io
import re

import matplotlib as mpl
from matplotlib.figure import Figure

from studies.report.stable_ids import stable


def written(figure: Figure) -> bytes:
    out = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "gyrocal"}):
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def figure_at(shift: float):
    """A figure with a clipped line, markers and a hatch, on axes and at points that lie so far apart from the plain ones."""
    figure = Figure(figsize=(3, 2))
    axes = figure.add_axes((0.1 + shift, 0.1, 0.8, 0.8))
    axes.plot([0, 1 + shift], [0, 1], marker="o")
    axes.fill_between([0, 1], [0, 1 + shift], hatch="//")
    axes.scatter([0.1 + shift, 0.5], [0.2, 0.3], s=10 + shift)
    return figure


def test_names_in_an_svg_do_not_depend_on_the_last_bits():
    plain, moved = (stable(written(figure_at(shift))) for shift in (0.0, 1e-13))
    assert b"clipPath" in plain
    assert b"<pattern" in plain
    assert plain == moved
    assert len({written(figure_at(shift)) for shift in (0.0, 1e-13)}) == 2
    assert stable(written(figure_at(0.01))) != plain
    # Every name that is used is defined.
    defined = set(re.findall(rb' id="([^"]+)"', plain))
    used = set(re.findall(rb'(?:href="#|url\(#)([^")]+)', plain))
    assert used <= defined
    assert len(used) > 5
