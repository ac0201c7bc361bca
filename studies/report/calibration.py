"""What ``gyrocal calibrate`` prints: parameters, residuals, and what speaks for and against believing them."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from rich.console import Console

from gyrocal.calibration.gyro_space import select_parameter_space
from gyrocal.calibration.observability import BIAS_LETTERS
from gyrocal.calibration.parameters import NAMES, GyroParameters
from gyrocal.calibration.problem import ROTATION_NAMES
from gyrocal.calibration.remainder_processes import DEG_H_PER_RAD_S, WITH_REMAINDER
from gyrocal.calibration.result import DEGREES, CalibrationResult
from gyrocal.recording import Recording
from studies.report import tables

LARGEST_SCALE = 1.5  # of a gyro's scale factor against the one stated: a data sheet allows a few percent
LARGEST_TURN_DEG = 30.0
LARGEST_BIAS_SHARE = 0.5  # of the RMS rate
DOUBT = 0.01  # p-value below which the fit is called bad, and above one minus which too good
LARGE_SHARE = 4.0  # sigma of a single residual worth naming
SMALLEST_P_VALUE = 1e-99  # p-value that is written out
SIGMA_WITH_REMAINDER = "sigma with remainder"  # column
NOTABLE = 0.3  # sigma of an expected error worth naming; it makes a sigma 4 % too small


def show(console: Console, result: CalibrationResult, to_tolerance: bool, truth: GyroParameters | None = None) -> None:
    """Print a result; with the truth, the errors too."""
    how = "converged" if result.converged else "NOT CONVERGED" if to_tolerance else "as many as asked for"
    count = len(result.corrections)
    for line in result.warnings:
        console.print(f"Warning: {line}", highlight=False, markup=False)
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
            "correction": number(row["correction"], sigma) if row["solved"] else "",
            "in sigma": f"{row['correction'] / sigma:.1f}" if row["solved"] else "",
        }
        if widened is not None:
            line[SIGMA_WITH_REMAINDER] = number(widened[int(str(k))], widened[int(str(k))]) if row["solved"] else ""
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


def recommend_sigmas(result: CalibrationResult) -> list[str]:
    """Which sigmas are recommended and why, in sentences; empty where no remainder was estimated."""
    found = result.remainder
    if found is None:
        return []
    if not found.is_significant:
        return [f"Use the nominal sigmas: a remainder beside the stated noise is not significant (p = {found.p_value:.2g})."]
    used = result.sigma > 0
    growth = found.sigma[used] / result.sigma[used]
    parts = []
    if found.gyro.any():
        parts.append(f"rate errors of {_format_by_axis(found.gyro * DEG_H_PER_RAD_S)} deg/h that last")
    if found.reference.any():
        parts.append(f"reference errors of {_format_by_axis(np.rad2deg(found.reference))} deg")
    if found.delay_s > 0:
        parts.append(f"time tags that are off by {_format_short(found.delay_s * 1e3)} ms")
    parts.append(f"stated noise with {_format_short(found.noise_factor)} times its variance")
    probable = f"p = {found.p_value:.2g}" if found.p_value > SMALLEST_P_VALUE else f"p < {SMALLEST_P_VALUE:g}"
    return [
        f"Use the sigmas with remainder: the residuals do not fit the stated noise (likelihood ratio, {probable}). They are "
        f"{_format_short(growth.min())} to {_format_short(growth.max())} times the nominal ones.",
        f"The remainder, 1-sigma about x, y, z: {'; '.join(parts)}.",
    ]


def _format_by_axis(values: np.ndarray) -> str:
    return ", ".join(_format_short(value) for value in values)


def _format_short(value: float) -> str:
    """Format a number to two digits."""
    return f"{float(f'{value:.2g}'):g}"


def list_remarks(result: CalibrationResult) -> list[str]:
    """List the evidence for and against the result, in sentences."""
    lines = [describe_fit(result), *recommend_sigmas(result)]
    worst = describe_worst_residual(result)
    if worst:
        lines.append(worst)
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


def list_implausible(result: CalibrationResult, recording: Recording) -> list[str]:
    """Values that no gyro has, and that a wrong unit, order or time is likelier to make, a sentence each."""
    out = []
    change = result.parameters.G @ np.linalg.pinv(recording.gyro.apriori_G)
    determinant = float(np.linalg.det(change))
    scale = float(np.cbrt(determinant))
    if not 1 / LARGEST_SCALE <= scale <= LARGEST_SCALE:
        out.append(
            f"the scale factor of the gyro is {scale:.3g} times the one stated: is its unit, range or clock another one?"
        )
    U, _, Vt = np.linalg.svd(change)
    turn = U @ np.diag([1.0, 1.0, float(np.linalg.det(U @ Vt))]) @ Vt
    angle = float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1.0, 1.0))))
    if angle > LARGEST_TURN_DEG or determinant < 0:
        out.append(
            f"the gyro's frame is turned by {angle:.0f} deg from the one stated: "
            "is the order or sign of its axes, or the direction of the attitudes, another one?"
        )
    gyro = recording.gyro
    rates = gyro.rates @ gyro.apriori_G.T + gyro.apriori_bias
    speed = float(np.sqrt(np.mean(np.sum(np.square(rates), axis=1))))
    off = float(np.linalg.norm(result.parameters.bias - gyro.apriori_bias))
    if gyro.apriori_bias.any() and off > LARGEST_BIAS_SHARE * speed:
        out.append(
            f"the bias is {np.rad2deg(off):.3g} deg/s off the one stated, which is that of the rests if the import found it; "
            f"the RMS rate is {np.rad2deg(speed):.3g} deg/s"
        )
    return out


def list_plausible_remarks(result: CalibrationResult) -> list[str]:
    """The gyro's grade with its plausible ranges, and the combinations that the data do not determine to within them."""
    ranges, free = result.plausible, result.observability.unobservable
    if ranges is None:
        return [f"Not determined by the data, only by the prior: {text}" for text in free]
    lines = [f"Plausible ranges: {ranges.G:g} in G and {ranges.bias_deg_h:.3g} deg/h in b ({ranges.reason})."]
    if result.has_plausible_prior:
        lines.append(
            f"The data do not determine {len(free)} of {len(result.solved_for)} parameter combinations to within these ranges. "
            "The ranges are the a-priori sigmas of this calibration."
        )
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


def describe_fit(result: CalibrationResult) -> str:
    """Whether what is left fits the stated noise, and what to suspect if not."""
    if result.dof <= 0:
        return "No degrees of freedom are left, so the residuals after the calibration say nothing about the fit."
    text = (
        f"Residuals after the calibration: χ² = {result.chi2:.1f} with {result.dof} degrees of freedom, "
        f"p = {result.p_value:.2g}."
    )
    if result.p_value < DOUBT:
        doubtful = ", ".join(list_misfit_reasons(result))
        trust = "" if result.recommended == WITH_REMAINDER else ": do not trust the sigmas"
        return f"{text} They are larger than the stated noise allows{trust}. Suspect {doubtful}."
    if result.p_value > 1 - DOUBT:
        why = "it is stated too large (gyrocal diagnose says which noise), or the recording is noise-free"
        return f"{text} They are smaller than the stated noise: {why}."
    if result.dof < 10:
        return f"{text} They fit the stated noise, but with so few degrees of freedom this is a weak test."
    return f"{text} They fit the stated noise."


def describe_import_noise(result: CalibrationResult, estimated: Sequence[str]) -> list[str]:
    """Describe the origin of the noise that the residuals do not fit, if an import estimated it."""
    if not estimated or result.dof <= 0 or DOUBT <= result.p_value <= 1 - DOUBT:
        return []
    return [f"The import estimated this noise: {'; '.join(estimated)}. State what is known of it, see docs/import.md."]


def list_misfit_reasons(result: CalibrationResult) -> list[str]:
    """List possible reasons of too large residuals, the choices of this run first."""
    out = []
    if result.options["prior_sigma"] is not None and not result.has_plausible_prior:
        out.append("a prior that is too tight")
    if len(result.solved_for) < len(result.sigma):
        out.append("wrong values of the held parameters")
    if result.options["held_s"] > 0:
        out.append("the held gaps")
    if not result.converged:
        out.append("too few iterations")
    if result.covariance_model == "references only":
        out.append("gyro noise, which this covariance leaves out")
    out += ["sigmas or ARW stated too small", "gyro time tags (a sample is tagged at its start)", "a bad reference attitude"]
    return [*out, "an effect that is not modelled (gyrocal diagnose looks for one)"]


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
