"""What ``gyrocal trend`` shows of a unit: which parameters have changed, when and by how much, as tables and as a page."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import groupby

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console

from gyrocal.calibration.parameter_change import ParameterChange
from gyrocal.calibration.remainder_processes import WITH_REMAINDER
from studies.compare.trend import FALSE_ALARM_PROBABILITY, SAME_TEMPERATURE_K, SCALED, ParameterTrend, Trend
from studies.report import tables
from studies.report.pages import Answer, Item, Page, PageTable, Picture, ProvenanceFooter, Section
from studies.report.panels import BLUE, DARK, GREY, ORANGE, RED, TEAL, Line, Panel, draw_panels, make_curves

Array = NDArray[np.float64]

TREND_WIDTH_IN, ROW_HEIGHT_IN = 11.0, 1.9  # inches: the width of the page, and of a gyro
LINE_COLOURS = (RED, BLUE, TEAL, ORANGE, DARK)  # of the curves that have a name
TREND_NOTE = (
    "log10 E: largest evidence for a change in any recording so far; alarm: the recording at which it reaches its threshold; "
    "change before: the first recording after the change, with the 90 % range; step: its size"
)


def show(console: Console, trend: Trend) -> None:
    """Print all of it but the single values."""
    for line in describe_trend(trend):
        console.print(line, highlight=False, markup=False, emoji=False)
    tables.print_table(console, "Recordings", build_recording_table(trend))
    tables.print_table(console, "Parameters", build_change_table(trend), TREND_NOTE)


def describe_trend(trend: Trend) -> list[str]:
    """The result in sentences, the answer first."""
    names, lines = trend.recordings["recording"], [format_trend_headline(trend) + "."]
    for one, change, alarm in trend.changes:
        step = f"{_format_step(change.step, change.step_sigma)} {one.unit}"
        lines.append(f"{one.name}: changes by {step} before {_format_date(trend, one, change)}; alarm at {names[alarm]}.")
    lines.append(
        f"A parameter has changed where E is {np.exp(trend.log_threshold):.0f} or more. A unit without a change raises an "
        f"alarm with a probability of {FALSE_ALARM_PROBABILITY:g} at most, however many recordings are added."
    )
    for kind, text in (
        (WITH_REMAINDER.replace("_", " "), "the sigmas include the remainder, since the residuals do not fit the stated noise"),
        (SCALED, "the sigmas are scaled to the residuals, which do not fit the stated noise"),
    ):
        count = int((trend.recordings["sigmas"] == kind).sum())
        if count:
            lines.append(f"In {count} of {len(names)} recordings {text}.")
    if not trend.is_timed:
        lines.append(
            "The recordings overlap in time: they count one by one, in the order of their epochs, equal ones as given."
        )
    temperature = trend.recordings["temperature_c"]
    if temperature.isna().any() and not temperature.isna().all():
        lines.append("Not all recordings have a temperature: no parameter is corrected for it.")
    if trend.changes:
        lines.append("To test the time after a change, give the recordings after it alone.")
    return lines


def format_trend_headline(trend: Trend) -> str:
    """The answer in a sentence."""
    count, of = len(trend.changes), len(trend.parameters)
    if not count:
        return f"None of {of} parameters is known to have changed over {len(trend.days)} recordings"
    return f"{count} of {of} parameters {'has' if count == 1 else 'have'} changed over {len(trend.days)} recordings"


def build_recording_table(trend: Trend) -> pd.DataFrame:
    """A row for each recording: time, temperature, and how well its residuals fit."""
    table = trend.recordings.assign(p_value=[f"{p:.2g}" for p in trend.recordings["p_value"]])
    table = table.assign(temperature_c=[_format_temperature(value) for value in table["temperature_c"]])
    table = table.rename(columns={"temperature_c": "temperature (°C)", "time": "middle (UTC)", "p_value": "p of residuals"})
    return table.drop(columns=["chi2", "dof"])


def build_change_table(trend: Trend) -> pd.DataFrame:
    """A row for each parameter: the last value, the evidence for a change, and the change."""
    changes = {one.name: (change, alarm) for one, change, alarm in trend.changes}
    rows = []
    for one in trend.parameters:
        row: dict[str, object] = {
            "gyro": one.gyro,
            "parameter": one.parameter,
            "unit": one.unit,
            "last": "not determined",
            "sigma": "",
        }
        if one.places.size:
            value, sigma = one.value[one.places[-1]], one.sigma[one.places[-1]]
            row |= {"last": tables.format_to_sigma(value, sigma), "sigma": tables.format_to_sigma(sigma, sigma)}
        row |= {"recordings": one.places.size, "log10 E": "", "alarm": "", "change before": "", "step": ""}
        if one.change is not None:
            row["log10 E"] = f"{one.change.log_e.max() / np.log(10):.1f}"
        if one.name in changes:
            change, alarm = changes[one.name]
            row |= {"alarm": trend.recordings["recording"][alarm], "change before": _format_date(trend, one, change)}
            row["step"] = _format_step(change.step, change.step_sigma)
        rows.append(row)
    return pd.DataFrame(rows)


def _format_date(trend: Trend, one: ParameterTrend, change: ParameterChange) -> str:
    """The first recording after a change, with the range of its date where it is in doubt."""
    names = trend.recordings["recording"].to_numpy()[one.places]
    low, high = change.date_interval
    return f"{names[change.date]}" + ("" if low == high else f" (90 %: {names[low]} to {names[high]})")


def _format_step(step: float, sigma: float) -> str:
    text = tables.format_to_sigma(step, sigma)
    return f"{'' if step < 0 else '+'}{text} ± {tables.format_to_sigma(sigma, sigma)}"


def _format_temperature(value: float) -> str:
    return tables.NO_VALUE if np.isnan(value) else f"{value:.1f}"


# ---- page ----------------------------------------------------------------------------------------------------------------


def build_trend_page(trend: Trend, made: ProvenanceFooter | None = None) -> str:
    """The whole page, with how it was made."""
    _, first, *others = describe_trend(trend)
    changed = [one.name for one, *_ in trend.changes]
    strong = [one.name in changed for one in trend.parameters]
    sections = [
        Section("", [others]),
        Section("Changes", [PageTable(build_change_table(trend), strong, "Changes"), f"{TREND_NOTE}."]),
        Section("Over time", [_build_time_picture(trend)]),
        Section("Over temperature", _build_temperature_items(trend)),
        Section("Recordings", [PageTable(build_recording_table(trend), label="Recordings")]),
        Section("Values", [_build_value_table(trend)], is_folded=True),
    ]
    answer = Answer("gap" if trend.changes else "", _build_evidence_picture(trend), first)
    return Page(format_trend_headline(trend), sections, answer, made, "Trend of a unit").render_html()


def _name_time(trend: Trend) -> str:
    return "days" if trend.is_timed else "recording"


def _build_evidence_picture(trend: Trend) -> Picture:
    alt = f"Evidence for a change of each parameter, log10 E, over the recordings. {format_trend_headline(trend)}."
    caption = (
        "Evidence for a change of each parameter. Dashed: the threshold. It is small where a parameter varies from recording "
        "to recording anyway."
    )
    return Picture("evidence", partial(draw_evidence, trend), alt, caption)


def _build_time_picture(trend: Trend) -> Picture:
    alt = f"{len(trend.parameters)} parameters over the recordings' time. {format_trend_headline(trend)}."
    caption = "A row a gyro. Band: one sigma either way. Red: from a change on. Dotted: its most probable date."
    return Picture("time", partial(draw_trend, trend, trend.days, _name_time(trend)), alt, caption)


def _build_temperature_items(trend: Trend) -> Sequence[Item]:
    temperature = trend.recordings["temperature_c"].to_numpy()
    if np.isnan(temperature).any():
        return ["Not every recording has a housekeeping column with a temperature."]
    if not trend.has_slope:
        return [f"All recordings are within {SAME_TEMPERATURE_K:g} K of the first, and no slope is estimated."]
    alt = "The same parameters over the mean temperature of each recording."
    caption = "Bars: one sigma. Red: from a change on. The test leaves the slope with the temperature free."
    return [Picture("temperature", partial(draw_trend, trend, temperature, "temperature (°C)", "o"), alt, caption)]


def draw_trend(trend: Trend, x: Array, name: str, style: str = "o-") -> Figure:
    """Draw every parameter over time or temperature, a row a gyro."""
    rows = [list(group) for _, group in groupby(trend.parameters, key=lambda one: one.gyro)]
    columns, dates = max(map(len, rows)), {one.name: change.date for one, change, _ in trend.changes}
    panels = []
    for row in rows:
        axis = name if row is rows[-1] else ""
        panels += [_build_parameter_panel(one, dates.get(one.name), x, axis, style) for one in row]
        panels += [Panel(lambda axes: axes.set_axis_off())] * (columns - len(row))
    return draw_panels(*panels, size=(TREND_WIDTH_IN, ROW_HEIGHT_IN * len(rows) + 0.3), columns=columns)


def _build_parameter_panel(one: ParameterTrend, date: int | None, x: Array, name: str, style: str) -> Panel:
    """One parameter with its sigmas, before and after the date of its change."""
    places, is_line = one.places, "-" in style
    lines = []
    for part, colour in ((places[:date], TEAL), (places[date:] if date else places[:0], RED)):
        value, sigma = one.value[part], one.sigma[part]
        lines.append(Line(x[part], value, "", colour, style, value - sigma, value + sigma, bars=not is_line, size=3.0))
    at = [float(x[places[date - 1 : date + 1]].mean())] if date and is_line else []
    return make_curves(lines, title=one.name, x=name, y=one.unit, at=at)


def draw_evidence(trend: Trend) -> Figure:
    """Draw the evidence for a change of each parameter over the recordings, those with the most with a name."""
    tested = [(one, one.change.log_e) for one in trend.parameters if one.change is not None]
    colours = dict(zip((one.name for one, *_ in trend.changes), LINE_COLOURS, strict=False))
    lines = []
    for one, log_e in sorted(tested, key=lambda pair: float(pair[1].max())):
        look = (one.name if one.name in colours else "", colours.get(one.name, GREY))
        lines.append(Line(trend.days[one.places], log_e / np.log(10), *look, size=3.0))
    threshold = trend.log_threshold / np.log(10)
    legend = "upper left" if colours else ""
    panel = make_curves(lines, levels=[threshold], x=_name_time(trend), y="log10 E", legend=legend)
    return draw_panels(panel, size=(8.0, 3.6))


def _build_value_table(trend: Trend) -> PageTable:
    """A row for each recording and a column for each parameter, with its sigma."""
    cells = {"recording": trend.recordings["recording"].tolist()}
    for one in trend.parameters:
        pairs = zip(one.value, one.sigma, strict=True)
        cells[f"{one.name} ({one.unit})"] = [
            f"{tables.format_to_sigma(value, sigma)} ± {tables.format_to_sigma(sigma, sigma)}" if sigma > 0 else tables.NO_VALUE
            for value, sigma in pairs
        ]
    return PageTable(pd.DataFrame(cells), label="Values")
