"""The figures of a diagnosis. Colours and markers are distinct for every kind of colour vision."""

from __future__ import annotations

import textwrap
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from diagnosis.budget import Step
from studies.report import panels, tables
from studies.report.panels import Line

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


BEFORE, AFTER = panels.RED, panels.BLUE
AXIS_MARKERS = {"x": "o", "y": "s", "z": "^"}
AXIS_TITLES = {"x": "x (roll)", "y": "y (pitch)", "z": "z (yaw)"}
FIGURE_WIDTH_IN = 11.0  # inches: the width of the page
MOST_SEPARATE_POINTS = 20  # references of an interval, above which its residuals are a line
MOST_LETTERS = 24  # of a name
SINCE_FIRST = "minutes since the interval's first reference"
MOST_PANELS = 8  # intervals with panels
REACHED = 0.02  # of a cause's largest trace: an axis with less of it shows nothing


def select_largest_intervals(residuals: pd.DataFrame) -> list[str]:
    """Select at most `MOST_PANELS` intervals with the largest residuals under M0; their names in the recording's order."""
    weight = normalise_by_band(residuals).groupby(residuals["interval"], sort=False).max()
    selected = set(weight.nlargest(MOST_PANELS).index)
    return [str(name) for name in weight.index if name in selected]


def is_residual_changed(residuals: pd.DataFrame) -> bool:
    """Check whether the causes change the residuals."""
    return any(not np.allclose(residuals[f"before_{a}"], residuals[f"after_{a}"], rtol=1e-6, atol=1e-12) for a in "xyz")


def normalise_by_band(residuals: pd.DataFrame, when: str = "before") -> pd.Series:
    """Compute the largest residual of each row over its band."""
    bands = residuals[[f"band_{a}" for a in "xyz"]].to_numpy()
    values = np.abs(residuals[[f"{when}_{a}" for a in "xyz"]].to_numpy())
    ratio = np.divide(values, bands, out=np.zeros_like(values), where=bands > 0)
    return pd.Series(ratio.max(axis=1), index=residuals.index)


# ---- residuals -----------------------------------------------------------------------------------------------------------


def draw_interval_residuals(residuals: pd.DataFrame) -> Figure:
    """Draw the residuals by interval and axis, before and after, with the band of M0: two sigma either way."""
    names = select_largest_intervals(residuals)
    panels_ = []
    for name in names:
        part = residuals[residuals["interval"] == name]
        minutes = (part["t_s"] - part["t_s"].iloc[0]).to_numpy() / 60
        for axis in "xyz":
            band, before, after = (part[f"{column}_{axis}"].to_numpy() for column in ("band", "before", "after"))
            style = ("-", "-") if len(part) > MOST_SEPARATE_POINTS else ("o", ".")
            allowed = Line(minutes, 0 * band, "baseline, ±2 sigma", "0.6", "-", -2 * band, 2 * band)
            lines = [allowed, Line(minutes, before, "before: the baseline's own fit", BEFORE, style[0], size=3.2, hollow=True)]
            if is_residual_changed(residuals):
                lines.append(Line(minutes, after, "after: with the causes in the model", AFTER, style[1], size=3.2))
            title = f"{_shorten_name(name)}: {AXIS_TITLES[axis]}"
            y = "residual (deg)" if axis == "x" else ""
            x = SINCE_FIRST if name == names[-1] else ""
            panels_.append(panels.make_curves(lines, title=title, x=x, y=y))
    size = (FIGURE_WIDTH_IN, 1.55 * len(names) + 0.9)
    return panels.draw_panels(*panels_, size=size, columns=3, sharey="col", legend="outside upper center")


def _shorten_name(name: object) -> str:
    """Shorten a name and escape its signs of a formula."""
    return textwrap.shorten(str(name), MOST_LETTERS, placeholder="…").replace("$", r"\$") or str(name)[:MOST_LETTERS]


# ---- causes --------------------------------------------------------------------------------------------------------------


def draw_regressor_figure(regressors: pd.DataFrame, cause: str) -> Figure:
    """Draw the baseline's residuals against the cause's, and both over time where the cause acts most."""
    part = regressors[regressors["cause"] == cause]
    reach = part.groupby("axis")["regressor_deg"].agg(lambda values: values.abs().max())
    part = part[part["axis"].isin(reach[reach >= REACHED * reach.max()].index)]
    points = []
    for name, rows in part.groupby("axis"):
        style = panels.AXIS_COLOURS[str(name)], AXIS_MARKERS[str(name)]
        points.append(Line(rows["regressor_deg"], rows["residual_deg"], f"axis {name}", *style, size=3.2))
    limits = part["regressor_deg"].agg(["min", "max"])
    slope = Line(limits, limits, "slope 1: the size found", "black", "-")
    largest = part.iloc[int(part["regressor_deg"].abs().to_numpy().argmax())]
    shown = part[(part["interval"] == largest["interval"]) & (part["axis"] == largest["axis"])]
    minutes = (shown["t_s"] - shown["t_s"].iloc[0]) / 60
    traces = [
        Line(minutes, shown["residual_deg"], "residual of the baseline", BEFORE, "o", size=3.2, hollow=True),
        Line(minutes, shown["regressor_deg"], "the cause", "black", "-" if len(shown) > 2 else "_"),
    ]
    x, y = "effect of the cause at the size found (deg)", "residual of the baseline (deg)"
    against = panels.make_curves([*points, slope], x=x, y=y, legend="best")
    title = f"where it is largest: {_shorten_name(largest['interval'])}, axis {largest['axis']}"
    over_time = panels.make_curves(traces, x=SINCE_FIRST, y="deg", title=title, legend="best")
    return panels.draw_panels(against, over_time, size=(FIGURE_WIDTH_IN, 3.3), widths=(1, 1.5))


# ---- gap budget ----------------------------------------------------------------------------------------------------------

BUDGET_WIDTH_IN = 8.5
ROW_IN = 0.32
SIGMAS_90 = 1.645  # half the width of a 90 % interval


def name_step(step: Step) -> str:
    """Name a step for a reader."""
    names = {"baseline": "baseline", "remainder": "remainder: not explained", "floor": "floor: stated noise alone"}
    return names.get(step.step, f"with {step.step}")


def draw_waterfall(budget: tuple[Step, ...]) -> Figure:
    """Draw the waterfall, and beside it the sizes of the causes by part of the recording."""
    causes = [step for step in budget if len(step.by_part) > 1]
    rows = max(len(budget), *(len(cause.by_part) + 1 for cause in causes), 4)
    waterfall = panels.Panel(partial(draw_steps, budget=budget), x="held-out whitened mean square")
    size = (BUDGET_WIDTH_IN, ROW_IN * rows + 1.2)
    return panels.draw_panels(waterfall, *map(_make_size_panel, causes), size=size, widths=[2.2, *[1.0] * len(causes)])


def _make_size_panel(step: Step) -> panels.Panel:
    """Make the panel of one cause's sizes by part with 90 % bars, and its size over all parts as a band."""
    sizes, sigmas = (np.array([getattr(part, name) for part in step.by_part]) for name in ("size", "sigma"))
    band = None if step.size is None or step.sigma is None else (step.size - step.sigma, step.size + step.sigma)
    names = [part.part for part in step.by_part]
    return panels.make_forest(names, sizes, SIGMAS_90 * sigmas, band=band, at=[0.0], title=step.step, x=step.unit or "")


def draw_steps(on: Axes, budget: tuple[Step, ...]) -> None:
    """Draw the steps of a budget as a waterfall."""
    explained = [step for step in budget if step.step not in ("remainder", "floor")]
    floor, last = budget[-1].misfit, explained[-1].misfit
    spans = [(floor, explained[0].misfit, panels.RED)]
    spans += [(after.misfit, before.misfit, panels.BLUE) for before, after in pairwise(explained)]
    spans += [(floor, last, panels.ORANGE), (0.0, floor, panels.GREY)]
    for row, (step, (low, high, colour)) in enumerate(zip(budget, spans, strict=True)):
        on.barh(row, high - low, left=low, color=colour, height=0.62)
        text = f"{step.misfit:.3g}"
        if step.step not in ("baseline", "floor"):
            text = tables.format_share(step.closed, step.interval_90)
        on.annotate(text, (max(high, low), row), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8)
    on.set_yticks(range(len(budget)), [name_step(step) for step in budget])
    on.invert_yaxis()
    on.set_xlim(0, 1.28 * max(step.misfit for step in budget))
    on.grid(visible=False)


# ---- raw tables of sun sensors ----------------------------------------------------------------------------------------------

RESIDUAL_COLOURS = {"before_deg": BEFORE, "after_deg": AFTER}
MOST_POINTS = 1500


def draw_sun_residuals(residuals: pd.DataFrame, sensor: str, titles: dict[str, str]) -> Figure:
    """Draw the residuals of α and β of a sun sensor over α and over β; titles are the legends of their columns."""
    of_sensor = residuals[residuals["sensor"] == sensor]
    drawn = []
    for angle in ("alpha", "beta"):
        part = of_sensor[of_sensor["angle"] == angle]
        part = part.iloc[:: max(1, len(part) // MOST_POINTS)]
        for over in ("alpha", "beta"):
            x = part[f"{over}_deg"]
            lines = [Line(x, part[name], title, RESIDUAL_COLOURS[name], ".", size=2.0) for name, title in titles.items()]
            y = f"residual of {angle} (deg)" if over == "alpha" else ""
            drawn.append(panels.make_curves(lines, levels=[0], x=f"Sun's {over} (deg)", y=y))
    title = f"{sensor}, measured minus predicted"
    return panels.draw_panels(*drawn, size=(8.6, 4.6), columns=2, title=title, sharey="all", legend="outside upper right")
