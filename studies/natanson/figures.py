"""The papers' figures, and the picture of the result. SVG bytes do not depend on the day or the run."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from simulator.scenario import Scenario
from simulator.simulate import motion
from simulator.truth.motion import Motion

STYLE: dict[Any, Any] = {
    "svg.hashsalt": "gyrocal",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.9",
    "axes.axisbelow": True,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
}
COLOURS = {"x": "#d1495b", "y": "#00798c", "z": "#30343f"}
LINES = {"x": "-.", "y": "--", "z": "-"}  # N draws the pitch rate dashed


def save(figure: Figure, path: Path) -> Path:
    """Write SVG (and PNG for a .png path) with stable bytes."""
    metadata = {"Date": None} if path.suffix == ".svg" else {}
    with mpl.rc_context(STYLE):
        figure.savefig(path, dpi=160, metadata=metadata)
    return path


def _body_rates(axes: Axes, scenario: Scenario, truth: Motion, k: int, which: str) -> None:
    part = truth.intervals[k]
    interval = scenario.interval[k]
    minutes = (truth.t_s[part] - interval.start_s) / 60
    for axis in which:
        rate = np.rad2deg(truth.rates[part, "xyz".index(axis)])
        axes.plot(minutes, rate, LINES[axis], color=COLOURS[axis], label=f"ω$_{axis}$")
    start = pd.Timestamp(scenario.epoch) + pd.Timedelta(seconds=interval.start_s)
    axes.set_title(f"{interval.name}: {interval.activity}, from {start:%Y-%m-%d %H:%M} UTC", loc="left", fontsize=9)
    axes.set_ylabel("body rate (deg/s)")
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=len(which), borderaxespad=0.2)
    axes.margins(x=0)


def natanson_figures(scenario: Scenario, folder: Path) -> list[Path]:
    """N Figures 1–3: body rates through both yaw maneuvers, in -y forward, and in inertial hold."""
    truth = motion(scenario)
    layouts = {
        "figure1_yaw_maneuvers": [(1, "xyz"), (5, "xyz")],
        "figure2_minus_y_forward": [(3, "xyz")],
        "figure3_inertial_hold": [(4, "xy")],  # z stays within the line's width of zero, as N says
    }
    paths = []
    for name, panels in layouts.items():
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(7.0, 2.7 * len(panels)), layout="constrained")
            for position, (k, which) in enumerate(panels):
                axes = figure.add_subplot(len(panels), 1, position + 1)
                _body_rates(axes, scenario, truth, k, which)
            figure.axes[-1].set_xlabel("minutes from the interval's start")
            paths.append(save(figure, folder / f"{name}.svg"))
    return paths


def flight_gap_figure(comparison: pd.DataFrame, distribution: pd.DataFrame, path: Path) -> Path:
    """Flown and predicted pre-launch residuals of every interval and axis, with the Monte Carlo's 5–95 % range.

    Parameters
    ----------
    comparison : the 18 numbers, as made by `studies.natanson.flight_gap.comparison`
    distribution : rows of Table 2, pre-launch at 0.5 s, in the same order
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 3.2), layout="constrained")
        panels = figure.subplots(1, 3, sharey=True)
        for axes, (name, rows) in zip(panels, comparison.groupby("axis", sort=False), strict=True):
            x = rows["interval"].to_numpy()
            spread = distribution.loc[rows.index]
            axes.vlines(x, spread["p05"], spread["p95"], color="#00798c", linewidth=7, alpha=0.3, label="simulated, 5–95 %")
            axes.plot(x, rows["predicted_deg"], "_", color="#00798c", markersize=13, markeredgewidth=2, label="predicted")
            axes.plot(x, rows["flight_deg"], "o", color="#d1495b", markersize=5, label="TRMM flight")
            axes.axhline(0, color="0.4", linewidth=0.8)
            axes.set_title(str(name), loc="left")
            axes.set_xticks(x)
            axes.set_xlim(0.5, len(x) + 0.5)
            axes.set_xlabel("calibration interval")
        panels[0].set_ylabel("residual before calibration (deg)")
        panels[-1].legend(loc="lower right", fontsize=8)
        return save(figure, path)


def error_figure(errors: np.ndarray, sigmas: np.ndarray, names: list[str], path: Path) -> Path:
    """Recovered minus injected over formal sigma, a strip a parameter, with the 1-sigma spread it should have."""
    normalised = errors / sigmas
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 3.0), layout="constrained")
        axes = figure.add_subplot()
        rng = np.random.default_rng(0)  # horizontal jitter only
        for j, column in enumerate(normalised.T):
            axes.plot(j + rng.uniform(-0.25, 0.25, len(column)), column, ".", color="0.55", markersize=2, rasterized=True)
            half = np.std(column, ddof=1)
            axes.errorbar(j, column.mean(), yerr=half, color="#d1495b", fmt="o", markersize=4, capsize=5, linewidth=1.6)
        for level in (-1, 1):
            axes.axhline(level, color="#00798c", linestyle="--", linewidth=1)
        axes.set_xticks(range(len(names)), names)
        axes.set_ylabel("error / formal sigma")
        axes.set_title("grey: cases; red: their mean and spread; dashed: the spread claimed", loc="left", fontsize=9)
        return save(figure, path)


def psi_figure(table: pd.DataFrame, limit: float, path: Path) -> Path:
    """Largest difference in G between linear and full ψ after one iteration, over slew rate and step."""
    grid = table.pivot_table(index="slew_rate_deg_s", columns="step_s", values="G_difference")
    with mpl.rc_context(STYLE | {"axes.grid": False}):
        figure = Figure(figsize=(6.0, 3.6), layout="constrained")
        axes = figure.add_subplot()
        image = axes.pcolormesh(np.log10(grid.to_numpy()), cmap="viridis", edgecolors="white", linewidth=1)
        for i, row in enumerate(grid.to_numpy()):
            for j, value in enumerate(row):
                good = value < limit
                text = f"{value:.0e}".replace("e-0", "e-") + ("" if good else " ✗")
                bright = np.log10(value) < np.log10(grid.to_numpy()).mean()
                axes.text(j + 0.5, i + 0.5, text, ha="center", va="center", color="white" if bright else "black", fontsize=8)
        axes.set_xticks(np.arange(len(grid.columns)) + 0.5, [f"{step:g}" for step in grid.columns])
        axes.set_yticks(np.arange(len(grid.index)) + 0.5, [f"{rate:g}" for rate in grid.index])
        axes.set_xlabel("step Δt (s)")
        axes.set_ylabel("slew rate (deg/s)")
        axes.set_title(f"|G(linear ψ) − G(full ψ)|, one iteration; ✗ above {limit:.0e}", loc="left", fontsize=9)
        figure.colorbar(image, ax=axes, label="log$_{10}$ difference")
        return save(figure, path)
