"""Figures of the study of a real gyro."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from studies.report.panels import COLOURS, STYLE, save
from studies.validation.real_gyro.tables import EVERY, LAST, RUNGS, of_kind, records

UNIT_COLOURS = ("#d1495b", "#00798c", "#30343f", "#edae49", "#66a182")


def figure_ladder(table: pd.DataFrame, path: Path) -> Path:
    """Held-out error of each trial, rung by rung, over its floor."""
    shown = table[table["measure"] == "series"]
    trials = shown["trial"].unique()
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(9.0, 3.4), layout="constrained")
        axes = drawing.subplots()
        for k, name in enumerate(RUNGS):
            part = shown[shown["rung"] == name]
            x = np.arange(len(trials)) + 0.2 * (k - 1.5)
            rms = part["rms_deg"].to_numpy(float)
            spread = np.clip([rms - part["low_deg"], part["high_deg"] - rms], 0, None)
            axes.bar(x, rms, 0.18, yerr=spread, color=UNIT_COLOURS[k], label=name, error_kw={"lw": 0.8})
        floor = shown[shown["rung"] == LAST]["floor_deg"].to_numpy(float)
        axes.hlines(floor, np.arange(len(trials)) - 0.4, np.arange(len(trials)) + 0.4, color="0.2", lw=1.5, label="floor")
        units = shown.drop_duplicates("trial")["unit"]
        axes.set_xticks(range(len(trials)), [t if t == EVERY else f"{u} {t}" for u, t in zip(units, trials, strict=True)])
        axes.set_yscale("log")
        axes.set_ylabel("held-out error, RMS (deg)")
        axes.legend(ncols=5, fontsize=8, loc="lower right", bbox_to_anchor=(1, 1))
        return save(drawing, path)


def figure_series(rows: pd.DataFrame, path: Path) -> Path:
    """The trial with the largest error before."""
    held = of_kind(rows, "held")
    number = held[held["name"] == RUNGS[0]].groupby("trial")["series_deg2"].mean().idxmax()
    series = of_kind(rows, "series")
    series = series[series["trial"] == number]
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(9.0, 3.6), layout="constrained")
        panels = drawing.subplots(2, 1, sharex=True)
        for axes, name, words in zip(panels, (RUNGS[0], LAST), ("M0", "all found effects"), strict=True):
            for _, part in series[series["name"] == name].groupby("interval", sort=False):
                for axis in "xyz":
                    axes.plot(part["t_s"], part[f"error_{axis}"], color=COLOURS[axis], lw=1)
            axes.set_ylabel("error (deg)")
            axes.set_title(f"trial {number}, predicted from the other trials: {words}", loc="left", fontsize=9)
        panels[0].legend([f"{axis}" for axis in "xyz"], ncols=3, loc="upper right", fontsize=8)
        panels[1].set_xlabel("time (s)")
        return save(drawing, path)


def figure_zero(rows: pd.DataFrame, path: Path) -> Path:
    """Readings next to zero while the rate sweeps through it."""
    zero = of_kind(rows, "zero")
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(5.0, 3.0), layout="constrained")
        axes = drawing.subplots()
        for k, (unit, part) in enumerate(zero.groupby("unit")):
            total = part.groupby("bin")["count"].sum()
            away = total[total.index != 0].mean()
            axes.bar(total.index + 0.27 * (k - 1), total / away, 0.25, color=UNIT_COLOURS[k], label=f"unit {unit}")
        axes.axhline(1, color="0.3", lw=0.8)
        axes.axhline(2, color="0.3", lw=0.8, ls="--")
        axes.set_xlabel("reading (counts), while the rate sweeps through zero")
        axes.set_ylabel("relative to the other bins")
        axes.legend(fontsize=8)
        return save(drawing, path)


def figure_sizes(table: pd.DataFrame, path: Path) -> Path:
    """Time offset of each trial by itself and by the others of its unit."""
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(5.0, 3.0), layout="constrained")
        axes = drawing.subplots()
        colour = {unit: UNIT_COLOURS[k] for k, unit in enumerate(sorted(table["unit"].unique()))}
        for k, row in enumerate(records(table)):
            axes.errorbar(k, row["offset_ms"], 2 * row["formal_sigma_ms"], fmt="o", color=colour[row["unit"]], ms=4)
            axes.plot(k, row["on_others_ms"], "_", color="0.3", ms=12)
        axes.set_xticks(range(len(table)), [f"{u} {t}" for u, t in zip(table["unit"], table["trial"], strict=True)], fontsize=8)
        axes.set_ylabel("time offset (ms)")
        axes.set_title("own, ± 2 formal sigma; –: fitted on the others", loc="left", fontsize=9)
        return save(drawing, path)
