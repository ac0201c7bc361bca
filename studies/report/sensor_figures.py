"""Residuals of a sun sensor against where the Sun is in its field of view."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.report.panels import STYLE

BEFORE, BETWEEN, AFTER = "#d55e00", "#999999", "#0072b2"
COLOURS = {"before_deg": BEFORE, "after_deg": AFTER}
MOST_POINTS = 1500


def sun_residual_figure(residuals: pd.DataFrame, sensor: str, titles: dict[str, str]) -> Figure:
    """Residuals of α and β over α and over β.

    Parameters
    ----------
    residuals : sensor, angle, alpha_deg, beta_deg and the columns of `titles`, deg
    sensor : name of the sun sensor
    titles : legend of each column of residuals, drawn in this order
    """
    own = residuals[residuals["sensor"] == sensor]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.6, 4.6), layout="constrained")
        panels = figure.subplots(2, 2, sharey=True)
        for row, angle in enumerate(("alpha", "beta")):
            part = _thinned(own[own["angle"] == angle])
            for column, over in enumerate(("alpha", "beta")):
                _panel(panels[row][column], part, over, titles)
                panels[row][column].set_xlabel(f"Sun's {over} (deg)")
            panels[row][0].set_ylabel(f"residual of {angle} (deg)")
        handles, labels = panels[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=len(labels), fontsize=8, markerscale=4)
        figure.suptitle(f"{sensor}, measured minus predicted", fontsize=9, x=0.01, ha="left")
    return figure


def _thinned(table: pd.DataFrame) -> pd.DataFrame:
    return table.iloc[:: max(1, len(table) // MOST_POINTS)]


def _panel(axes: Axes, part: pd.DataFrame, over: str, titles: dict[str, str]) -> None:
    x = part[f"{over}_deg"].to_numpy()
    for name, title in titles.items():
        y = part[name].to_numpy()
        axes.plot(x, y, ".", markersize=2, color=COLOURS.get(name, BETWEEN), label=title, rasterized=True)
    axes.axhline(0.0, color="0.3", linewidth=0.6)
    axes.margins(x=0.02)
    if not np.isfinite(x).any():
        axes.set_xlim(-48, 48)


def gap_figure(gaps: pd.DataFrame, columns: list[str]) -> Figure:
    """Held-out mean square by truth, a mark for each explanation; logarithmic, with the floor.

    Parameters
    ----------
    gaps : truth, the columns, and floor
    columns : explanations, in this order
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.4, 2.6), layout="constrained")
        axes = figure.subplots()
        rows = np.arange(len(gaps))
        marks = (("o", BEFORE), ("s", BETWEEN), ("D", AFTER))
        for k, (column, (mark, colour)) in enumerate(zip(columns, marks, strict=True)):
            axes.plot(gaps[column], rows + 0.2 * (k - 1), mark, color=colour, markersize=6, label=column)
        axes.axvline(float(gaps["floor"].iloc[0]), color="0.3", linestyle="--", linewidth=0.8, label="floor")
        axes.set_xscale("log")
        axes.set_xlim(0.9, 1.2 * float(gaps[columns].to_numpy().max()))
        ticks = [1.0, 1.3, 2.0, 5.0, 10.0, 20.0]
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_xticks([], minor=True)
        axes.set_yticks(rows, [f"truth: {name}" for name in gaps["truth"]])
        axes.set_ylim(len(gaps) - 0.5, -0.5)
        axes.set_xlabel("mean square of held-out residuals in sigmas")
        figure.legend(loc="outside upper center", ncols=len(columns) + 1, fontsize=8)
    return figure
