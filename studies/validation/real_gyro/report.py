"""The report of the study of a real gyro: checks, tables and figures."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from studies.report.checks import Check, at_least, at_most, extremes
from studies.report.entry import Entry, Report
from studies.report.panels import COLOURS, DARK, RED, TEAL, Draw, Line, Panel, curves, sheet
from studies.report.tables import Table
from studies.validation.broad import ATTRIBUTION
from studies.validation.real_gyro.left_out import SURE
from studies.validation.real_gyro.study import STUDY
from studies.validation.real_gyro.tables import EVERY, LAST, MEASURES, RUNGS, cell, delays, ladder, of_kind, steps, wide
from studies.validation.real_gyro.trials import RealConfig
from studies.validation.real_gyro.turns import remaining

UNIT_COLOURS = (RED, TEAL, DARK, "#edae49", "#66a182")

WORDS = {"end": "error at an interval's end", "series": "error over its series"}
HELD = (
    "Errors are RMS of attitudes predicted on trials that had no part in the fit, at an interval's end and over its series; "
    "the floor is what the same procedure leaves on simulated trials of the same motion."
)
LATE = "Late tags and a lag are the same to first order; together they must be sure, also where the verdict is unknown."
CUT = "While the rate sweeps through zero, the bin of zero holds twice what its neighbours do if readings are cut, not rounded."
LEFT = "Turns over 0.05 to 4 s: a third of the mean square would be along the turn if what remains had no preference."


def report(rows: pd.DataFrame) -> Report:
    """Checks, tables and figures."""
    table, left = ladder(rows), remaining(rows)
    found = of_kind(rows, "diagnosis").drop(columns=["case", "kind", "error"], errors="ignore")
    trials = of_kind(rows, "trial")
    shown = ["unit", "trial", "zero_over_neighbours", "repeats_in_motion", "repeats_at_rest"]
    tables = {
        "ladder": Table("Held-out error, RMS per rung, deg: at the end / over the series", table, shown=wide(table)),
        "steps": Table("What each step does to the RMS over the series", steps(rows), "With 90 % intervals."),
        "diagnoses": Table("Diagnosis of each trial", found.sort_values(["turn", "unit", "trial"])),
        "delays": Table("Delay of each trial by itself and on the others of its unit", delays(rows)),
        "samples": Table("Samples", trials.reindex(columns=shown)),
        "tried": Table(
            "Further effects beside the last rung",
            of_kind(rows, "tried")[["unit", "name", "before", "after", "closed"]],
            "Whitened mean square of the attitudes on whole trials held out (of one trial, motions); one is M0's own.",
        ),
        "remaining": Table("What remains of the turns", left),
    }
    figures = {"ladder": _ladder_figure(table), "series": _series_figure(rows), "delays": _delays_figure(delays(rows))}
    return Report(tables, figures, tuple(_checks(rows, table, left)), (ATTRIBUTION,))


def _report(config: RealConfig, rows: pd.DataFrame) -> Report:
    return report(rows)


ENTRY = Entry(STUDY, "what M0 lacks on recorded gyros, and how far held-out prediction improves (BROAD)", _report)


def _checks(rows: pd.DataFrame, table: pd.DataFrame, left: pd.DataFrame) -> list[Check]:
    out = []
    for measure in MEASURES:
        words = WORDS[measure]
        out += [Check(f"{words}, {rung}", cell(table, EVERY, measure, rung, "rms_deg"), None, "deg", HELD) for rung in RUNGS]
        out.append(Check(f"{words}, floor", cell(table, EVERY, measure, LAST, "floor_deg"), None, "deg"))
        out.append(Check(f"{words}, share of the gap closed", cell(table, EVERY, measure, LAST, "closed"), at_least(0.8)))
    found, trials = of_kind(rows, "diagnosis"), of_kind(rows, "trial")
    for turn, part in found.groupby("turn"):
        words = ", ".join(f"{verdict} {count}" for verdict, count in part["verdict"].value_counts().items())
        out.append(Check(f"verdicts of {len(part)} trials, {turn}", words))
    first = found[found["turn"] == "as recorded"]
    late = int((first["late_probability"] >= SURE).sum())
    out.append(Check("trials with a gyro that is surely late", late, (len(first), len(first)), "", LATE))
    undone = found.loc[found["turn"] != "as recorded", "late_probability"]
    out.append(Check("probability of that with the delay undone, largest", float(undone.max()), at_most(0.5)))
    for unit, part in delays(rows).groupby("unit"):
        out.append(Check(f"delay of unit {unit}", float(part["delay_ms"].mean()), None, "ms"))
        if len(part) > 1:
            out.append(Check(f"its spread over {len(part)} trials of {unit}", float(np.ptp(part["delay_ms"])), None, "ms"))
    if "zero_over_neighbours" in trials:
        out += extremes("zero bin over its neighbours", trials["zero_over_neighbours"], at_least(1.5), meaning=CUT)
    last = table[(table["rung"] == LAST) & (table["measure"] == "series") & (table["trial"] != EVERY)]
    out += extremes("series over the floor, by trial", last["rms_deg"] / last["floor_deg"])
    out += extremes("white error that remains, by trial", left["white_deg"], unit="deg", meaning=LEFT)
    out += extremes("random walk over that at rest", left["walk_deg_per_sqrt_s"] / left["stated_arw_deg_per_sqrt_s"])
    if len(left) > 2:
        together = float(np.corrcoef(left["rate_deg_s"], left["walk_deg_per_sqrt_s"])[0, 1])
        out.append(Check("correlation of that walk with the rate", together))
    out += extremes("faster over slower half of the turns", left["faster_over_slower"])
    return [*out, *extremes("share along the turn", left["share_along_turn"])]


def _ladder_figure(table: pd.DataFrame) -> Draw:
    """Held-out error of each trial, rung by rung, over its floor."""
    shown = table[table["measure"] == "series"]
    names = [f"{u} {t}" if t != EVERY else t for u, t in shown[["unit", "trial"]].drop_duplicates().itertuples(index=False)]

    def draw(on: Axes) -> None:
        for k, rung in enumerate(RUNGS):
            part = shown[shown["rung"] == rung]
            rms = part["rms_deg"].to_numpy(float)
            spread = np.clip([rms - part["low_deg"], part["high_deg"] - rms], 0, None)
            x = np.arange(len(names)) + 0.2 * (k - 1.5)
            on.bar(x, rms, 0.18, yerr=spread, color=UNIT_COLOURS[k], label=rung, error_kw={"lw": 0.8})
        floor = shown.loc[shown["rung"] == LAST, "floor_deg"]
        on.hlines(floor, np.arange(len(names)) - 0.4, np.arange(len(names)) + 0.4, color="0.2", lw=1.5, label="floor")
        on.set_xticks(range(len(names)), names)
        on.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        on.yaxis.set_major_formatter("{x:g}")
        on.yaxis.set_minor_formatter(NullFormatter())

    return sheet(Panel(draw, y="held-out error, RMS (deg)", log="y", legend="upper right"), size=(9.0, 3.4))


def _series_figure(rows: pd.DataFrame) -> Draw:
    """The trial with the largest error before."""
    held, series = of_kind(rows, "held"), of_kind(rows, "series")
    number = held[held["name"] == RUNGS[0]].groupby("trial")["series_deg2"].mean().idxmax()
    panels = []
    for rung, words in ((RUNGS[0], "M0"), (LAST, "all that was found undone")):
        chosen = series[(series["trial"] == number) & (series["name"] == rung)]
        lines = [
            Line(part["t_s"], part[axis], axis if k == 0 else "", COLOURS[axis], "-")
            for k, (_, part) in enumerate(chosen.groupby("interval", sort=False))
            for axis in "xyz"
        ]
        title = f"trial {number}, predicted from the other trials: {words}"
        panels.append(curves(lines, title=title, x="time (s)", y="error (deg)", legend="upper right"))
    return sheet(*panels, size=(9.0, 3.8), columns=1, sharex=True)


def _delays_figure(table: pd.DataFrame) -> Draw:
    """Delay of each trial by itself and by the others of its unit."""
    names = [f"{row['unit']} {row['trial']}" for row in table.to_dict("records")]
    own, sigma = table["delay_ms"], table["formal_sigma_ms"]
    x = np.arange(len(names))
    lines = [
        Line(x, own, "own, ± 2 formal sigma", RED, "o", own - 2 * sigma, own + 2 * sigma, bars=True),
        Line(x, table["on_others_ms"], "fitted on the others", DARK, "_"),
    ]
    panel = curves(lines, y="time offset (ms)", legend="best")

    def draw(on: Axes) -> None:
        panel.draw(on)
        on.set_xticks(x, names, fontsize=8)

    return sheet(Panel(draw, y=panel.y, legend=panel.legend), size=(5.0, 3.0))
