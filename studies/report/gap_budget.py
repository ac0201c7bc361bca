"""The gap budget in words and as a figure: what each cause closes of the misfit, and what is left."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from diagnosis.answer import RemainderSummary
from diagnosis.budget import Step
from diagnosis.result import Diagnosis
from studies.report import diagnosis_words as words
from studies.report import panels

BUDGET_WIDTH_IN = 8.5  # inches
ROW = 0.32  # inches of a row
SIGMAS_90 = 1.645  # half the width of a 90 % interval
HETEROGENEOUS = 0.01  # p-value below which the sizes by part do not agree
SIDE_NAMES = {
    "gyro": "the gyro",
    "reference": "the reference attitudes",
    "time tags": "the time tags",
    "white noise": "white noise larger than stated",
}


def name_step(step: Step) -> str:
    """Name a step for a reader."""
    return {
        "baseline": "baseline",
        "remainder": "remainder: not explained",
        "floor": "floor: stated noise alone",
    }.get(step.step, f"with {step.step}")


def summarise(diagnosis: Diagnosis) -> str:
    """Summarise the budget in a sentence; without one, the test of the baseline."""
    left = [step.closed for step in diagnosis.budget if step.step == "remainder"]
    if not left or left[0] is None:
        return words.describe_gap_test(diagnosis)
    if not diagnosis.causes:
        return "No cause is identified, so nothing closes the misfit on held-out data."
    if diagnosis.closure is not None and not words.is_measured(diagnosis.closure):
        return f"{words.TOO_LITTLE}."
    left_over = min(max(100 * left[0], 0.0), 100.0)
    causes = "this cause closes" if len(diagnosis.causes) == 1 else f"these {len(diagnosis.causes)} causes close"
    return f"In the model, {causes} {100 - left_over:.0f} % of the misfit on held-out data; {left_over:.0f} % is not explained."


def describe(diagnosis: Diagnosis) -> Iterator[str]:
    """Describe the budget in sentences: one for each cause, and what is left."""
    for step in diagnosis.budget:
        if step.size is None or step.closed is None or step.interval_90 is None:
            continue
        low, high = (100 * share for share in step.interval_90)
        text = f"{step.step} closes {100 * step.closed:.0f} % of the held-out misfit (90 % interval {low:.0f} to {high:.0f} %)"
        yield f"{text}{_describe_agreement(step)}."
    if diagnosis.remainder is not None:
        yield from describe_remainder(diagnosis.remainder)


def _describe_agreement(step: Step) -> str:
    if len(step.by_part) < 2 or step.heterogeneity_p is None:
        return ""
    count = len(step.by_part)
    if step.heterogeneity_p < HETEROGENEOUS:
        text = f"; its size differs between {count} parts of the recording by {step.spread:.2g} {step.unit} (1 sigma, p = "
        ramp = "" if step.ramp is None else f"; a line over time goes from {step.ramp[0]:.3g} to {step.ramp[1]:.3g} {step.unit}"
        return f"{text}{step.heterogeneity_p:.1g}), in the mean {step.size:.3g} {step.unit}{ramp}"
    return f"; its sizes in {count} parts of the recording agree (p = {step.heterogeneity_p:.2g})"


def describe_remainder(left: RemainderSummary) -> Iterator[str]:
    """Describe the remainder: share, side, size, time scale, and the regressors that it follows."""
    low, high = (100 * share for share in left.interval_90)
    yield f"No identified cause explains {100 * left.share:.0f} % of the misfit (90 % interval {low:.0f} to {high:.0f} %)."
    yield describe_side(left)
    for one in left.regressors:
        share = f"closes {100 * one.share:.0f} % of the held-out misfit"
        yield f"It {_describe_behaviour(one.name)} ({words.format_p_value(one.p_value)}; {share})."


def describe_side(left: RemainderSummary) -> str:
    """Describe where most of a remainder comes from, its time scale and its sizes."""
    lasting = f", with a correlation time of about {left.time_scale_s:.2g} s" if left.time_scale_s > 0 else ""
    return f"Most of it comes from {SIDE_NAMES[left.side]}{lasting}. Its sizes (1 sigma, x, y, z): {list_sizes(left)}."


def list_sizes(left: RemainderSummary) -> str:
    """List the sizes of a remainder, 1 sigma about x, y and z."""
    sizes = []
    if any(left.gyro_deg_h):
        sizes.append(f"{_format_by_axis(left.gyro_deg_h)} deg/h of gyro rate")
    if any(left.reference_deg):
        sizes.append(f"{_format_by_axis(left.reference_deg)} deg of reference attitude")
    if left.time_tags_s > 0:
        sizes.append(f"{left.time_tags_s:.2g} s of time tags")
    return "; ".join(sizes) or "none"


def _describe_behaviour(name: str) -> str:
    behaviour, _, axis = name.partition(":")
    return f"behaves like this: {behaviour}{f', axis {axis}' if axis else ''}"


def _format_by_axis(values: tuple[float, ...]) -> str:
    return ", ".join(np.format_float_positional(value, precision=2, fractional=False, trim="-") for value in values)


# ---- figure --------------------------------------------------------------------------------------------------------------


def draw_waterfall(budget: tuple[Step, ...]) -> Figure:
    """Draw the waterfall, and beside it the sizes of the causes by part of the recording."""
    causes = [step for step in budget if len(step.by_part) > 1]
    rows = max(len(budget), *(len(one.by_part) + 1 for one in causes), 4)
    waterfall = panels.Panel(partial(draw_steps, budget=budget))
    widths = [2.2, *[1.0] * len(causes)]
    return panels.draw_panels(
        waterfall, *map(_draw_size_by_part, causes), size=(BUDGET_WIDTH_IN, ROW * rows + 1.2), widths=widths
    )


def _draw_size_by_part(step: Step) -> panels.Panel:
    """Sizes of one cause by part with 90 % bars, and its size over all parts as a band."""
    sizes, sigmas = (np.array([getattr(one, name) for one in step.by_part]) for name in ("size", "sigma"))
    band = None if step.size is None or step.sigma is None else (step.size - step.sigma, step.size + step.sigma)
    names = [one.part for one in step.by_part]
    return panels.make_forest(names, sizes, SIGMAS_90 * sigmas, band=band, at=[0.0], title=step.step, x=step.unit or "")


def draw_steps(on: Axes, budget: tuple[Step, ...]) -> None:
    """Draw the steps of a budget as a waterfall."""
    explained = [step for step in budget if step.step not in ("remainder", "floor")]
    floor, last = budget[-1].misfit, explained[-1].misfit
    spans = [(floor, explained[0].misfit, panels.RED)]
    spans += [(after.misfit, before.misfit, panels.BLUE) for before, after in pairwise(explained)]
    spans += [(floor, last, panels.ORANGE), (0.0, floor, panels.GREY)]
    for row, (step, (low, high, colour)) in enumerate(zip(budget, spans, strict=True)):
        on.barh(row, high - low, left=low, color=colour, height=0.62)
        share = "" if step.closed is None or step.interval_90 is None else format_share(step.closed, step.interval_90)
        text = f"{step.misfit:.3g}" if step.step in ("baseline", "floor") else share
        on.annotate(text, (max(high, low), row), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8)
    on.set_yticks(range(len(budget)), [name_step(step) for step in budget])
    on.invert_yaxis()
    on.set_xlim(0, 1.28 * max(step.misfit for step in budget))
    on.set_xlabel("held-out whitened mean square")
    on.grid(visible=False)


def format_share(share: float, interval: tuple[float, float]) -> str:
    """Format a share with its interval in percent."""
    low, high = (100 * value for value in interval)
    return f"{100 * share:.0f} % ({low:.0f} to {high:.0f})"
