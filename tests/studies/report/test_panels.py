"""Every panel draws what it is given, and the same bytes each time."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from studies.report import panels
from studies.report.panels import Line

X = np.array([0.5, 1.0, 2.0])
GRID = pd.DataFrame([[1e-6, 2e-5], [np.nan, 3e-4]], index=[0.1, 0.5], columns=[1.0, 2.0])

PANELS = {
    "curves": panels.make_curves(
        [Line(X, X, "band", low=X / 2, high=2 * X), Line(X, X, "bars", low=X / 2, high=2 * X, bars=True)],
        (0.8, 1.2),
        log="xy",
        levels=[1.0],
        at=[1.0],
        ticks=X,
        legend="best",
        legend_title="both",
    ),
    "heat map": panels.make_heat_map(GRID, mark_above=1e-4, log=True, title="grid", x="step", y="rate"),
}


def drawn(panel):
    axes = Figure().add_subplot()
    panel.draw_axes(axes)
    return axes


def test_curves_and_cells_have_their_lines_scales_and_crosses():
    axes = drawn(PANELS["curves"])
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["band", "bars"]
    assert [text.get_text() for text in axes.get_xticklabels()] == ["0.5", "1", "2"]
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), X)
    assert [text.get_text() for text in drawn(PANELS["heat map"]).texts] == ["1e-6", "2e-5", "3e-4 ✗"]
