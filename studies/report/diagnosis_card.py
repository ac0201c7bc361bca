"""The answer of a diagnosis on one screen, in plain words: for a page, and as a picture to pass on.

No name of an effect is in it; each effect says itself what is so when it is at work (`simulator.effects.base.Effect.sentence`).
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib import resources

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from diagnosis.answer import Cause, Closure, Finding
from diagnosis.result import Diagnosis
from simulator.effects.sensor import ALL_EFFECTS as EFFECTS
from studies.report import diagnosis_words as words
from studies.report import next_flight as flights
from studies.report import panels
from studies.report.panels import STYLE

HOUR = 3600.0
ARCSEC = 3600.0  # a degree
MOST_FINDINGS = 2
ORDER = ("First", "Second", "Third", "Fourth", "Fifth", "Sixth", "Seventh", "Eighth")
LINE = 92  # characters of a line of the picture


@dataclass(frozen=True)
class Card:
    """What the card says.

    Attributes
    ----------
    headline : the answer in a sentence
    lines : (question, answer), in the order in which they are read
    closure : the bar under the answers; None without one
    """

    headline: str
    lines: tuple[tuple[str, str], ...]
    closure: Closure | None


def card(diagnosis: Diagnosis, orbit_s: float = math.nan, next_flight: str = "") -> Card:
    """The card of a diagnosis.

    Parameters
    ----------
    diagnosis : the answer
    orbit_s : period of the orbit, NaN if unknown; an hour is then what pointing is told for
    next_flight : what to fly next, in a sentence, of `studies.report.next_flight`; without a plan by default
    """
    lines = [("Is there a gap?", _gap(diagnosis))]
    if diagnosis.causes:
        lines.append(("How large?", words.listed([words.cause_size(one) for one in diagnosis.causes], "and") + "."))
    lines.append(("How sure?", _sure(diagnosis)))
    lines.append(("Where?", _where(diagnosis)))
    lines.append(("How far does it close?", words.closed_in_short(diagnosis)))
    if diagnosis.causes:
        lines.append(("What does it cost in pointing?", pointing(diagnosis.details.regressors, orbit_s)))
    lines.append(("What to fly next?", next_flight or flights.sentence(diagnosis)))
    lines.append(("What can it not tell?", _limits(diagnosis)))
    return Card(headline(diagnosis), tuple(lines), diagnosis.closure)


# ---- sentences -----------------------------------------------------------------------------------------------------------


def headline(diagnosis: Diagnosis) -> str:
    """The answer as a sentence that anyone can read."""
    if diagnosis.verdict == "none":
        return "This recording shows nothing that the simulator would not do"
    if diagnosis.verdict == "unknown":
        beside = [clause(cause) for cause in diagnosis.causes]
        more = f"; beside it, {words.listed(beside, 'and')}" if beside else ""
        return f"Something is at work that is on no list of known causes{more}"
    if diagnosis.verdict == "not identifiable" or not diagnosis.causes:
        there = "There is a gap, and this" if diagnosis.present else "This"
        return f"{there} recording cannot show {'its cause' if diagnosis.present else 'whether there is a gap'}"
    text = ", and ".join(_either(cause, diagnosis) for cause in diagnosis.causes)
    return text[0].upper() + text[1:]


def clause(cause: Cause) -> str:
    """What is so when a cause is at work, with its size."""
    if cause.effect not in EFFECTS:
        return f"something acts that is on no list ({cause.effect})"
    return EFFECTS[cause.effect].sentence(cause.axis, cause.size, magnitude(cause))


def _either(cause: Cause, diagnosis: Diagnosis) -> str:
    """A cause, or that it or another one is at work where the recording cannot tell them apart."""
    others = [_bare(member) for member in cause.group if member != cause.label]
    if diagnosis.verdict != "group" or not others:
        return clause(cause)
    return f"either {clause(cause)}, or {words.listed(others, 'or')}"


def _bare(label: str) -> str:
    """What is so when an effect is at work, without a size."""
    name, _, axis = label.partition(":")
    if name not in EFFECTS:
        return "something acts that is on no list"
    # A size that nobody knows here: the clause is told by an amount.
    return EFFECTS[name].sentence(axis or None, 1.0, "some amount")


def magnitude(cause: Cause) -> str:
    """The size without its sign to two digits, three where its sigma is below a percent, and its unit."""
    value = abs(cause.size)
    unit = "" if cause.unit == "factor" else f" {cause.unit.split(',')[0]}"
    if not math.isfinite(value) or value == 0:
        return f"an unknown number of {cause.unit}"
    digits = 3 if 0 < cause.sigma < 0.01 * value else 2
    decimals = digits - 1 - math.floor(math.log10(value))
    return f"{round(value, decimals):.{max(decimals, 0)}f}{unit}"


def _gap(diagnosis: Diagnosis) -> str:
    answer = "Yes" if diagnosis.present else "None is seen"
    return (
        f"{answer}: noise as stated would depart so far with {words.p_value(diagnosis.p_value)}; of recordings without a gap "
        f"{100 * diagnosis.false_alarm_rate:g} % would be said to have one."
    )


def _sure(diagnosis: Diagnosis) -> str:
    if diagnosis.verdict == "none":
        return "A gap smaller than the noise would not be seen."
    if not diagnosis.causes:
        return f"With a probability of {words.percent(diagnosis.unknown_probability)} it is something that is on no list."
    parts = []
    for number, cause in enumerate(diagnosis.causes):
        which = f"{ORDER[number]}: p" if len(diagnosis.causes) > 1 else "P"
        text = f"{which}robability {words.percent(cause.probability)}"
        if len(cause.group) > 1:
            text += f", {words.percent(cause.group_probability)} that it is this or what cannot be told from it"
        parts.append(f"{text}. {reliability(cause.probability)}".strip())
    return " ".join(dict.fromkeys(parts))


@cache
def _measured() -> pd.DataFrame:
    """How often what was stated was there, by stated probability; of the wide check."""
    with resources.files("studies").joinpath("data", "reliability.csv").open("rb") as file:
        return pd.read_csv(file)


def reliability(probability: float) -> str:
    """How often statements of such a probability were right when it was measured."""
    rows = _measured()
    rows = rows[(rows["from"] <= probability) & (probability <= rows["to"]) & (rows["statements"] > 0)]
    if rows.empty:
        return "How often so sure a statement is right is not known: in the sealed checks there was none."
    row = rows.iloc[-1]
    return (
        f"Of {row['statements']:.0f} statements of {100 * row['from']:.0f} to {100 * row['to']:.0f} % in sealed checks "
        f"{100 * row['there']:.0f} % were right ({100 * row['low']:.0f} to {100 * row['high']:.0f} %)."
    )


def _where(diagnosis: Diagnosis) -> str:
    places = list(dict.fromkeys(_place(one) for one in diagnosis.where[:MOST_FINDINGS]))
    return f"Most of all {words.listed(places, 'and')}." if places else "Nowhere."


def _place(one: Finding) -> str:
    axis = f" about {one.axis}" if one.axis else ""
    interval = f" in {one.interval}" if one.interval else ""
    window = f", {one.window_s[0]:.0f} to {one.window_s[1]:.0f} s after its start" if one.window_s and one.interval else ""
    what = "gyro's own samples" if one.signal == "gyro stream" else one.signal
    return f"in the {what}{axis}{interval}{window}"


def pointing(regressors: pd.DataFrame, orbit_s: float) -> str:
    """The largest angle by which the causes turn an attitude that is carried by gyro, within an orbit or an hour.

    The calibration, which takes part of a cause into G and b, is made without it; what is left is what is told.

    Parameters
    ----------
    regressors : as of `diagnosis.result.Details`
    orbit_s : period, NaN if unknown
    """
    if regressors.empty:
        return "It is in the samples themselves and turns no attitude that could be measured here."
    window, name = (orbit_s, "an orbit") if math.isfinite(orbit_s) else (HOUR, "an hour")
    keys = ["interval", "axis"]
    together = regressors.groupby([*keys, "t_s"], sort=False)["regressor_deg"].sum().reset_index()
    worst = max(((_swing(part, window), key) for key, part in together.groupby(keys, sort=False)), key=lambda one: one[0][0])
    (angle, length), (interval, axis) = worst
    within = name if 0.9 * window < length <= window else f"{length / 60:.0f} min"
    size = f"{float(f'{angle * ARCSEC:.3g}'):g}"
    return f"Carried by gyro, the attitude errs by up to {size} arcsec about {axis} in {within}, in {interval}."


def _swing(part: pd.DataFrame, window: float) -> tuple[float, float]:
    """Largest change of an angle within a window, deg, and the time that the window spans, s; of an interval at least."""
    t, angle = part["t_s"].to_numpy(), part["regressor_deg"].to_numpy()
    if t.size < 2:
        return 0.0, 0.0
    step = float(np.diff(t).min())
    if step > window:
        return float(np.ptp(angle)), float(np.ptp(t))
    spans = [angle[(t >= start) & (t <= start + window)] for start in t]
    return max(float(np.ptp(one)) for one in spans), min(window, float(np.ptp(t)))


def _limits(diagnosis: Diagnosis) -> str:
    others = [_bare(member) for cause in diagnosis.causes for member in cause.group if member != cause.label]
    if others:
        return f"Whether it is not rather that {words.listed(list(dict.fromkeys(others)), 'or')}."
    return "Constant errors of scale, alignment and bias, which the calibration takes up, and what is below the noise."


# ---- on a page and as a picture ------------------------------------------------------------------------------------------


def html(found: Card, kind: str) -> str:
    """The card as a piece of a page."""
    items = "".join(f"<dt>{escape(question)}</dt><dd>{escape(answer)}</dd>" for question, answer in found.lines)
    return f'<section class="answer {kind}" aria-label="The answer"><dl>{items}</dl>{_bar(found.closure)}</section>\n'


def _bar(closure: Closure | None) -> str:
    """The closure as a bar from the floor to what was before."""
    if closure is None or not math.isfinite(closure.before) or closure.before <= 0:
        return ""
    scale = 100 / max(closure.before, closure.after, closure.floor)
    rows = "".join(
        f'<text x="0" y="{16 + 22 * k}">{name}</text><rect x="120" y="{5 + 22 * k}" width="{4.6 * scale * value:.1f}" '
        f'height="14" fill="{colour}"/><text x="{126 + 4.6 * scale * value:.1f}" y="{16 + 22 * k}">{value:.3g}</text>'
        for k, (name, value, colour) in enumerate(
            (
                ("before", closure.before, "var(--bad)"),
                ("with the cause", closure.after, "var(--link)"),
                ("noise alone", closure.floor, "var(--quiet)"),
            )
        )
    )
    label = f"{closure.measure}: {closure.before:.3g} before, {closure.after:.3g} with the cause, {closure.floor:.3g} by noise"
    return (
        f'<div class="bar"><svg role="img" aria-label="{escape(label)}" viewBox="0 0 640 70" fill="currentColor" '
        f'font-size="13">{rows}</svg></div>'
    )


def figure(found: Card, recording: str) -> Figure:
    """The card as a picture of its own."""
    texts: list[tuple[str, str]] = [("title", line) for line in textwrap.wrap(found.headline, LINE * 2 // 3)]
    texts.append(("quiet", recording))
    for question, answer in found.lines:
        texts.append(("question", question))
        texts += [("answer", line) for line in textwrap.wrap(answer, LINE)]
    bars = found.closure is not None
    height = sum(_LOOKS[kind][3] for kind, _ in texts) + 0.25 + (0.95 if bars else 0.0)
    with mpl.rc_context(STYLE):
        drawn = Figure(figsize=(8.0, height))
        y = height - 0.15
        for kind, text in texts:
            size, weight, colour, step = _LOOKS[kind]
            drawn.text(0.02, y / height, _literal(text), fontsize=size, fontweight=weight, color=colour, va="top")
            y -= step
        if found.closure is not None:
            axes = drawn.add_axes((0.2, 0.1 / height, 0.7, 0.6 / height))
            values = (found.closure.before, found.closure.after, found.closure.floor)
            bar = axes.barh(["before", "with the cause", "noise alone"], values, color=[panels.RED, panels.BLUE, panels.GREY])
            axes.bar_label(bar, [f"{value:.3g}" for value in values], padding=3, fontsize=8)
            axes.invert_yaxis()
            axes.set_axisbelow(True)
            axes.set_xticks([])
            axes.grid(visible=False)
            axes.spines[["bottom", "left"]].set_visible(False)
            axes.set_title(found.closure.measure, loc="left", fontsize=8)
    return drawn


_LOOKS: dict[str, tuple[float, str, str, float]] = {  # size, weight, colour, inches to the next line
    "title": (14.0, "bold", "#1b1f24", 0.3),
    "quiet": (9.0, "normal", "#57606a", 0.28),
    "question": (9.5, "bold", "#1b1f24", 0.2),
    "answer": (9.5, "normal", "#1b1f24", 0.22),
}


def _literal(text: str) -> str:
    """A text in which a dollar is one."""
    return text.replace("$", r"\$")


def names(found: Card) -> Sequence[str]:
    """All that the card says, for a check that no name of an effect is in it."""
    return [found.headline, *(text for line in found.lines for text in line)]
