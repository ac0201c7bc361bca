"""The paper's figures, and those of its tables beside the flight."""

from typing import Any

import numpy as np
import pandas as pd

from simulator.scenario import Scenario
from simulator.simulate import motion
from studies.report import panels
from studies.report.panels import AXIS_COLOURS, AXIS_LINE_STYLES, Draw, Line, Panel

# N Figures 1 to 3: intervals, and which axes. In inertial hold z stays within the line's width of zero, as N says.
FIGURE_LAYOUTS = {
    "figure1_yaw_maneuvers": [(1, "xyz"), (5, "xyz")],
    "figure2_minus_y_forward": [(3, "xyz")],
    "figure3_inertial_hold": [(4, "xy")],
}


def draw_natanson_figures(scenario: Scenario) -> dict[str, Draw]:
    """N Figures 1–3: body rates through both yaw maneuvers, in -y forward, and in inertial hold."""
    truth = motion(scenario)

    def body_rates(k: int, which: str) -> Panel:
        part, interval = truth.intervals[k], scenario.interval[k]
        minutes, rates = (truth.t_s[part] - interval.start_s) / 60, np.rad2deg(truth.rates[part])
        start = pd.Timestamp(scenario.epoch) + pd.Timedelta(seconds=interval.start_s)
        lines = [
            Line(minutes, rates[:, "xyz".index(axis)], f"ω$_{axis}$", AXIS_COLOURS[axis], AXIS_LINE_STYLES[axis])
            for axis in which
        ]
        title = f"{interval.name}: {interval.activity}, from {start:%Y-%m-%d %H:%M} UTC"
        axes: dict[str, Any] = {"x": "minutes from the interval's start", "y": "body rate (deg/s)", "legend": "best"}
        return panels.make_curves(lines, title=title, **axes)

    panels_of = {name: [body_rates(k, which) for k, which in parts] for name, parts in FIGURE_LAYOUTS.items()}
    return {name: panels.build_sheet(*own, size=(7.0, 2.7 * len(own)), columns=1) for name, own in panels_of.items()}


def draw_flight_gap_figure(comparison: pd.DataFrame, distribution: pd.DataFrame) -> Draw:
    """Flown and predicted residuals of every interval and axis, with the Monte Carlo's 5–95 % range; below, the clean gap.

    Parameters
    ----------
    comparison : the 18 numbers, as made by `studies.natanson.flight_gap.build_gap_comparison`, and the clean gap with fitted
    timings
    distribution : rows of Table 2, pre-launch at 0.5 s, in the same order
    """
    drawn: list[Panel] = []
    below: list[Panel] = []
    for name, rows in comparison.groupby("axis", sort=False):
        x, spread = rows["interval"].to_numpy(), distribution.loc[rows.index]
        lines = [
            Line(x, rows["predicted_deg"], "predicted, simulated 5–95 %", panels.TEAL, "_", spread["p05"], spread["p95"], True),
            Line(x, rows["flight_deg"], "TRMM flight", panels.RED, "o"),
        ]
        axes: dict[str, Any] = {
            "x": "calibration interval",
            "y": "" if drawn else "residual before calibration (deg)",
            "ticks": x,
            "levels": [0],
        }
        drawn.append(panels.make_curves(lines, title=str(name), legend="" if drawn else "best", **axes))
        gaps = [
            Line(x, rows[f"clean_gap{column}_deg"], label, colour, mark)
            for column, label, colour, mark in (
                ("", "timings assumed", panels.TEAL, "_"),
                ("_common", "four common fitted", panels.DARK, "+"),
                ("_each", "nine fitted", panels.RED, "x"),
            )
        ]
        legend = "" if below else "best"
        below.append(panels.make_curves(gaps, title="", legend=legend, **(axes | {"y": "" if below else "clean gap (deg)"})))
    return panels.build_sheet(*drawn, *below, size=(8.0, 6.0), columns=3, sharey="row")


def draw_error_figure(errors: np.ndarray, sigmas: np.ndarray, names: list[str]) -> Draw:
    """Recovered minus injected over formal sigma, a strip a parameter, with the 1-sigma spread it should have."""
    normalised = errors / sigmas
    samples = {name: normalised[:, k] for k, name in enumerate(names)}
    title = "a stroke a case; dark: their mean and spread; red: the spread claimed"
    panel = panels.make_strokes(samples, (-1.0, 1.0), spreads=True, title=title, x="error / formal sigma")
    return panels.build_sheet(panel, size=(8.0, 3.6))
