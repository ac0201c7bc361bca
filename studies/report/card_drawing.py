"""The card of a diagnosis as a picture of its own."""

from __future__ import annotations

import textwrap

import matplotlib as mpl
from matplotlib.figure import Figure

from studies.report import gap_budget
from studies.report.diagnosis_card import Card
from studies.report.panels import PANEL_STYLE

LINE_CHARACTERS = 92  # characters of a line of the picture


def draw_card(found: Card, recording: str) -> Figure:
    """The card as a picture of its own."""
    texts: list[tuple[str, str]] = [("title", line) for line in textwrap.wrap(found.headline, LINE_CHARACTERS * 2 // 3)]
    texts.append(("quiet", recording))
    for question, answer in found.lines:
        texts.append(("question", question))
        texts += [("answer", line) for line in textwrap.wrap(answer, LINE_CHARACTERS)]
    bars = 0.28 * len(found.budget) + 0.75 if found.budget else 0.0
    height = sum(_LOOKS[kind][3] for kind, _ in texts) + 0.25 + bars
    with mpl.rc_context(PANEL_STYLE):
        drawn = Figure(figsize=(8.0, height))
        y = height - 0.15
        for kind, text in texts:
            size, weight, colour, step = _LOOKS[kind]
            drawn.text(0.02, y / height, _quote_dollars(text), fontsize=size, fontweight=weight, color=colour, va="top")
            y -= step
        if found.budget:
            axes = drawn.add_axes((0.3, 0.45 / height, 0.66, (bars - 0.6) / height))
            gap_budget.draw_steps(axes, found.budget)
    return drawn


_LOOKS: dict[str, tuple[float, str, str, float]] = {  # size, weight, colour, inches to the next line
    "title": (14.0, "bold", "#1b1f24", 0.3),
    "quiet": (9.0, "normal", "#57606a", 0.28),
    "question": (9.5, "bold", "#1b1f24", 0.2),
    "answer": (9.5, "normal", "#1b1f24", 0.22),
}


def _quote_dollars(text: str) -> str:
    """A text in which a dollar is one."""
    return text.replace("$", r"\$")
