"""What ``gyrocal calibrate`` prints of more gyros than three: each gyro, residuals, parity, and whether to believe them."""

from __future__ import annotations

import numpy as np
import pandas as pd
from rich.console import Console

from gyrocal import GyroArray, GyrosResult
from studies.report import tables

DOUBT = 0.01  # p-value below which residuals do not fit the stated noise
PARAMETER_UNITS = (
    ("scale factor", "1", 1.0),
    *((f"misalignment {axis}", "deg", 1.0) for axis in "xyz"),
    ("bias", "deg/s", 1.0),
)


def show(console: Console, result: GyrosResult, truth: GyroArray | None = None) -> None:
    """Print a result; with the truth, the errors too."""
    how = "converged" if result.converged else "NOT CONVERGED"
    title = f"{result.recording}: {result.iterations} iteration(s), {how}; {result.psi} ψ"
    tables.print_table(console, title, build_gyro_table(result, truth))
    shown = ["interval", "t_s"] + [f"{when}_{axis}_deg" for when in ("before", "after") for axis in ("roll", "pitch", "yaw")]
    last = result.residuals[shown].groupby("interval", sort=False).tail(1)
    tables.print_table(console, "Residuals at the end of each interval", last.assign(t_s=[f"{t:.1f}" for t in last["t_s"]]))
    for line in list_remarks(result):
        console.print(line, highlight=False, markup=False)


def build_gyro_table(result: GyrosResult, truth: GyroArray | None = None) -> pd.DataFrame:
    """A row a number, each to two digits of its sigma; misalignments are turns from the a-priori axis."""
    summary = result.summary()
    known = None if truth is None else summarise_gyros(truth, result.initial)
    rows = []
    for i, row in summary.iterrows():
        for value, sigma, (what, unit, _) in zip(row[1::2], row[2::2], PARAMETER_UNITS, strict=True):
            line = {"gyro": row["gyro"], "parameter": what, "unit": unit, "calibrated": tables.format_to_sigma(value, sigma)}
            line["sigma"] = tables.format_to_sigma(sigma, sigma)
            if known is not None:
                error = value - known[int(str(i))][[name for name, _, _ in PARAMETER_UNITS].index(what)]
                line |= {"error": tables.format_to_sigma(error, sigma), "error in sigma": f"{error / sigma:.1f}"}
            rows.append(line)
    return pd.DataFrame(rows)


def summarise_gyros(gyros: GyroArray, before: GyroArray) -> list[list[float]]:
    """Scale factor, turn from the a-priori axis, deg, and bias, deg/s, of each gyro."""
    turn = np.rad2deg(gyros.axes - before.axes)
    return np.column_stack([gyros.scale_factor, turn, np.rad2deg(gyros.c)]).tolist()


def list_remarks(result: GyrosResult) -> list[str]:
    """List the evidence for and against the result, in sentences."""
    lines = []
    for what, chi2, dof, p in (
        ("Attitude residuals and parity together", result.chi2, result.dof, result.p_value),
        ("Parity of the gyros alone", result.parity_chi2, result.parity_dof, result.parity_p_value),
    ):
        if dof <= 0:
            lines.append(f"{what}: no degrees of freedom are left")
            continue
        text = f"{what}: χ² = {chi2:.1f} with {dof} degrees of freedom, p = {p:.2g}"
        lines.append(f"{text}; {_judge_p_value(p)}.")
    if result.plausible is not None:
        ranges = result.plausible
        lines.append(f"Plausible ranges: {ranges.G:g} in K and {ranges.bias_deg_h:.3g} deg/h in c ({ranges.reason}).")
    if result.prior_from == "plausible ranges":
        lines.append("The data do not determine all parameters: the ranges are the a-priori sigmas of this calibration.")
    return lines + [f"Not determined by the data, only by the prior: {text}" for text in result.observability.unobservable]


def _judge_p_value(p: float) -> str:
    if p < DOUBT:
        return "larger than the stated noise allows: do not trust the sigmas; gyrocal diagnose may say why"
    return "smaller than the stated noise, which is stated too large" if p > 1 - DOUBT else "they fit the stated noise"
