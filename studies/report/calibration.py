"""A calibration as one page for the terminal and the browser, and its change against a saved one."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from gyrocal.angle_units import ANGLE_UNITS, RATE_UNITS
from gyrocal.calibration.gyro_space import select_parameter_space
from gyrocal.calibration.observability import BIAS_LETTERS
from gyrocal.calibration.parameters import NAMES, SCALE_FACTORS, GyroParameters, select
from gyrocal.calibration.problem import ROTATION_NAMES
from gyrocal.calibration.remainder_processes import DEG_H_PER_RAD_S, WITH_REMAINDER
from gyrocal.calibration.result import DEGREES, CalibrationResult
from gyrocal.errors import InputError
from studies.report import tables
from studies.report.junit import Verdict
from studies.report.pages import Answer, Page, PageTable, Picture, ProvenanceFooter, Section
from studies.report.panels import BLUE, GREY, RED, Line, draw_panels, make_curves, make_forest
from studies.report.units import PPM_DEG_H, PPM_DEG_H_NAMES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gyrocal.calibration.change import CalibrationChange

LARGE_SHARE = 4.0  # sigma of a single residual worth a sentence
NOTABLE = 0.3  # sigma of an expected error worth a sentence; it makes a sigma 4 % too small
TIGHT = 0.95  # correlation of two parameters above which only their combination is known well
MOST_NAMES = 3
FOREST_SIGMA = 3.0  # of the thin line
FIGURE_WIDTH_IN = 11.0
FIGURE_UNITS = {"1": ("ppm", 1e6), "rad": ("µrad", 1e6), "deg/s": ("deg/h", 3600.0)}  # by the unit of the table
KINDS = {"yes": "", "with_wider_sigmas": "open", "unchecked": "open", "no": "gap"}  # colour of the answer by belief
FOREST = (
    "Corrections of the initial parameters, with one sigma (thick) and three (thin). A correction whose thin line crosses zero "
    "is not significant."
)
RESIDUAL_FIGURE_NOTE = (
    "One point a reference attitude, in the order of the intervals (dotted lines between them). The grey band is two sigma of "
    "the stated noise."
)
FOREST_ALT = "Corrections of the parameters with their sigmas; the table of parameters has the same numbers."
RESIDUAL_ALT = "Residuals of the reference attitudes before and after the calibration, with two sigma of the stated noise."
RATIO_UNITS = {"ppm": 1e-6, "%": 1e-2}
LIMIT_FORM = re.compile(r"\s*([\w,\s-]+?)\s*<\s*(\d*\.?\d+(?:[eE][-+]?\d+)?)\s*([a-z%/]+)\s*")


def build_calibration_page(
    result: CalibrationResult,
    held_out: str,
    truth: GyroParameters | None = None,
    provenance: ProvenanceFooter | None = None,
    further_sections: Sequence[Section] = (),
) -> Page:
    """Build the page; held_out describes the prediction of held-out turns, and further sections come last."""
    caption = f"{FOREST} The sigmas include the remainder." if result.recommended == WITH_REMAINDER else FOREST
    picture = Picture("forest", partial(draw_forest, result), FOREST_ALT, caption)
    residuals = Picture("residuals", partial(draw_residual_figure, result), RESIDUAL_ALT, RESIDUAL_FIGURE_NOTE)
    has_fixed_iterations = result.options.get("iterations") is not None
    convergence = "converged" if result.converged else "as many as asked for" if has_fixed_iterations else "NOT CONVERGED"
    note = f"{len(result.corrections)} iteration(s), {convergence}; {result.psi} ψ, covariance {result.covariance_model}."
    sections = [
        Section("Parameters", [PageTable(build_parameter_table(result, truth), (), "Parameters", note)]),
        Section("Residuals before and after", [residuals]),
        Section("Mounting of the gyro", [result.mounting.format_sentences()]),
        Section("Remarks", [list_remarks(result)]),
        *further_sections,
    ]
    answer = Answer(KINDS[result.verdict.belief], picture, held_out, list_answers(result))
    sections = [section for section in sections if any(section.items)]
    return Page(result.verdict.summary.rstrip("."), sections, answer, provenance, f"Calibration of {result.recording}")


# ---- answers -------------------------------------------------------------------------------------------------------------


def list_answers(result: CalibrationResult) -> dict[str, str]:
    """List the answers by question, in the order in which they are read."""
    table = _build_solved_table(result)
    largest = table.loc[table["in_sigma"].abs().nlargest(MOST_NAMES).index]
    changes = "; ".join(
        f"{r['parameter']} by {tables.format_short(r['correction'], 3, '+')} {r['unit']} ({abs(r['in_sigma']):.0f} sigma)"
        for r in largest.to_dict("records")
    )
    significant = int((table["in_sigma"].abs() > FOREST_SIGMA).sum())
    rms = np.sqrt(np.square(result.residuals.filter(like="_deg")).mean())
    residuals = "; ".join(
        f"{name} {rms[f'before_{name}_deg']:.4f} to {rms[f'after_{name}_deg']:.4f} deg" for name in ROTATION_NAMES
    )
    lines = {
        "Why?": " ".join(result.verdict.reasons),
        "What changed?": f"{significant} of {len(table)} parameters by more than three sigma, most of all {changes}.",
        "How large are the residuals (RMS)?": f"{residuals}.",
        "Do the data determine everything?": describe_observability(result),
        "What next?": recommend_next_step(result),
    }
    return {question: text for question, text in lines.items() if text}


def describe_observability(result: CalibrationResult) -> str:
    """Name the combinations that the data do not determine, or the worst-known one and the correlated pairs."""
    undetermined, ranges = result.observability.unobservable, result.plausible
    basis = ""
    if ranges is not None:
        basis = f" Plausible ranges: {ranges.G:g} in G and {ranges.bias_deg_h:.3g} deg/h in b ({ranges.reason})."
    if result.has_plausible_prior:
        basis += " They are the a-priori sigmas of this calibration."
    if not undetermined:
        values = result.observability.singular_values
        pairs = [f"{a} and {b}" for correlation, a, b in _rank_correlated_pairs(result) if correlation > TIGHT][:MOST_NAMES]
        correlated = f"; only combinations are known well of {', '.join(pairs)}" if pairs else ""
        return f"Yes: the worst combination is known {values[-1]:.0f} times better than its plausible range{correlated}.{basis}"
    descriptions = list(undetermined)
    if ranges is not None:
        for k, sigma in enumerate(result.unobservable_sigma):
            is_bias = undetermined[k].split()[1].startswith(BIAS_LETTERS)
            descriptions[k] += f" (1-sigma {np.rad2deg(sigma):.2g} deg/s)" if is_bias else f" (1-sigma {sigma:.2g})"
    return f"No. Not determined by the data, only by the prior: {'; '.join(descriptions)}.{basis}"


def recommend_next_step(result: CalibrationResult) -> str:
    """Recommend the next step after the result."""
    if result.warnings:
        return "Check how the recording was made and read; the reasons above name the suspects."
    if result.observability.unobservable:
        return "Fly a maneuver about the missing axis; gyrocal plan compares maneuvers for a scenario."
    steps = {
        "untested": "Add reference attitudes or intervals, so that something is left to check with.",
        "smaller": "State the noise of gyro and references as it is; gyrocal allan measures the gyro's.",
        "fits": "gyrocal predict propagates the attitude with the gyro and its covariance; held-out references can check it.",
    }
    unexplained = f"{describe_worst_residual(result)} gyrocal diagnose finds the effect that is not modelled, and its place."
    return steps.get(result.verdict.fit, unexplained.strip())


def describe_worst_residual(result: CalibrationResult) -> str:
    """Describe the largest residual after the calibration in sigmas; empty if it is small."""
    table = result.residuals
    normalised = np.column_stack([table[f"after_{name}_deg"] / table[f"sigma_{name}_deg"] for name in ROTATION_NAMES])
    row, axis = np.unravel_index(np.abs(normalised).argmax(), normalised.shape)
    if abs(normalised[row, axis]) < LARGE_SHARE:
        return ""
    entry = table.iloc[int(row)]
    position = f"{ROTATION_NAMES[axis]} of {entry['interval']} at t = {entry['t_s']:.1f} s"
    return f"Largest residual after the calibration: {normalised[row, axis]:.1f} sigma, {position}."


def list_remarks(result: CalibrationResult) -> list[str]:
    """List the remainder and the errors that the sigmas do not include, in sentences."""
    lines = [describe_remainder(result)]
    if len(result.solved_for) < len(result.sigma):
        lines.append(
            "The sigmas take the held parameters as exact. An error in them goes into those solved for, and where the rates "
            "hardly change no residual shows it."
        )
    held_s = result.options["held_s"]
    if held_s > 0:
        lines.append(f"The last rate was held over {held_s:g} s of missing samples; its error is not in the sigmas.")
    return [line for line in [*lines, describe_attenuation(result)] if line]


def describe_remainder(result: CalibrationResult) -> str:
    """Describe the sizes of a significant remainder, a sentence; empty without one."""
    remainder = result.remainder
    if remainder is None or not remainder.is_significant:
        return ""
    parts = []
    for values, form in (
        (remainder.gyro * DEG_H_PER_RAD_S, "rate errors of {} deg/h that last"),
        (np.rad2deg(remainder.reference), "reference errors of {} deg"),
    ):
        if values.any():
            parts.append(form.format(", ".join(tables.format_short(value) for value in values)))
    if remainder.delay_s > 0:
        parts.append(f"time tags that are off by {tables.format_short(remainder.delay_s * 1e3)} ms")
    parts.append(f"stated noise with {tables.format_short(remainder.noise_factor)} times its variance")
    return f"The remainder, 1-sigma about x, y, z: {'; '.join(parts)}."


def describe_attenuation(result: CalibrationResult) -> str:
    """State the expected error of G from noise in the rates, if it is notable against the sigmas; empty otherwise."""
    if result.attenuation is None:
        return ""
    sizes = np.abs(np.divide(result.attenuation, result.sigma, out=np.zeros(12), where=result.sigma > 0))  # in sigmas
    notable = [f"{NAMES[k]} {result.attenuation[k]:+.2g} ({sizes[k]:.1f} sigma)" for k in range(9) if sizes[k] > NOTABLE]
    if not notable:
        return ""
    return (
        "Expected error of G, because the body turns hardly more than the noise of the rates between references, which is in "
        f"the attitude, too: {', '.join(notable)}. Neither the values above nor their sigmas are corrected for it."
    )


def describe_import_noise(result: CalibrationResult, estimated: Sequence[str]) -> list[str]:
    """State the origin of the noise that the residuals do not fit, if an import estimated it."""
    if not estimated or result.verdict.fit in ("fits", "untested"):
        return []
    return [f"The import estimated this noise: {'; '.join(estimated)}. State what is known of it, see docs/import.md."]


# ---- tables and figures --------------------------------------------------------------------------------------------------


def build_parameter_table(result: CalibrationResult, truth: GyroParameters | None = None) -> pd.DataFrame:
    """Build the table of parameters as texts, each to two digits of its sigma; with the truth, their errors."""
    true_values = None if truth is None else select_parameter_space(result.parametrisation).vector(truth) * DEGREES
    widened = compute_sigma_with_remainder(result)
    rows, format_value = [], tables.format_to_sigma
    for k, row in enumerate(result.summary().to_dict("records")):
        sigma, solved = row["sigma"], row["solved"]
        line = {name: row[name] for name in ("parameter", "unit")}
        line |= {name: format_value(row[name], sigma if solved else 0.0) for name in ("initial", "calibrated")}
        line["sigma"] = format_value(sigma, sigma) if solved else "held"
        if widened is not None:  # the sigma that applies
            sigma = widened[k]
            line["sigma with remainder"] = format_value(sigma, sigma) if solved else ""
        line["correction"] = format_value(row["correction"], sigma) if solved else ""
        line["in sigma"] = f"{row['correction'] / sigma:.1f}" if solved else ""
        if result.undetermined:
            line["determined"] = "" if not solved else "no" if row["parameter"] in result.undetermined else "yes"
        if true_values is not None:
            error = row["calibrated"] - true_values[k]
            line |= {"error": format_value(error, sigma), "error in sigma": f"{error / sigma:.1f}" if solved else ""}
        rows.append(line)
    return pd.DataFrame(rows)


def compute_sigma_with_remainder(result: CalibrationResult) -> np.ndarray | None:
    """Compute (12,) sigmas with remainder in the parametrisation, biases in deg/s; None without a remainder."""
    if result.remainder is None or not result.remainder.is_significant:
        return None
    J = select_parameter_space(result.parametrisation).jacobian(result.parameters)
    inverse_times_P = np.linalg.solve(J, result.remainder.covariance)  # J⁻¹ P; the next line forms J⁻¹ P J⁻ᵀ
    return np.asarray(np.sqrt(np.maximum(np.diag(np.linalg.solve(J, inverse_times_P.T)), 0.0)) * DEGREES)


def _build_solved_table(result: CalibrationResult) -> pd.DataFrame:
    """Build the table of solved parameters in the units of the figures, with the recommended sigmas."""
    table, widened = result.summary(), compute_sigma_with_remainder(result)
    if widened is not None and result.recommended == WITH_REMAINDER:
        table["sigma"] = widened
    table = table.query("solved").copy()
    scales = [FIGURE_UNITS.get(unit, (unit, 1.0)) for unit in table["unit"]]
    table["unit"] = [unit for unit, _ in scales]
    for name in ("correction", "sigma"):
        table[name] = table[name].to_numpy(dtype=float) * np.array([factor for _, factor in scales])
    table["in_sigma"] = table["correction"] / table["sigma"]
    return table


def draw_forest(result: CalibrationResult) -> Figure:
    """Draw the corrections with their sigmas, a line a parameter, a panel a unit."""
    groups = list(_build_solved_table(result).groupby("unit", sort=False))
    panels = []
    for unit, part in groups:
        names, sigma = list(part["parameter"]), part["sigma"]
        panels.append(make_forest(names, part["correction"], FOREST_SIGMA * sigma, sigma, at=[0], x=f"correction ({unit})"))
    return draw_panels(*panels, size=(8.5, 0.3 * max(len(part) for _, part in groups) + 1.0))


def draw_residual_figure(result: CalibrationResult) -> Figure:
    """Draw the residuals before and after by axis, over the references, with two sigma of the covariance model."""
    table = result.residuals
    number = np.arange(len(table))
    is_first = table.groupby("interval", sort=False).ngroup().diff().to_numpy() > 0  # reference of an interval after the first
    edges = [float(k) - 0.5 for k in np.flatnonzero(is_first)] if is_first.sum() <= 24 else []
    panels = []
    for stage, colour, mark in (("before", RED, "o"), ("after", BLUE, "s")):
        for name in ROTATION_NAMES:
            sigma = table[f"sigma_{name}_deg"].to_numpy(dtype=float)
            lines = [
                Line(number, 0 * sigma, "", GREY, "-", -2 * sigma, 2 * sigma),
                Line(number, table[f"{stage}_{name}_deg"], stage, colour, mark, size=3.0),
            ]
            x = "reference" if stage == "after" else ""
            panels.append(make_curves(lines, x=x, y=f"{name} {stage} (deg)", at=edges))
    return draw_panels(*panels, size=(FIGURE_WIDTH_IN, 5.0), columns=len(ROTATION_NAMES))


def compute_correlations(result: CalibrationResult) -> pd.DataFrame:
    """Compute the correlation matrix of the solved parameters."""
    names = list(result.summary()["parameter"])
    solved = [names.index(name) for name in result.solved_for]
    covariance = result.own_covariance[np.ix_(solved, solved)]
    sigma = np.sqrt(np.diag(covariance))
    return pd.DataFrame(covariance / np.outer(sigma, sigma), list(result.solved_for), list(result.solved_for))


def _rank_correlated_pairs(result: CalibrationResult) -> list[tuple[float, str, str]]:
    """List |correlation| and names of each pair of parameters, the strongest first."""
    correlations = compute_correlations(result)
    names, values = [str(name) for name in correlations.index], np.abs(correlations.to_numpy(dtype=float))
    return sorted(((float(values[i, j]), names[i], names[j]) for i in range(len(names)) for j in range(i)), reverse=True)


# ---- change against a saved calibration ------------------------------------------------------------------------------------


def parse_limit(text: str) -> tuple[tuple[str, ...], float, str, float]:
    """Parse a limit such as "G_zz<50ppm", "misalignment<20arcsec" or "b_x<0.1deg/h".

    Returns the names of the parameters, the limit, its unit, and the factor from this unit to rad/s or a dimensionless number.
    Raises `InputError` if the text is no limit.
    """
    match = LIMIT_FORM.fullmatch(text)
    if match is None or not 0 < float(match[2]) < math.inf:
        raise InputError(f"--max-change {text}: give NAME<LIMIT with a positive limit and its unit, as in 'G_zz<50ppm'")
    names, unit = select(match[1]), match[3]
    for name in names:
        units = RATE_UNITS if name.startswith("b") else RATIO_UNITS if name in SCALE_FACTORS else RATIO_UNITS | ANGLE_UNITS
        if unit not in units:
            raise InputError(f"--max-change {text}: {unit} is no unit of {name}; its units are {', '.join(units)}")
    return names, float(match[2]), unit, units[unit]


def check_limits(change: CalibrationChange, max_sigma: float | None, max_change: Sequence[str]) -> list[Verdict]:
    """Check a change: each limit in a unit; and in sigmas each parameter alone, and all together by the same probability."""
    verdicts = []
    if max_sigma is not None:
        for name, moved in zip(NAMES, change.in_sigma, strict=True):
            failure = f"moved by {moved:.1f} sigma" if moved >= max_sigma else ""
            verdicts.append(Verdict(f"{name} < {max_sigma:g} sigma", failure))
        failure = f"χ² = {change.chi2:.1f} of {change.dof}" if change.p_value <= math.erfc(max_sigma / math.sqrt(2)) else ""
        verdicts.append(Verdict(f"all parameters together < {max_sigma:g} sigma", failure))
    size = dict(zip(NAMES, np.abs(change.difference), strict=True))
    for text in max_change:
        names, limit, unit, factor = parse_limit(text)
        violations = [f"{name} moved by {size[name] / factor:.4g} {unit}" for name in names if size[name] >= limit * factor]
        verdicts.append(Verdict(text.strip(), "; ".join(violations)))
    return verdicts


def build_change_section(change: CalibrationChange, file: str, verdicts: Sequence[Verdict]) -> Section:
    """Build the section of a change: by parameter, of all together, and the limits that are not met."""
    sigma = change.sigma * PPM_DEG_H
    columns: dict[str, Any] = {
        "parameter": NAMES,
        "unit": PPM_DEG_H_NAMES,
        "change": map(tables.format_to_sigma, change.difference * PPM_DEG_H, sigma),
        "sigma": [tables.format_to_sigma(value, value) if value else "held" for value in sigma],
        "in sigma": [f"{value:.1f}" for value in change.in_sigma],
    }
    basis = "The two recordings are taken as independent: the sigma of a change is √(σ₁² + σ₂²)."
    if change.is_same_recording:
        basis = "Both calibrate the same recording and share its noise: the sigmas are those of the saved calibration."
    text = f"{basis} All parameters together: χ² = {change.chi2:.1f} of {change.dof}, p = {change.p_value:.2g}."
    violations = [f"Not met: {verdict.name}: {verdict.failure}" for verdict in verdicts if verdict.failure]
    title = f"Change against {file}"
    return Section(title, [PageTable(pd.DataFrame(columns), (), title), text, violations])
