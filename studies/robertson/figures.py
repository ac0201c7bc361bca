"""R Figures 7 to 13 from the runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from simulator.mission_mode.config import DAY, MissionConfig
from simulator.mission_mode.flight import flight_schedule
from studies.report.panels import STYLE, save
from studies.robertson import flown
from studies.robertson.performance import AXES, GYRO_AXES, full
from studies.robertson.runs import FIRST_DAYS, Runs, day_of
from studies.robertson.words import signed

RED, BLUE, DARK, YELLOW = "#d1495b", "#00798c", "#30343f", "#f2c14e"
FORWARD = {"+x": RED, "-x": BLUE}
SHOWN_ORBITS = 4.0  # of the yaw runs, the last ones
MONTHS = ("1997-12-01", "1998-01-01", "1998-02-01", "1998-03-01", "1998-04-01", "1998-05-01")


def yaw_figure(runs: Runs, path: Path) -> Path:
    """Figures 7 and 12: on-board and true yaw through several yaw updates, before any calibration and after all."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 5.0), layout="constrained")
        panels = figure.subplots(2, 1, sharex=True, sharey=True)
        titles = {"precalibration": "before (R Figure 7)", "postcalibration": "after (R Figure 12)"}
        for axes, (period, title) in zip(panels, titles.items(), strict=True):
            run = runs["yaw", period]
            rows, start = last_orbits(run.telemetry)
            minutes = (rows["t_s"] - start) / 60
            axes.plot(minutes, rows["error_yaw_deg"], color=RED, label="true", rasterized=True)
            axes.plot(minutes, rows["estimate_yaw_deg"], color=BLUE, linewidth=1, label="on board", rasterized=True)
            for t in run.updates["t_s"].to_numpy(dtype=float):
                if t > start:
                    axes.axvline((t - start) / 60, color="0.5", linestyle=":", linewidth=0.8)
            axes.set_title(f"{title}; dotted: yaw updates", loc="left", fontsize=9)
            axes.set_ylabel("yaw (deg)")
            axes.set_xlim(0, minutes.iloc[-1])
        _legend_above(panels[0], 2)
        panels[1].set_xlabel("minutes")
        return save(figure, path)


def last_orbits(telemetry: pd.DataFrame, orbits: float = SHOWN_ORBITS) -> tuple[pd.DataFrame, float]:
    """Telemetry of so many orbits at the end, and when they start, s."""
    start = float(telemetry["t_s"].iloc[-1]) - orbits * MissionConfig().orbit.period
    return telemetry[telemetry["t_s"] >= start], start


def spike_figure(runs: Runs, path: Path) -> Path:
    """Figure 8: position error while the Sun passes a quadrant of the Earth sensor, S filter restarted wrongly and off."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 5.0), layout="constrained")
        panels = figure.subplots(2, 1, sharex=True, sharey=True)
        titles = {"restarted": "S filter restarted from a wrong value", "off": "S filter off"}
        words = "three quadrants, the Sun in the fourth"
        for axes, (state, title) in zip(panels, titles.items(), strict=True):
            rows = runs["spikes", state].telemetry
            minutes = rows["t_s"] / 60
            axes.plot(minutes, rows["estimate_pitch_deg"], color=BLUE, linewidth=0.8, label="pitch, on board", rasterized=True)
            axes.plot(minutes, rows["error_pitch_deg"], color=RED, label="pitch, true", rasterized=True)
            three = (rows["quadrants"] < 4).to_numpy()
            heights = axes.get_xaxis_transform()
            axes.fill_between(minutes, 0, 1, where=three, transform=heights, color=YELLOW, alpha=0.5, linewidth=0, label=words)
            axes.set_title(title, loc="left", fontsize=9)
            axes.set_ylabel("position error (deg)")
            axes.set_xlim(0, minutes.iloc[-1])
        _legend_above(panels[0], 3)
        panels[1].set_xlabel("minutes")
        return save(figure, path)


def attitude_figure(runs: Runs, path: Path) -> Path:
    """Figure 13: attitude over an orbit after all calibrations."""
    rows, start = last_orbits(runs["yaw", "postcalibration"].telemetry, 1.0)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 4.6), layout="constrained")
        panels = figure.subplots(3, 1, sharex=True, sharey=True)
        for axes, name in zip(panels, AXES, strict=True):
            minutes = (rows["t_s"] - start) / 60
            axes.plot(minutes, rows[f"estimate_{name}_deg"], color=BLUE, linewidth=0.8, label="on board", rasterized=True)
            axes.plot(minutes, rows[f"error_{name}_deg"], color=RED, label="true", rasterized=True)
            axes.set_ylabel(f"{name} (deg)")
            axes.set_xlim(0, minutes.iloc[-1])
        _legend_above(panels[0], 2)
        panels[0].set_title("attitude against the commanded one, one orbit", loc="left", fontsize=9)
        panels[-1].set_xlabel("minutes")
        return save(figure, path)


def accuracy_figure(daily: pd.DataFrame, days: float, path: Path) -> Path:
    """Figure 9: RMS of the on-board attitude's error, daily means, with the requirement's 1-sigma and R Table 3."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 5.4), layout="constrained")
        panels = figure.subplots(3, 1, sharex=True)
        for axes, name in zip(panels, AXES, strict=True):
            values = daily[f"rms_knowledge_{name}_deg"]
            axes.plot(daily["day"], values, ".-", color=DARK, markersize=4, linewidth=0.8, label="simulated")
            flight_means(axes, "attitude_accuracy_deg", name)
            axes.axhline(flown.requirement("knowledge") / 3, color=RED, linestyle="--", linewidth=1, label="requirement, 1σ")
            axes.set_ylabel(f"{name}, RMS (deg)")
            axes.set_ylim(0, None)
            calendar(axes, days)
        panels[0].set_title(CALENDAR_WORDS, loc="left", fontsize=9)
        _legend_above(panels[0], 3)
        return save(figure, path)


def update_figure(updates: pd.DataFrame, days: float, path: Path) -> Path:
    """Figure 10: size of every yaw update, with R Table 3's means."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 3.4), layout="constrained")
        axes = figure.subplots()
        for forward, colour in FORWARD.items():
            rows = updates[updates["forward"] == forward]
            axes.plot(
                rows["t_s"] / DAY,
                rows["update_deg"].abs(),
                ".",
                color=colour,
                markersize=3,
                label=f"{signed(forward)} forward",
                rasterized=True,
            )
        flight_means(axes, "yaw_update_deg", "yaw")
        axes.set_ylabel("size of yaw update (deg)")
        axes.set_ylim(0, None)
        _legend_above(axes, 3, markerscale=3)
        axes.set_title(CALENDAR_WORDS, loc="left", fontsize=9)
        calendar(axes, days)
        return save(figure, path)


def bias_figure(daily: pd.DataFrame, days: float, path: Path) -> Path:
    """Figure 11: gyro bias as an attitude solution finds it, daily means."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 5.4), layout="constrained")
        panels = figure.subplots(3, 1, sharex=True)
        for axes, (axis, name) in zip(panels, GYRO_AXES.items(), strict=True):
            for forward, colour in FORWARD.items():
                rows = daily[daily["forward"] == forward]
                values = rows[f"apparent_bias_{name}_deg_h"]
                axes.plot(rows["day"], values, ".", color=colour, markersize=5, label=f"{signed(forward)} forward")
            axes.set_ylabel(f"bias {axis} (deg/h)")
            calendar(axes, days)
        _legend_above(panels[0], 2)
        panels[0].set_title(CALENDAR_WORDS, loc="left", fontsize=9)
        return save(figure, path)


CALENDAR_WORDS = "dotted: yaw maneuvers; solid: uploads"


def flight_means(axes: Axes, parameter: str, axis: str) -> None:
    """R Table 3's mean of each period, across the period."""
    config = MissionConfig()
    for k, (period, moments) in enumerate(FIRST_DAYS.items()):
        start, stop = (day_of(moment, config) for moment in moments)
        mean, label = flown.performance(parameter, axis, period), "_" if k else "R Table 3"  # one entry in the legend
        axes.hlines(mean, start, stop, color=YELLOW, linewidth=2, zorder=3, label=label)


def _legend_above(axes: Axes, columns: int, **options: float) -> None:
    """Right of the title, clear of what is drawn."""
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=columns, fontsize=8, borderaxespad=0.2, **options)


def calendar(axes: Axes, days: float) -> None:
    """Yaw maneuvers and uploads as vertical lines, and the months along the axis."""
    schedule = flight_schedule(MissionConfig(), days)
    for maneuver in schedule.maneuvers:
        axes.axvline(maneuver.start_s / DAY, color="0.5", linestyle=":", linewidth=1)
    for at, _ in schedule.uploads:
        if at < days * DAY:
            axes.axvline(at / DAY, color="0.3", linewidth=1)
    ticks = [day_of(f"{month}T00:00:00+00:00", MissionConfig()) for month in MONTHS]
    axes.set_xticks(ticks, [f"{pd.Timestamp(month):%b 1 %Y}" for month in MONTHS])
    axes.set_xlim(0, days)
    axes.grid(axis="x", visible=False)


def daily_means(orbits: pd.DataFrame, uploads: Sequence[float] = ()) -> pd.DataFrame:
    """Means of an orbit table over each day and orientation, apart before and after each upload (s), in full orbits.

    The column day is the middle of the orbits' times, in days.
    """
    rows = full(orbits)
    numbers = [name for name in rows.columns if name.startswith(("rms_", "apparent_"))]
    tables = pd.Series(np.searchsorted(np.asarray(uploads, dtype=float), rows["t_s"]), index=rows.index, name="tables")
    day = np.floor(rows["t_s"] / DAY).astype(int).rename("of")
    means = rows.groupby([day, tables, "forward"], sort=True)[["t_s", *numbers]].mean().reset_index()
    means.insert(0, "day", means.pop("t_s") / DAY)
    return means.drop(columns=["of", "tables"]).sort_values("day", ignore_index=True)


def draw(runs: Runs, daily: pd.DataFrame, updates: pd.DataFrame, days: float, folder: Path) -> dict[str, str]:
    """All of them into the folder; what each shows, by file name."""
    yaw_figure(runs, folder / "figure7_12_yaw.svg")
    spike_figure(runs, folder / "figure8_spikes.svg")
    accuracy_figure(daily, days, folder / "figure9_accuracy.svg")
    update_figure(updates, days, folder / "figure10_yaw_update.svg")
    bias_figure(daily, days, folder / "figure11_bias.svg")
    attitude_figure(runs, folder / "figure13_attitude.svg")
    return {
        "figure7_12_yaw.svg": "R Figures 7 and 12: yaw on board and true through yaw updates",
        "figure8_spikes.svg": "R Figure 8: position error while the Sun is in a quadrant's view",
        "figure9_accuracy.svg": "R Figure 9: RMS of the on-board attitude's error",
        "figure10_yaw_update.svg": "R Figure 10: size of the yaw updates",
        "figure11_bias.svg": "R Figure 11: gyro bias found at ±1 RPO",
        "figure13_attitude.svg": "R Figure 13: attitude over an orbit after calibration",
    }
