"""The noise of a recording as one page: the figure, the terms beside the stated noise, and the stretches they come from."""

from functools import partial

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from gyrocal.allan.terms import RANDOM_WALK, compute_allan_variance
from gyrocal.calibration.parameters import AXIS_NAMES
from studies.allan.analysis import (
    COEFFICIENT_UNITS,
    RATE,
    RATE_UNIT,
    AxisNoise,
    NoiseAnalysis,
    convert_to_display_unit,
    describe_stretch,
)
from studies.report import tables
from studies.report.pages import Answer, Page, PageTable, Picture, ProvenanceFooter, Section
from studies.report.panels import DARK, GREY, RED, TEAL, Line, Panel, draw_panels, make_curves
from studies.report.tables import NO_VALUE

OFF = 4.0  # sigma: difference from the stated value that is worth a sentence
ALLAN_TERMS_NOTE = "Sigma assumes that the terms not seen are zero. A term is not seen if the fit is as good without it."
CAPTION = (
    "Overlapping Allan deviation with its 95 % band (χ² with the equivalent degrees of freedom of Greenhall & Riley for the "
    "strongest term at each time), the sum of the fitted terms, each term by itself, and the stated angle random walk."
)


def build_terms_table(analysis: NoiseAnalysis) -> pd.DataFrame:
    """Build a row for each term that is seen and each line, of each axis, as texts."""
    rows = []
    for name, axis in zip(AXIS_NAMES, analysis.axes, strict=True):
        for estimate in map(convert_to_display_unit, axis.fit.estimates):
            unit, factor = COEFFICIENT_UNITS[estimate.term]
            stated = tables.format_number(analysis.arw * factor) if analysis.arw and estimate.term == RANDOM_WALK else NO_VALUE
            cells = _format_cells(estimate.value, estimate.sigma) if estimate.seen else {"value": "not seen", "sigma": NO_VALUE}
            rows.append({"axis": name, "term": estimate.term} | cells | {"unit": unit, "stated": stated})
        for line in axis.lines:
            term = f"sinusoid, period {1 / line.frequency_hz:.4g} s"
            cells = _format_cells(line.amplitude * RATE, line.sigma * RATE)
            rows.append({"axis": name, "term": term} | cells | {"unit": RATE_UNIT, "stated": NO_VALUE})
    return pd.DataFrame(rows)


def _format_cells(value: float, sigma: float) -> dict[str, str]:
    """Format a value and its sigma, each to two digits of the sigma."""
    return {"value": tables.format_to_sigma(value, sigma), "sigma": tables.format_to_sigma(sigma, sigma)}


def list_remarks(analysis: NoiseAnalysis) -> list[str]:
    """List the findings in sentences."""
    out = [] if analysis.arw else ["The recording states no angle random walk."]
    for name, axis in zip(AXIS_NAMES, analysis.axes, strict=True):
        walk = axis.fit.estimate(RANDOM_WALK)
        if analysis.arw and not walk.seen:
            out.append(f"{name}: no angle random walk is seen.")
        elif analysis.arw and abs(walk.value - analysis.arw) > OFF * walk.sigma:
            difference, ratio = abs(walk.value - analysis.arw) / walk.sigma, walk.value / analysis.arw
            out.append(f"{name}: the angle random walk is {ratio:.3g} times the stated one, {difference:.0f} sigma off.")
        for alternative in axis.fit.alternatives:
            out.append(f"{name}: {' + '.join(alternative)} would fit as well; the deviation cannot tell.")
    return [*out, *analysis.notes, f"Lines are looked for with periods up to {analysis.longest_period_s:.3g} s."]


def draw_allan_figure(analysis: NoiseAnalysis) -> Figure:
    """Draw the deviation of each axis with its terms."""
    panels = [_draw_axis_panel(name, axis, analysis.arw) for name, axis in zip(AXIS_NAMES, analysis.axes, strict=True)]
    return draw_panels(*panels, size=(11.0 / 3 * len(panels), 4.2), sharey=True)


def _draw_axis_panel(name: str, axis: AxisNoise, arw: float) -> Panel:
    """Draw the deviation of one axis with its terms, the stated angle random walk, and the references' noise."""
    tau = axis.deviation.tau_s
    lines = [
        Line(tau, axis.deviation.deviation * RATE, "deviation, 95 %", TEAL, "o-", axis.low * RATE, axis.high * RATE),
        Line(tau, np.sqrt(axis.model) * RATE, "all terms", RED, "-"),
    ]
    for seen, style in zip([estimate for estimate in axis.fit.estimates if estimate.seen], ("--", ":", "-."), strict=False):
        term_deviation = seen.value * np.sqrt(compute_allan_variance(seen.term, tau))
        lines.append(Line(tau, term_deviation * RATE, seen.term, DARK, style))
    if arw > 0:
        lines.append(Line(tau, arw / np.sqrt(tau) * RATE, "stated", GREY, "-"))
    if axis.references.any():
        lines.append(Line(tau, np.sqrt(axis.references) * RATE, "references", GREY, ":"))
    return make_curves(lines, title=name, x="averaging time (s)", y="Allan deviation (deg/h)", log="xy", legend="upper right")


def build_allan_page(analysis: NoiseAnalysis, provenance: ProvenanceFooter | None = None) -> Page:
    """Build the page."""
    table = build_terms_table(analysis)
    is_seen = list(table["value"] != "not seen")
    picture = Picture("allan", partial(draw_allan_figure, analysis), describe_allan_figure(analysis), CAPTION)
    rests = "Rests are used as recorded. Elsewhere the motion by the references is subtracted."
    stretches = pd.DataFrame([describe_stretch(stretch) for stretch in analysis.stretches])
    first, *further = list_remarks(analysis) or ["The angle random walk is as stated."]
    sections = [
        Section("Terms of IEEE Std 952", [PageTable(table, is_seen, "Terms of IEEE Std 952", ALLAN_TERMS_NOTE)]),
        Section("Stretches", [PageTable(stretches, (), "Stretches", rests)]),
        *([Section("Remarks", [further])] if further else []),
    ]
    return Page(f"Allan deviation of {analysis.recording}", sections, Answer("", picture, first), provenance)


def describe_allan_figure(analysis: NoiseAnalysis) -> str:
    """Describe the figure in words."""
    parts = []
    for name, axis in zip(AXIS_NAMES, analysis.axes, strict=True):
        deviation = axis.deviation.deviation * RATE
        tau = axis.deviation.tau_s
        parts.append(f"{name} from {deviation[0]:.3g} deg/h at {tau[0]:g} s to {deviation[-1]:.3g} deg/h at {tau[-1]:g} s")
    return f"Allan deviation over averaging time: {'; '.join(parts)}."
