"""Verdict on a calibration: whether it may be believed, with which sigmas, and why.

Two tests ask whether the residuals fit the stated noise: the χ² of all of them, and the likelihood ratio of a remainder. The
second also sees errors that last while the size of the residuals is as stated. The residuals fit if neither test rejects.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from gyrocal.calibration.remainder_processes import WITH_REMAINDER

if TYPE_CHECKING:
    from gyrocal.calibration.result import CalibrationResult

Belief = Literal["yes", "with_wider_sigmas", "no", "unchecked"]
Fit = Literal["fits", "larger", "other_noise", "smaller", "untested"]

DOUBT = 0.01  # p-value below which the residuals are too large, and above one minus which too small
WEAK_TEST = 10  # degrees of freedom, below which χ² rejects large errors only
SMALLEST_P_VALUE = 1e-99  # p-value that is written out


@dataclass(frozen=True)
class CalibrationVerdict:
    """Verdict on a calibration.

    Attributes
    ----------
    belief : whether to believe the calibration; "unchecked" without degrees of freedom
    sigmas : "nominal" or "with_remainder", those that apply
    fit : residuals against the stated noise: "other_noise" if only a remainder is significant
    summary : what to use, a sentence
    reasons : a sentence or more each; exactly one is on the fit
    """

    belief: Belief
    sigmas: str
    fit: Fit
    summary: str
    reasons: tuple[str, ...]


def decide_verdict(result: CalibrationResult) -> CalibrationVerdict:
    """Decide from χ², the remainder, implausible values and convergence whether a calibration may be believed."""
    fit, warnings = classify_fit(result.dof, result.p_value, result.recommended == WITH_REMAINDER), result.warnings
    is_stuck = result.options.get("iterations") is None and not result.converged
    belief: Belief = "yes"
    summary = "Use the calibration with the nominal sigmas."
    if warnings or is_stuck or (fit == "larger" and result.recommended != WITH_REMAINDER):
        belief, summary = "no", "Do not use the calibration as it is."
    elif fit == "untested":
        belief, summary = "unchecked", "The calibration cannot be checked: its parameters use all residuals."
    elif result.recommended == WITH_REMAINDER:
        used = result.sigma > 0
        growth = np.sqrt(np.diag(result.recommended_covariance))[used] / result.sigma[used]
        low, high = (float(f"{one:.2g}") for one in (growth.min(), growth.max()))
        belief, summary = (
            "with_wider_sigmas",
            f"Use the sigmas with remainder: they are {low:g} to {high:g} times the nominal ones.",
        )
    reasons = [*warnings, *[f"It did not converge in {len(result.corrections)} iterations."] * is_stuck]
    reasons.append(describe_fit(result, fit))
    if free := len(result.observability.unobservable):
        reasons.append(f"{free} of {len(result.solved_for)} parameter combinations are not determined by the data.")
    return CalibrationVerdict(belief, result.recommended, fit, summary, tuple(reasons))


def classify_fit(dof: int, p_value: float, has_remainder: bool) -> Fit:
    """Classify residuals by the p-value of their χ² and by whether a remainder is significant."""
    if dof <= 0:
        return "untested"
    if not p_value >= DOUBT:
        return "larger"
    if has_remainder:
        return "other_noise"
    return "smaller" if p_value > 1 - DOUBT else "fits"


def describe_fit(result: CalibrationResult, fit: Fit) -> str:
    """Describe the residuals against the stated noise, and what to suspect where they do not fit it."""
    if fit == "untested":
        return "No degrees of freedom are left, so the residuals after the calibration say nothing about the fit."
    text = (
        f"Residuals after the calibration: χ² = {result.chi2:.1f} with {result.dof} degrees of freedom, "
        f"{format_p_value(result.p_value)}."
    )
    if fit == "fits":
        weak = ", but with so few degrees of freedom this is a weak test" if result.dof < WEAK_TEST else ""
        return f"{text} They fit the stated noise{weak}."
    if fit == "smaller":
        why = "it is stated too large (gyrocal diagnose says which noise), or the recording is noise-free"
        return f"{text} They are smaller than the stated noise: {why}."
    found, suspects = result.remainder, ", ".join(list_misfit_reasons(result))
    if found is None or not found.is_significant:
        return f"{text} They are larger than the stated noise allows: do not trust the sigmas. Suspect {suspects}."
    how = "are larger than the stated noise allows" if fit == "larger" else "do not fit the stated noise"
    return f"{text} They {how} (likelihood ratio of a remainder, {format_p_value(found.p_value)}). Suspect {suspects}."


def format_p_value(p: float) -> str:
    """Format a p-value; a tiny one as smaller than what is written out."""
    return f"p = {p:.2g}" if p > SMALLEST_P_VALUE else f"p < {SMALLEST_P_VALUE:g}"


def list_misfit_reasons(result: CalibrationResult) -> list[str]:
    """List possible reasons of a misfit, the choices of this run first."""
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
