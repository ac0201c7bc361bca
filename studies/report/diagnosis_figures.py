"""The figures of a diagnosis. Colours and markers tell things apart for every kind of colour vision."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import scipy.stats
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from studies.report import panels
from studies.report.diagnosis_words import label
from studies.report.panels import STYLE, Line

Array = NDArray[np.float64]

BEFORE, AFTER, OTHER, FLOOR = panels.RED, panels.BLUE, panels.ORANGE, "0.35"
AXIS_MARKERS = {"x": "o", "y": "s", "z": "^"}
AXIS_TITLES = {"x": "x (roll)", "y": "y (pitch)", "z": "z (yaw)"}
WIDTH = 11.0  # inches: the width of the page
MOST_ROWS = 12  # lines of a figure; of more, the most telling
FEW = 20  # references of an interval, above which its residuals are a line
MOST_PANELS = 8  # intervals with panels of their own
REACHED = 0.02  # of a cause's largest trace: an axis with less of it shows nothing
STRONGEST = 12.0  # −log10 p at which the colours end
DISCOVERY_RATE = 0.05


def most_telling(table: pd.DataFrame, weight: pd.Series, most: int) -> list[str]:
    """Names of intervals in their order; of too many, those with the largest weight."""
    names = list(dict.fromkeys(table["interval"]))
    if len(names) <= most:
        return names
    kept = set(weight.groupby(table["interval"]).max().nlargest(most).index)
    return [name for name in names if name in kept]


def differs(residuals: pd.DataFrame) -> bool:
    """Whether after is another residual than before."""
    return any(not np.allclose(residuals[f"before_{a}"], residuals[f"after_{a}"], rtol=1e-6, atol=1e-12) for a in "xyz")


def in_sigma(residuals: pd.DataFrame, when: str = "before") -> pd.Series:
    """Largest residual of a row over its band."""
    bands = residuals[[f"band_{a}" for a in "xyz"]].to_numpy()
    values = np.abs(residuals[[f"{when}_{a}" for a in "xyz"]].to_numpy())
    ratio = np.divide(values, bands, out=np.zeros_like(values), where=bands > 0)
    return pd.Series(ratio.max(axis=1), index=residuals.index)


# ---- residuals -----------------------------------------------------------------------------------------------------------


def residual_figure(residuals: pd.DataFrame) -> Figure:
    """Residuals by interval and axis, before and after, with the band of M0: two sigma either way."""
    names = most_telling(residuals, in_sigma(residuals), MOST_PANELS)
    drawn = []
    for name in names:
        part = residuals[residuals["interval"] == name]
        minutes = (part["t_s"] - part["t_s"].iloc[0]).to_numpy() / 60
        for axis in "xyz":
            band, before, after = (part[f"{what}_{axis}"].to_numpy() for what in ("band", "before", "after"))
            look = ("-", "-") if len(part) > FEW else ("o", ".")
            allowed = Line(minutes, 0 * band, "what the baseline allows (±2 sigma)", "0.6", "-", -2 * band, 2 * band)
            lines = [allowed, Line(minutes, before, "before: the baseline's own fit", BEFORE, look[0], size=3.2, hollow=True)]
            if differs(residuals):
                lines.append(Line(minutes, after, "after: with the causes in the model", AFTER, look[1], size=3.2))
            title = f"{_short(name)}: {AXIS_TITLES[axis]}"
            y = "residual (deg)" if axis == "x" else ""
            x = "minutes since the interval's first reference" if name == names[-1] else ""
            drawn.append(panels.curves(lines, title=title, x=x, y=y))
    size = (WIDTH, 1.55 * len(names) + 0.9)
    return panels.drawn(*drawn, size=size, columns=3, sharey="col", legend="outside upper center")


def _short(name: object, most: int = 24) -> str:
    """A name that is text and no formula, and not too long."""
    return textwrap.shorten(str(name), most, placeholder="…").replace("$", r"\$") or str(name)[:most]


# ---- map of statistics ---------------------------------------------------------------------------------------------------


def significant(statistics: pd.DataFrame) -> NDArray[np.bool_]:
    """Which tests are significant among all."""
    return np.asarray(scipy.stats.false_discovery_control(statistics["p_value"].to_numpy(dtype=float)) <= DISCOVERY_RATE)


def statistics_figure(statistics: pd.DataFrame) -> Figure:
    """−log10 p by interval, axis and phase; marked where significant among all at a false discovery rate of 5 %."""
    table = statistics.assign(
        interval=statistics["interval"].fillna("all"),
        strength=-np.log10(np.clip(statistics["p_value"], 1e-300, 1.0)),
        marked=significant(statistics),
    )
    kinds = list(dict.fromkeys(table["statistic"]))
    table["column"] = table["phase"] if len(kinds) == 1 else table["statistic"] + " " + table["phase"]
    names = most_telling(table, table["strength"], 2 * MOST_ROWS)
    columns = list(dict.fromkeys(table["column"]))
    order = [phase for phase in ("start", "slew", "hold", "end") if phase in columns]
    columns = order + [column for column in columns if column not in order]
    axes_there = list(dict.fromkeys(table["axis"].fillna("all")))
    with mpl.rc_context(STYLE | {"axes.grid": False}):
        figure = Figure(figsize=(WIDTH, 0.3 * len(names) + 1.3), layout="constrained")
        panels = figure.subplots(1, len(axes_there), sharey=True, squeeze=False)[0]
        for panel, axis in zip(panels, axes_there, strict=True):
            chosen = table[table["axis"].fillna("all") == axis]
            image = _map_panel(panel, chosen, names, columns)
            panel.set_title(f"axis {AXIS_TITLES.get(axis, axis)}", loc="left")
        panels[0].set_yticks(np.arange(len(names)) + 0.5, [_short(name) for name in names])
        panels[0].set_ylim(len(names), 0)
        bar = figure.colorbar(image, ax=list(panels), extend="max", fraction=0.03)
        bar.set_label("−log$_{10}$ p: larger is less\nlike the baseline")
        return figure


def _map_panel(panel: Axes, table: pd.DataFrame, names: Sequence[str], columns: Sequence[str]) -> mpl.collections.QuadMesh:
    def grid(column: str) -> Array:
        wide = table.pivot_table(index="interval", columns="column", values=column, aggfunc="max")
        return wide.reindex(index=list(names), columns=list(columns)).to_numpy(dtype=float)

    strength, marked = grid("strength"), grid("marked")
    panel.set_facecolor("0.8")
    image = panel.pcolormesh(
        np.ma.masked_invalid(strength), cmap="Blues", vmin=0, vmax=STRONGEST, edgecolors="0.9", linewidth=0.8
    )
    for i, j in np.argwhere(marked == 1):
        value = strength[i, j]
        text = f"{value:.0f}*" if value >= 10 else f"{value:.1f}*"
        panel.text(j + 0.5, i + 0.5, text, ha="center", va="center", fontsize=8, color="white" if value > 7 else "black")
    panel.set_xticks(np.arange(len(columns)) + 0.5, columns, rotation=30 if len(columns) > 4 else 0)
    panel.tick_params(length=0)
    return image


# ---- causes --------------------------------------------------------------------------------------------------------------


def regressor_figure(regressors: pd.DataFrame, cause: str) -> Figure:
    """What the baseline leaves against what the cause does, and both over time where it does most."""
    part = regressors[regressors["cause"] == cause]
    reach = part.groupby("axis")["regressor_deg"].agg(lambda values: values.abs().max())
    part = part[part["axis"].isin(reach[reach >= REACHED * reach.max()].index)]
    points = []
    for name, rows in part.groupby("axis"):
        look = panels.COLOURS[str(name)], AXIS_MARKERS[str(name)]
        points.append(Line(rows["regressor_deg"], rows["residual_deg"], f"axis {name}", *look, size=3.2))
    limits = part["regressor_deg"].agg(["min", "max"])
    slope = Line(limits, limits, "slope 1: the size found", "black", "-")
    place = part.iloc[int(part["regressor_deg"].abs().to_numpy().argmax())]
    shown = part[(part["interval"] == place["interval"]) & (part["axis"] == place["axis"])]
    minutes = (shown["t_s"] - shown["t_s"].iloc[0]) / 60
    both = [
        Line(minutes, shown["residual_deg"], "what the baseline leaves", BEFORE, "o", size=3.2, hollow=True),
        Line(minutes, shown["regressor_deg"], "the cause", "black", "-" if len(shown) > 2 else "_"),
    ]
    across = {"x": "what the cause does at the size found (deg)", "y": "what the baseline leaves (deg)"}
    title = f"where it does most: {_short(place['interval'])}, axis {place['axis']}"
    along = {"x": "minutes since the interval's first reference", "y": "deg", "title": title}
    left, right = (
        panels.curves([*points, slope], None, legend="best", **across),
        panels.curves(both, None, legend="best", **along),
    )
    return panels.drawn(left, right, size=(WIDTH, 3.3), widths=(1, 1.5))


def evidence_figure(explanations: pd.DataFrame) -> Figure:
    """Probability and log evidence of the likeliest explanations; hatched: with something unlisted in them."""
    table = explanations.nlargest(MOST_ROWS, "probability", keep="first").iloc[::-1]
    places = np.arange(len(table))
    unlisted = table["unlisted"].to_numpy(dtype=bool)
    colours = [OTHER if one else AFTER for one in unlisted]
    hatches = ["///" if one else "" for one in unlisted]
    names = ["\n".join(textwrap.wrap(" + ".join(_names(text)), 58)) for text in table["effects"]]
    finite = np.isfinite(table["log_evidence"].to_numpy(dtype=float))
    with mpl.rc_context(STYLE | {"hatch.linewidth": 0.6}):
        figure = Figure(figsize=(WIDTH, 0.36 * len(table) + 1.4), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        for axes, column in ((left, "probability"), (right, "log_evidence")):
            values = np.where(np.isfinite(table[column].to_numpy(dtype=float)), table[column], 0.0)
            bars = axes.barh(places, values, color=colours, height=0.7, edgecolor="white", linewidth=0)
            for bar, hatch in zip(bars, hatches, strict=True):
                bar.set_hatch(hatch)
            texts = _percents(values) if column == "probability" else [f"{v:.1f}" for v in values]
            texts = texts if column == "probability" else [t if ok else "–" for t, ok in zip(texts, finite, strict=True)]
            axes.bar_label(bars, texts, padding=3, fontsize=8)
            axes.grid(axis="y", visible=False)
            axes.margins(x=0.12)
        left.set_yticks(places, names)
        left.set_xlim(0, 1.15)
        left.set_xlabel("probability")
        right.set_xlabel("log evidence against the baseline (natural)")
        handles = [Patch(color=AFTER, label="listed effects only")]
        if unlisted.any():
            handles.append(Patch(facecolor=OTHER, hatch="///", edgecolor="white", label="with something not on the list"))
        figure.legend(handles=handles, loc="outside upper right", ncols=2)
        return figure


def _names(text: object) -> list[str]:
    return [label(one) if one else "no effect" for one in str(text).split(" + ")]


def _percents(values: Array) -> list[str]:
    return [">99.9 %" if v > 0.999 else "<0.1 %" if v < 0.001 else f"{100 * v:.1f} %" for v in values]


# ---- closure -------------------------------------------------------------------------------------------------------------


def closure_figure(by_interval: pd.DataFrame, total: tuple[float, float, float], measure: str) -> Figure:
    """Before, after and floor on held-out data, a line an interval, all together last."""
    table = by_interval[["interval", "before", "after", "floor"]]
    shown = table[table["interval"].isin(most_telling(table, table["before"], 2 * MOST_ROWS))]
    values = np.vstack([shown[["before", "after", "floor"]].to_numpy(dtype=float), total])
    rows, (before, after, floor) = np.arange(len(values)), values.T
    lines = [
        Line(floor, rows, "floor: the baseline's own data", FLOOR, "|", size=14.0),
        Line(before, rows, "before", BEFORE, "o", size=7.0, hollow=True),
        Line(after, rows, "after: causes in the model", AFTER, "o", size=6.0),
    ]
    found = values[np.isfinite(values)]
    wide = found.size > 0 and found.min() > 0 and found.max() > 20 * found.min()
    names = [*(_short(name) for name in shown["interval"]), "all"]
    axes: dict[str, Any] = {"log": "x" if wide else "", "rows": names, "levels": [len(names) - 1.5], "x": measure}
    return panels.drawn(panels.curves(lines, **axes), size=(WIDTH, 0.3 * len(rows) + 1.2), legend="outside upper center")
