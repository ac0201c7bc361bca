"""Panels of figures, in one style: a study hands over its numbers, and how to name them.

A panel draws on axes it is given; `draw_panels` puts panels side by side in a figure, and `build_sheet` returns what draws them
to a file. SVG bytes do not depend on the day or the run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from gyrocal.files import open_replacement
from studies.report import svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Draw = Callable[[Path], Path]

PANEL_STYLE: dict[Any, Any] = svg.SVG_STYLE | {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.9",
    "axes.axisbelow": True,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
}
# Tol's vibrant scheme, and near-black: distinct for every kind of colour vision.
RED, TEAL, BLUE, ORANGE, DARK, GREY = "#cc3311", "#009988", "#0077bb", "#e0661a", "#30343f", "0.6"
AXIS_COLOURS = {"x": RED, "y": TEAL, "z": DARK}
AXIS_LINE_STYLES = {"x": "-.", "y": "--", "z": "-"}  # N draws the pitch rate dashed
SMALL_FONT_SIZE = 7  # font size of ticks and legends
MANY = 200  # points of a line: more are drawn as pixels


@dataclass(frozen=True)
class Panel:
    """What is drawn on one pair of axes."""

    draw: Callable[[Axes], None]  # draws it
    title: str = ""  # title, x, y: of the panel and its axes
    x: str = ""
    y: str = ""
    log: str = ""  # which axes are logarithmic: "x", "y" or "xy"
    levels: Sequence[float] = ()  # levels, at: where dashed horizontal, and dotted vertical, lines are
    at: Sequence[float] = ()
    ticks: Sequence[float] = ()  # of x, labelled as the numbers they are
    rows: Sequence[str] = ()  # names of y = 0, 1, 2 …, from the top
    legend: str = ""  # where its legend is, none by default
    legend_title: str = ""  # above it

    def draw_axes(self, axes: Axes) -> None:
        """Draw the panel with scales, lines, ticks, labels and legend of its axes."""
        for axis in self.log:
            getattr(axes, f"set_{axis}scale")("log")
        self.draw(axes)
        for level in self.levels:
            axes.axhline(level, color="0.4", linewidth=0.8, linestyle="--")
        for position in self.at:
            axes.axvline(position, color="0.4", linewidth=1, linestyle=":")
        if len(self.ticks):
            axes.set_xticks(self.ticks, [f"{tick:g}" for tick in self.ticks])
            axes.set_xticks([], minor=True)
        if self.rows:
            axes.set_yticks(range(len(self.rows)), self.rows)
            axes.set_ylim(len(self.rows) - 0.5, -0.5)
        axes.set_title(self.title, loc="left", fontsize=9)
        axes.set_xlabel(self.x)
        axes.set_ylabel(self.y)
        if self.legend:
            style: dict[str, Any] = {"loc": self.legend, "fontsize": SMALL_FONT_SIZE, "title_fontsize": SMALL_FONT_SIZE}
            axes.legend(title=self.legend_title or None, **style)


def draw_panels(
    *panels: Panel,
    size: tuple[float, float],
    columns: int = 0,
    title: str = "",
    legend: str = "",
    legend_title: str = "",
    widths: Sequence[float] | None = None,
    sharex: Any = False,
    sharey: Any = False,
) -> Figure:
    """Draw panels side by side, row by row, on a figure of that size in inches; widths of the columns are relative.

    The legend is that of the first panel, outside of all, such as "outside right center". sharex and sharey are matplotlib's;
    with sharey=True labels of y are on the left only.
    """
    columns = columns or len(panels)
    # Late, here and below: it takes half a second, which a summary on the terminal does not need.
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(PANEL_STYLE):
        figure = Figure(figsize=size, layout="constrained")
        rows = -(-len(panels) // columns)
        grid = figure.subplots(rows, columns, squeeze=False, width_ratios=widths, sharex=sharex, sharey=sharey)
        for axes, panel in zip(grid.ravel(), panels, strict=True):
            panel.draw_axes(axes)
            # Each panel keeps the numbers at its axes, so that it can stand alone in a narrow window.
            axes.tick_params(labelleft=True, labelbottom=True)
            if sharey is True and axes is not grid[0, 0]:
                axes.set_ylabel("")
        if title:
            figure.suptitle(title, fontsize=9, x=0.01, ha="left")
        if legend:
            handles, labels = grid[0, 0].get_legend_handles_labels()
            style: dict[str, Any] = {"loc": legend, "fontsize": 8, "title_fontsize": 8}
            legend_columns = 1 if legend.startswith("outside right") else len(labels)
            figure.legend(handles, labels, title=legend_title or None, ncols=legend_columns, **style)
    return figure


def build_sheet(*panels: Panel, **options: Any) -> Draw:
    """Build a function that saves panels side by side; options as of `draw_panels`."""
    return lambda path: save(draw_panels(*panels, **options), path)


def save(figure: Figure, path: Path) -> Path:
    """Write SVG (and PNG for a .png path) with stable bytes."""
    import matplotlib as mpl

    with mpl.rc_context(PANEL_STYLE), open_replacement(path) as file:
        if path.suffix == ".svg":
            file.write(svg.render_svg(figure))
        else:
            figure.savefig(file, format=path.suffix[1:], dpi=160)
    return path


@dataclass(frozen=True)
class Line:
    """A series of points."""

    x: ArrayLike  # x, y: where they are
    y: ArrayLike
    label: str = ""  # in the legend
    colour: str = TEAL  # colour, style: matplotlib's
    style: str = "o-"
    low: ArrayLike | None = None  # low, high: their ranges
    high: ArrayLike | None = None
    bars: bool = False  # whether ranges are bars, not a band
    size: float = 4.0  # of the markers
    hollow: bool = False  # whether the markers are open


def make_curves(lines: Sequence[Line], expected: tuple[float, float] | None = None, **axes: Any) -> Panel:
    """Make a panel of series with their ranges, over an expected range in grey; axes are attributes of the `Panel`."""

    def draw(on: Axes) -> None:
        if expected:
            on.axhspan(*expected, color="0.9")
        for line in lines:
            many = np.size(line.y) > MANY
            face = "none" if line.hollow else line.colour
            style: dict[str, Any] = {"color": line.colour, "markersize": line.size, "markerfacecolor": face}
            on.plot(line.x, line.y, line.style, label=line.label or None, rasterized=many, **style)
            if line.low is None or line.high is None:
                continue
            if line.bars:
                y, low, high = (np.asarray(values, dtype=float) for values in (line.y, line.low, line.high))
                on.errorbar(line.x, y, np.clip([y - low, high - y], 0, None), fmt="none", ecolor=line.colour, capsize=3)
            else:
                on.fill_between(line.x, line.low, line.high, color=line.colour, alpha=0.2, linewidth=0, rasterized=many)

    return Panel(draw, **axes)


def make_power_law(x: ArrayLike, order: float, at: float = 1.0, label: str = "") -> Line:
    """Make a line of slope `order` on logarithmic axes, through y = at in the first point."""
    values = np.asarray(x, dtype=float)
    return Line(values, at * (values / values[0]) ** order, label, GREY, "--")


def make_shades(values: Sequence[float]) -> dict[float, str]:
    """Choose a colour for each value of a setting, dark to light."""
    import matplotlib as mpl

    steps = mpl.colormaps["viridis"](np.linspace(0, 0.85, len(values)))
    return {value: mpl.colors.to_hex(step) for value, step in zip(values, steps, strict=True)}


def make_heat_map(
    grid: pd.DataFrame,
    form: str = "{:.0e}",
    mark_above: float = np.inf,
    log: bool = False,
    **axes: Any,
) -> Panel:
    """Make a panel of numbers coloured by size or logarithm, rows upwards; those above `mark_above` are crossed."""
    values = np.asarray(grid.to_numpy(dtype=float))
    strength = np.log10(values) if log else values
    low, high = float(np.nanmin(strength)), float(np.nanmax(strength))
    middle = (low + high) / 2

    def draw(on: Axes) -> None:
        on.grid(False)
        style: dict[str, Any] = {"cmap": "viridis", "vmin": low, "vmax": high, "edgecolors": "white", "linewidth": 1}
        on.pcolormesh(np.ma.masked_invalid(strength), **style)
        for (i, j), value in np.ndenumerate(values):
            if np.isfinite(value):
                text = form.format(value).replace("e-0", "e-") + (" ✗" if value > mark_above else "")
                ink = "white" if strength[i, j] < middle else "black"
                on.text(j + 0.5, i + 0.5, text, ha="center", va="center", color=ink, fontsize=8)
        for axis, names in (("x", grid.columns), ("y", grid.index)):
            texts = [f"{name:g}" if isinstance(name, float) else str(name) for name in names]
            turned = 60 if axis == "x" and max(map(len, texts)) * len(texts) > 40 else 0
            getattr(on, f"set_{axis}ticks")(np.arange(len(texts)) + 0.5, texts, rotation=turned)

    return Panel(draw, **axes)


def make_forest(
    names: Sequence[str],
    values: ArrayLike,
    thin: ArrayLike,
    thick: ArrayLike | None = None,
    band: tuple[float, float] | None = None,
    **axes: Any,
) -> Panel:
    """Make a panel of values (n,), a line a name, with bars of half lengths (n,) or (2, n): left, right; and a band."""
    rows = np.arange(len(names))

    def draw(on: Axes) -> None:
        on.errorbar(values, rows, xerr=thin, fmt="none", ecolor=DARK, elinewidth=0.8, capsize=2)
        on.errorbar(values, rows, xerr=thick, fmt="o", color=BLUE, elinewidth=3, markersize=4)
        if band:
            on.axvspan(*band, color=BLUE, alpha=0.2, linewidth=0)
        on.margins(x=0.08)

    return Panel(draw, rows=list(names), **axes)


def make_histogram(counts: ArrayLike, expected: float, band: tuple[float, float], **axes: Any) -> Panel:
    """Make a panel of counts in equal bins of [0, 1], with the expected count and its band."""
    heights = np.asarray(counts, dtype=float)

    def draw(on: Axes) -> None:
        on.axhspan(*band, color=TEAL, alpha=0.2, linewidth=0)
        on.axhline(expected, color=TEAL, linewidth=0.8)
        on.stairs(heights, np.linspace(0, 1, heights.size + 1), color=DARK)
        on.set_ylim(0, None)
        on.set_xlim(0, 1)

    return Panel(draw, **{"ticks": [0, 0.5, 1]} | axes)


def make_distribution(samples: ArrayLike, marked: float, **axes: Any) -> Panel:
    """Make a histogram of values, with one value marked by a red line."""

    def draw(on: Axes) -> None:
        on.hist(np.asarray(samples, dtype=float), bins=20, color=TEAL, alpha=0.6)
        on.axvline(marked, color=RED, linewidth=2)
        on.locator_params(axis="x", nbins=4)
        on.set_yticks([])

    return Panel(draw, **axes)
