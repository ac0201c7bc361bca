"""A calibration as one page: whether to believe it, then parameters, residuals, correlations, what is determined, noise."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from gyrocal import CalibrationResult, GyroParameters, InputError, Recording
from gyrocal.calibration.problem import ROTATION_NAMES
from gyrocal.calibration.remainder_processes import WITH_REMAINDER
from studies.allan import report as allan_report
from studies.allan.analysis import estimate_noise_terms
from studies.report import calibration as words
from studies.report import tables
from studies.report.pages import Answer, Item, Page, PageTable, Picture, ProvenanceFooter, Section
from studies.report.panels import BLUE, GREY, RED, Line, draw_panels, make_curves, make_forest, make_heat_map

FIGURE_UNITS = {"1": ("ppm", 1e6), "rad": ("µrad", 1e6), "deg/s": ("deg/h", 3600.0)}  # of a table's, what figures show
TIGHT = 0.95  # correlation from which on two parameters are found together rather than each
MOST_NAMES = 3
FOREST_SIGMA = 3.0  # of the thin line
FIGURE_WIDTH_IN = 11.0
KINDS = {"yes": "", "with_wider_sigmas": "open", "unchecked": "open", "no": "gap"}  # colour of the answer by belief


def build_calibration_page(
    result: CalibrationResult,
    recording: Recording,
    truth: GyroParameters | None = None,
    made: ProvenanceFooter | None = None,
) -> str:
    """The whole page.

    Parameters
    ----------
    result : of the calibration
    recording : as calibrated, for the noise of its samples
    truth : known parameters; None if they are not
    made : for the footer
    """
    caption = f"{FOREST} The sigmas include the remainder." if result.recommended == WITH_REMAINDER else FOREST
    picture = Picture("forest", partial(draw_forest, result), _describe_forest(result), caption)
    sections = [
        Section("Parameters", [PageTable(words.build_parameter_table(result, truth), label="Parameters")]),
        Section(
            "Residuals before and after",
            [Picture("residuals", partial(draw_residual_figure, result), _describe_residuals(result), RESIDUAL_FIGURE_NOTE)],
        ),
        Section("What the data determine", _build_observability_items(result)),
        Section("Mounting of the gyro", [result.mounting.format_sentences()]),
        Section("Noise of the samples", _build_noise_items(recording)),
        Section("Remarks", [words.list_remarks(result)]),
    ]
    answer = Answer(KINDS[result.verdict.belief], picture, count_significant_changes(result), list_answers(result))
    return Page(result.verdict.summary.rstrip("."), sections, answer, made, f"Calibration of {result.recording}").render_html()


FOREST = (
    "Corrections of the initial parameters, with one sigma (thick) and three (thin). A correction whose thin line crosses zero "
    "is not significant."
)
RESIDUAL_FIGURE_NOTE = (
    "One point a reference attitude, in the order of the intervals (dotted lines between them). In the grey band, two sigma "
    "either way, is what the stated noise explains."
)


# ---- the first screen ----------------------------------------------------------------------------------------------------


def list_answers(result: CalibrationResult) -> dict[str, str]:
    """Answers by question, in the order in which they are read."""
    table = _build_solved_table(result)
    most = table.loc[table["in_sigma"].abs().nlargest(MOST_NAMES).index]
    changes = "; ".join(
        f"{r['parameter']} by {_format_short(r['correction'], '+')} {r['unit']} ({abs(r['in_sigma']):.0f} sigma)"
        for r in most.to_dict("records")
    )
    sigmas = "; ".join(
        f"{_format_short(part['sigma'].min())} to {_format_short(part['sigma'].max())} {unit}"
        for unit, part in table.groupby("unit", sort=False)
    )
    residuals = "; ".join(f"{name} {before:.4f} to {after:.4f} deg" for name, (before, after) in _compute_rms(result).items())
    lines = {
        "Why?": " ".join(result.verdict.reasons),
        "What changed most?": f"{changes}.",
        "How well are they known?": f"One sigma: {sigmas}.",
        "What is left of the residuals (RMS)?": f"{residuals}.",
        "Is everything determined?": _describe_observability(result),
        "What to do next?": recommend_next_step(result),
    }
    return {question: text for question, text in lines.items() if text}


def count_significant_changes(result: CalibrationResult) -> str:
    """Say how many parameters change significantly."""
    table = _build_solved_table(result)
    count = int((table["in_sigma"].abs() > FOREST_SIGMA).sum())
    which = "sigmas with remainder" if result.recommended == WITH_REMAINDER else "sigmas"
    return f"{count} of {len(table)} parameters change by more than three {which}."


def _describe_observability(result: CalibrationResult) -> str:
    free = result.observability.unobservable
    if free:
        return f"No: not found by the data are {'; '.join(free)}."
    pairs = _find_tight_pairs(result)
    more = f"; found together rather than each: {', '.join(f'{a} and {b}' for a, b in pairs[:MOST_NAMES])}" if pairs else ""
    return (
        f"Yes: the worst combination is known {result.observability.singular_values[-1]:.0f} times better than its plausible "
        f"range{more}."
    )


def recommend_next_step(result: CalibrationResult) -> str:
    """Recommend the next step after the result."""
    if result.warnings:
        return "Check how the recording was made and read: the reasons above name the suspects."
    if result.observability.unobservable:
        return "Fly a maneuver that turns about what is missing: gyrocal plan says of a scenario what each maneuver brings."
    steps = {
        "untested": "Add reference attitudes or intervals, so that something is left to check with.",
        "smaller": "State the noise of gyro and references as it is: gyrocal allan measures the gyro's.",
        "fits": "gyrocal predict carries the attitude on by gyro with its covariance, which held-out references can check.",
    }
    unexplained = f"{words.describe_worst_residual(result)} Ask gyrocal diagnose which effect is not modelled, and where."
    return steps.get(result.verdict.fit, unexplained.strip())


def _format_short(value: float, sign: str = "") -> str:
    """A number to three digits, without an exponent where that can be."""
    return f"{float(f'{value:.3g}'):{sign}g}"


def _compute_rms(result: CalibrationResult) -> dict[str, tuple[float, float]]:
    """Root mean square of the residuals before and after, deg, by axis."""
    table = result.residuals

    def compute_axis_rms(name: str) -> float:
        return float(np.sqrt(np.mean(np.square(table[f"{name}_deg"]))))

    return {name: (compute_axis_rms(f"before_{name}"), compute_axis_rms(f"after_{name}")) for name in ROTATION_NAMES}


def _build_solved_table(result: CalibrationResult) -> pd.DataFrame:
    """The solved parameters in the units that figures have, with the recommended sigmas."""
    table, widened = result.summary(), words.compute_sigma_with_remainder(result)
    if widened is not None and result.recommended == WITH_REMAINDER:
        table["sigma"] = widened
    table = table.query("solved").copy()
    scales = [FIGURE_UNITS.get(unit, (unit, 1.0)) for unit in table["unit"]]
    factors = np.array([factor for _, factor in scales])
    table["unit"] = [unit for unit, _ in scales]
    for name in ("correction", "sigma"):
        table[name] = table[name].to_numpy(dtype=float) * factors
    table["in_sigma"] = table["correction"] / table["sigma"]
    return table


# ---- figures -------------------------------------------------------------------------------------------------------------


def draw_forest(result: CalibrationResult) -> Figure:
    """Corrections with their sigmas, a line a parameter, a panel a unit."""
    groups = list(_build_solved_table(result).groupby("unit", sort=False))
    made = []
    for unit, part in groups:
        names, sigma = list(part["parameter"]), part["sigma"]
        made.append(make_forest(names, part["correction"], FOREST_SIGMA * sigma, sigma, at=[0], x=f"correction ({unit})"))
    return draw_panels(*made, size=(8.5, 0.3 * max(len(part) for _, part in groups) + 1.0))


def draw_residual_figure(result: CalibrationResult) -> Figure:
    """Residuals before and after by axis, over the references, with what the covariance model expects."""
    table = result.residuals
    number = np.arange(len(table))
    first = table.groupby("interval", sort=False).ngroup().diff().to_numpy() > 0
    edges = [float(k) - 0.5 for k in np.flatnonzero(first)] if first.sum() <= 24 else []
    made = []
    for when, colour in (("before", RED), ("after", BLUE)):
        for name in ROTATION_NAMES:
            sigma = table[f"sigma_{name}_deg"].to_numpy(dtype=float)
            lines = [
                Line(number, 0 * sigma, "", GREY, "-", -2 * sigma, 2 * sigma),
                Line(number, table[f"{when}_{name}_deg"], when, colour, "o" if when == "before" else "s", size=3.0),
            ]
            x = "reference" if when == "after" else ""
            made.append(make_curves(lines, x=x, y=f"{name} {when} (deg)", at=edges))
    return draw_panels(*made, size=(FIGURE_WIDTH_IN, 5.0), columns=len(ROTATION_NAMES))


def compute_correlations(result: CalibrationResult) -> pd.DataFrame:
    """Correlation of the solved parameters."""
    names = list(result.summary()["parameter"])
    solved = [names.index(name) for name in result.solved_for]
    covariance = result.own_covariance[np.ix_(solved, solved)]
    sigma = np.sqrt(np.diag(covariance))
    return pd.DataFrame(covariance / np.outer(sigma, sigma), index=list(result.solved_for), columns=list(result.solved_for))


def _rank_correlated_pairs(result: CalibrationResult) -> list[tuple[float, str, str]]:
    """Size of the correlation of each two parameters with their names, the strongest first."""
    found = compute_correlations(result)
    names, values = [str(name) for name in found.index], np.abs(found.to_numpy(dtype=float))
    return sorted(((float(values[i, j]), names[i], names[j]) for i in range(len(names)) for j in range(i)), reverse=True)


def _find_tight_pairs(result: CalibrationResult) -> list[tuple[str, str]]:
    """Pairs of parameters that are found together, the tightest first."""
    return [(a, b) for share, a, b in _rank_correlated_pairs(result) if share > TIGHT]


def _build_observability_items(result: CalibrationResult) -> list[Item]:
    values, found = result.observability.singular_values, compute_correlations(result)
    strongest = "".join(f" The strongest is {share:.2f}, of {a} and {b}." for share, a, b in _rank_correlated_pairs(result)[:1])
    return [
        _describe_observability(result),
        Picture(
            "observability",
            partial(_draw_spectrum, values),
            f"{values.size} combinations of the parameters by how well the data determine them, from {values[0]:.3g} to "
            f"{values[-1]:.3g} times their plausible range.",
            "How many times better than its plausible range each combination is known; below the dashed line the data say "
            "nothing new.",
        ),
        Picture(
            "correlations",
            lambda: draw_panels(make_heat_map(found.round(1) + 0.0, "{:.1f}"), size=(7.5, 5.6)),
            f"Map of the correlations of {len(found)} parameters.{strongest}",
            "Correlation of each two parameters. Near ±1 only a combination of the two is known well.",
        ),
    ]


def _draw_spectrum(values: np.ndarray) -> Figure:
    line = Line(np.arange(1, values.size + 1), np.maximum(values, 1e-3), "", BLUE, "o-")
    axes: dict[str, Any] = {"x": "combination", "y": "plausible range over sigma", "ticks": range(1, values.size + 1)}
    return draw_panels(make_curves([line], log="y", levels=[1.0], **axes), size=(FIGURE_WIDTH_IN / 2, 3.2))


def _build_noise_items(recording: Recording) -> list[Item]:
    try:
        found = estimate_noise_terms(recording)
    except InputError as error:
        return [f"No Allan deviation: {error}"]
    terms = allan_report.build_terms_table(found)
    seen = [not str(value).startswith("not seen") for value in terms["value"]]
    picture = Picture(
        "allan", partial(allan_report.draw_allan_figure, found), allan_report.describe_allan_figure(found), allan_report.CAPTION
    )
    return [allan_report.list_remarks(found), picture, PageTable(terms, seen, "Noise terms")]


def _describe_forest(result: CalibrationResult) -> str:
    table = _build_solved_table(result)
    cells = ", ".join(
        f"{r['parameter']} {tables.format_to_sigma(r['correction'], r['sigma'])} ± {r['sigma']:.2g} {r['unit']}"
        for r in table.to_dict("records")
    )
    return f"Corrections of {len(table)} parameters: {cells}."


def _describe_residuals(result: CalibrationResult) -> str:
    cells = ", ".join(f"{name} from {before:.4f} to {after:.4f} deg" for name, (before, after) in _compute_rms(result).items())
    return f"Residuals of {len(result.residuals)} reference attitudes; RMS {cells}."
