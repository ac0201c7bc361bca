"""The card of a diagnosis as a piece of a page, and as a picture of its own."""

from __future__ import annotations

import math
import textwrap
from html import escape

import matplotlib as mpl
from matplotlib.figure import Figure

from diagnosis.answer import Closure
from studies.report import gap_budget, panels
from studies.report.diagnosis_card import Card
from studies.report.panels import STYLE

LINE = 92  # characters of a line of the picture


def html(found: Card, kind: str) -> str:
    """The card as a piece of a page."""
    bar = "" if found.budget else _bar(found.closure)  # the page draws the budget above the card
    items = "".join(f"<dt>{escape(question)}</dt><dd>{escape(answer)}</dd>" for question, answer in found.lines)
    return f'<section class="answer {kind}" aria-label="The answer"><dl>{items}</dl>{bar}</section>\n'


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
        f'<div class="bar"><p class="quiet">{escape(closure.measure.capitalize())}</p><svg role="img" '
        f'aria-label="{escape(label)}" viewBox="0 0 640 70" fill="currentColor" font-size="13">{rows}</svg></div>'
    )


def figure(found: Card, recording: str) -> Figure:
    """The card as a picture of its own."""
    texts: list[tuple[str, str]] = [("title", line) for line in textwrap.wrap(found.headline, LINE * 2 // 3)]
    texts.append(("quiet", recording))
    for question, answer in found.lines:
        texts.append(("question", question))
        texts += [("answer", line) for line in textwrap.wrap(answer, LINE)]
    bars = 0.0 if found.closure is None else 0.95
    bars = 0.28 * len(found.budget) + 0.75 if found.budget else bars
    height = sum(_LOOKS[kind][3] for kind, _ in texts) + 0.25 + bars
    with mpl.rc_context(STYLE):
        drawn = Figure(figsize=(8.0, height))
        y = height - 0.15
        for kind, text in texts:
            size, weight, colour, step = _LOOKS[kind]
            drawn.text(0.02, y / height, _literal(text), fontsize=size, fontweight=weight, color=colour, va="top")
            y -= step
        if found.budget:
            axes = drawn.add_axes((0.3, 0.45 / height, 0.66, (bars - 0.6) / height))
            gap_budget.draw_steps(axes, found.budget)
        elif found.closure is not None:
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
