"""What ``gyrocal calibrate`` prints: the verdict, parameters, residuals, and remarks on them."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from rich.console import Console

from gyrocal.calibration.gyro_space import select_parameter_space
from gyrocal.calibration.observability import BIAS_LETTERS
from gyrocal.calibration.parameters import NAMES, GyroParameters
from gyrocal.calibration.problem import ROTATION_NAMES
from gyrocal.calibration.remainder_processes import DEG_H_PER_RAD_S
from gyrocal.calibration.result import DEGREES, CalibrationResult
from studies.report import tables

LARGE_SHARE = 4.0  # sigma of a single residual worth naming
SIGMA_WITH_REMAINDER = "sigma with remainder"  # column
NOTABLE = 0.3  # sigma of an expected error worth naming; it makes a sigma 4 % too small


def show(console: Console, result: CalibrationResult, truth: GyroParameters | None = None) -> None:
    """Print a result, its verdict first; with the truth, the errors too."""
    exact = result.options.get("iterations") is not None
    how = "converged" if result.converged else "as many as asked for" if exact else "NOT CONVERGED"
    count = len(result.corrections)
    for line in (result.verdict.summary, *result.verdict.reasons):
        console.print(line, highlight=False, markup=False)
    title = f"{result.recording}: {count} iteration(s), {how}; {result.psi} ψ, covariance {result.covariance_model}"
    tables.print_table(console, title, build_parameter_table(result, truth))
    shown = ["interval", "t_s"] + [f"{when}_{axis}_deg" for when in ("before", "after") for axis in ROTATION_NAMES]
    last = result.residuals[shown].groupby("interval", sort=False).tail(1)
    tables.print_table(console, "Residuals at the end of each interval", last.assign(t_s=[f"{t:.1f}" for t in last["t_s"]]))
    for line in [*list_remarks(result), *result.mounting.format_sentences()]:
        console.print(line, highlight=False, markup=False)


def build_parameter_table(result: CalibrationResult, truth: GyroParameters | None = None) -> pd.DataFrame:
    """Parameters as texts, each to two digits of its sigma."""
    summary = result.summary()
    known = None if truth is None else select_parameter_space(result.parametrisation).vector(truth) * DEGREES
    widened = compute_sigma_with_remainder(result)
    rows = []
    for k, row in summary.iterrows():
        sigma = row["sigma"]
        number = tables.format_to_sigma if row["solved"] else tables.format_plain
        line = {
            "parameter": row["parameter"],
            "unit": row["unit"],
            "initial": number(row["initial"], sigma),
            "calibrated": number(row["calibrated"], sigma),
            "sigma": number(sigma, sigma) if row["solved"] else "held",
        }
        if widened is not None:  # the sigma that applies
            sigma = widened[int(str(k))]
            line[SIGMA_WITH_REMAINDER] = number(sigma, sigma) if row["solved"] else ""
        line["correction"] = number(row["correction"], sigma) if row["solved"] else ""
        line["in sigma"] = f"{row['correction'] / sigma:.1f}" if row["solved"] else ""
        if result.undetermined:
            line["found"] = "" if not row["solved"] else "no" if row["parameter"] in result.undetermined else "yes"
        if known is not None:
            error = row["calibrated"] - known[int(str(k))]
            line["error"] = number(error, sigma)
            line["error in sigma"] = f"{error / sigma:.1f}" if row["solved"] else ""
        rows.append(line)
    return pd.DataFrame(rows)


def compute_sigma_with_remainder(result: CalibrationResult) -> np.ndarray | None:
    """(12,) sigmas with remainder of the parametrisation's parameters, biases in deg/s; None where they do not differ."""
    if result.remainder is None or not result.remainder.is_significant:
        return None
    J = select_parameter_space(result.parametrisation).jacobian(result.parameters)
    half = np.linalg.solve(J, result.remainder.covariance)
    return np.asarray(np.sqrt(np.maximum(np.diag(np.linalg.solve(J, half.T)), 0.0)) * DEGREES)


def describe_remainder(result: CalibrationResult) -> str:
    """Describe the sizes of a significant remainder, a sentence; empty without one."""
    found = result.remainder
    if found is None or not found.is_significant:
        return ""
    parts = []
    if found.gyro.any():
        parts.append(f"rate errors of {_format_by_axis(found.gyro * DEG_H_PER_RAD_S)} deg/h that last")
    if found.reference.any():
        parts.append(f"reference errors of {_format_by_axis(np.rad2deg(found.reference))} deg")
    if found.delay_s > 0:
        parts.append(f"time tags that are off by {_format_short(found.delay_s * 1e3)} ms")
    parts.append(f"stated noise with {_format_short(found.noise_factor)} times its variance")
    return f"The remainder, 1-sigma about x, y, z: {'; '.join(parts)}."


def _format_by_axis(values: np.ndarray) -> str:
    return ", ".join(_format_short(value) for value in values)


def _format_short(value: float) -> str:
    """Format a number to two digits."""
    return f"{float(f'{value:.2g}'):g}"


def list_remarks(result: CalibrationResult) -> list[str]:
    """List remarks beside the verdict: remainder, largest residual, and what the sigmas leave out, in sentences."""
    lines = [line for line in (describe_remainder(result), describe_worst_residual(result)) if line]
    if len(result.solved_for) < len(result.sigma):
        lines.append(
            "The sigmas take the held parameters as exact. An error in them goes into those solved for, and where the rates "
            "hardly change no residual shows it."
        )
    held = result.options["held_s"]
    if held > 0:
        lines.append(f"The last rate was held over {held:g} s of missing samples; its error is not in the sigmas.")
    lines += describe_attenuation(result)
    return lines + list_plausible_remarks(result)


def list_plausible_remarks(result: CalibrationResult) -> list[str]:
    """The gyro's grade with its plausible ranges, and the combinations that the data do not determine to within them."""
    ranges, free = result.plausible, result.observability.unobservable
    if ranges is None:
        return [f"Not determined by the data, only by the prior: {text}" for text in free]
    lines = [f"Plausible ranges: {ranges.G:g} in G and {ranges.bias_deg_h:.3g} deg/h in b ({ranges.reason})."]
    if result.has_plausible_prior:
        lines.append("These ranges are the a-priori sigmas of this calibration.")
    for text, sigma in zip(free, result.unobservable_sigma, strict=True):
        value = f"{np.rad2deg(sigma):.2g} deg/s" if text.split()[1].startswith(BIAS_LETTERS) else f"{sigma:.2g}"
        lines.append(f"Not determined by the data, only by the prior: {text} (1-sigma {value})")
    return lines


def describe_attenuation(result: CalibrationResult) -> list[str]:
    """Describe the expected error of G from noise in the rates, if it matters beside the sigmas."""
    if result.attenuation is None:
        return []
    share = np.divide(result.attenuation, result.sigma, out=np.zeros(12), where=result.sigma > 0)
    off = [k for k in range(9) if abs(share[k]) > NOTABLE]
    if not off:
        return []
    named = ", ".join(f"{NAMES[k]} {result.attenuation[k]:+.2g} ({abs(share[k]):.1f} sigma)" for k in off)
    return [
        "Expected error of G, since between references the body turns hardly more than the noise of the rates, which is in the "
        f"attitude, too: {named}. It is not taken off the values above, nor in their sigmas."
    ]


def describe_import_noise(result: CalibrationResult, estimated: Sequence[str]) -> list[str]:
    """Describe the origin of the noise that the residuals do not fit, if an import estimated it."""
    if not estimated or result.verdict.fit in ("fits", "untested"):
        return []
    return [f"The import estimated this noise: {'; '.join(estimated)}. State what is known of it, see docs/import.md."]


def describe_worst_residual(result: CalibrationResult) -> str:
    """The largest residual after in its own sigma, if it is large."""
    table = result.residuals
    normalised = np.column_stack([table[f"after_{name}_deg"] / table[f"sigma_{name}_deg"] for name in ROTATION_NAMES])
    row, axis = np.unravel_index(np.abs(normalised).argmax(), normalised.shape)
    if abs(normalised[row, axis]) < LARGE_SHARE:
        return ""
    entry = table.iloc[int(row)]
    return (
        f"Largest residual after the calibration: {normalised[row, axis]:.1f} sigma, {ROTATION_NAMES[axis]} of "
        f"{entry['interval']} at t = {entry['t_s']:.1f} s."
    )
