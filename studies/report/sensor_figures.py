"""Residuals of a sun sensor against where the Sun is in its field of view."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from studies.report import panels
from studies.report.panels import Line

BEFORE, BETWEEN, AFTER = panels.RED, "#999999", panels.BLUE
RESIDUAL_COLOURS = {"before_deg": BEFORE, "after_deg": AFTER}
MOST_POINTS = 1500


def draw_sun_residuals(residuals: pd.DataFrame, sensor: str, titles: dict[str, str]) -> Figure:
    """Residuals of α and β over α and over β.

    Parameters
    ----------
    residuals : sensor, angle, alpha_deg, beta_deg and the columns of `titles`, deg
    sensor : name of the sun sensor
    titles : legend of each column of residuals, drawn in this order
    """
    own = residuals[residuals["sensor"] == sensor]
    drawn = []
    for angle in ("alpha", "beta"):
        part = own[own["angle"] == angle]
        part = part.iloc[:: max(1, len(part) // MOST_POINTS)]
        for over in ("alpha", "beta"):
            looks = {name: (title, RESIDUAL_COLOURS.get(name, BETWEEN), ".") for name, title in titles.items()}
            lines = [Line(part[f"{over}_deg"], part[name], *look, size=2.0) for name, look in looks.items()]
            y = f"residual of {angle} (deg)" if over == "alpha" else ""
            drawn.append(panels.make_curves(lines, levels=[0], x=f"Sun's {over} (deg)", y=y))
    title = f"{sensor}, measured minus predicted"
    return panels.draw_panels(*drawn, size=(8.6, 4.6), columns=2, title=title, sharey="all", legend="outside upper right")


def draw_gap_figure(gaps: pd.DataFrame, columns: list[str]) -> Figure:
    """Held-out mean square by truth, a mark for each explanation; logarithmic, with the floor.

    Parameters
    ----------
    gaps : truth, the columns, and floor
    columns : explanations, in this order
    """
    rows = np.arange(len(gaps))
    looks = zip(columns, (BEFORE, BETWEEN, AFTER), "osD", strict=True)
    lines = [Line(gaps[name], rows, name, colour, mark, size=6.0) for name, colour, mark in looks]
    axes: dict[str, Any] = {"log": "x", "ticks": [1.0, 1.3, 2.0, 5.0, 10.0, 20.0], "at": [float(gaps["floor"].iloc[0])]}
    axes |= {
        "rows": [f"truth: {name}" for name in gaps["truth"]],
        "x": "mean square of held-out residuals in sigmas; dotted: floor",
    }
    return panels.draw_panels(panels.make_curves(lines, **axes), size=(7.4, 2.6), legend="outside upper center")
