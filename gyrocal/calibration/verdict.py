"""Verdict on a calibration: whether it may be believed, with which sigmas, and why.

Two tests ask whether the residuals fit the stated noise: the χ² of all of them, and the likelihood ratio of a remainder. The
second also detects errors that persist in time, even if the residuals are as large as stated. The residuals fit if neither
test rejects.

A calibration whose tables are read wrongly may still converge. Its values then are what no gyro of its grade has, and the
reader must learn of it before anything else.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from gyrocal.arrays import Array
from gyrocal.calibration.mounting import Mounting
from gyrocal.calibration.observability import evaluate_observability, list_combinations
from gyrocal.calibration.plausible_ranges import PlausibleRanges
from gyrocal.calibration.remainder_processes import WITH_REMAINDER

if TYPE_CHECKING:
    from gyrocal.calibration.result import CalibrationResult

Belief = Literal["yes", "with_wider_sigmas", "no", "unchecked"]
Fit = Literal["fits", "larger", "other_noise", "smaller", "untested"]

DOUBT = 0.01  # p-value below which the residuals are too large, and above one minus which too small
WEAK_TEST = 10  # degrees of freedom, below which χ² rejects large errors only
SMALLEST_P_VALUE = 1e-99  # p-value that is written out
SIGNIFICANT_SCALE = 3.0  # sigma, beyond which the data show a scale error
LARGEST_SCALE_ERROR = 0.1  # MEMS data sheets state sensitivities to 3 to 6 %
LARGEST_ROTATION = np.deg2rad(10.0)  # from the stated mounting; beyond it, axes are not mounted as assumed
LARGEST_BIAS = 3.0  # plausible ranges of the grade
REST_RANGES = 0.1  # plausible ranges, by which b may be off the rests
IMPLAUSIBLE_REST_SIGMAS = 5.0


@dataclass(frozen=True)
class CalibrationVerdict:
    """Verdict on a calibration."""

    belief: Belief  # whether to believe it; "unchecked" without degrees of freedom
    sigmas: str  # "nominal" or "with_remainder", those that apply
    fit: Fit  # residuals against the stated noise: "other_noise" if only a remainder is significant
    summary: str  # what to use, a sentence
    reasons: tuple[str, ...]  # a sentence or more each; exactly one is on the fit


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
        estimated = result.sigma > 0
        growth = np.sqrt(np.diag(result.recommended_covariance))[estimated] / result.sigma[estimated]
        low, high = (float(f"{factor:.2g}") for factor in (growth.min(), growth.max()))
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
        cause = "it is stated too large (gyrocal diagnose says which noise), or the recording is noise-free"
        return f"{text} They are smaller than the stated noise: {cause}."
    remainder, suspects = result.remainder, ", ".join(list_misfit_reasons(result))
    if remainder is None or not remainder.is_significant:
        return f"{text} They are larger than the stated noise allows: do not trust the sigmas. Suspect {suspects}."
    finding = "are larger than the stated noise allows" if fit == "larger" else "do not fit the stated noise"
    return f"{text} They {finding} (likelihood ratio of a remainder, {format_p_value(remainder.p_value)}). Suspect {suspects}."


def format_p_value(p: float) -> str:
    """Format a p-value; a tiny one as below the smallest that is written out."""
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


def find_implausible_values(
    mounting: Mounting, G: Array, bias: Array, sigma_bias: Array, plausible: PlausibleRanges
) -> Iterator[str]:
    """Find values that no gyro of this grade has: a sentence each, with what to check.

    mounting, G: (3, 3) calibrated G, and its decomposition
    bias, sigma_bias: (3,) calibrated b and its 1-sigma, rad/s
    """
    scale, sigma = np.diag(mounting.S), np.diag(mounting.sigma_S)
    implausible = [k for k in range(3) if abs(scale[k] - 1) > max(LARGEST_SCALE_ERROR, SIGNIFICANT_SCALE * sigma[k])]
    if implausible:
        listed = ", ".join(f"{'xyz'[k]} {scale[k]:.4g} ± {sigma[k]:.1g}" for k in implausible)
        yield (
            f"The scale factor of {listed} is off by more than {100 * LARGEST_SCALE_ERROR:.0f} %. "
            "Check the unit of the rates and the size of a count (--lsb)."
        )
    if mounting.change > LARGEST_ROTATION:
        yield (
            f"The gyro is mounted {np.rad2deg(mounting.change):.3g} deg away from the stated axes. "
            "Check the order and signs of the axes and the direction of the attitudes, or import with --mounting estimate."
        )
    worst = int(np.argmax(np.abs(bias)))
    ratio = abs(bias[worst]) / plausible.bias
    if ratio > LARGEST_BIAS:
        yield (
            f"The bias b_{'xyz'[worst]} of {np.rad2deg(bias[worst]):.4g} deg/s is {ratio:.3g} times the plausible range of the "
            f"{plausible.grade} grade ({plausible.bias_deg_h:.3g} deg/h). "
            "Check whether the readings have an offset of their own."
        )
    if plausible.rest is None:
        return
    error = bias - plausible.rest.bias(G)
    allowed = np.maximum(REST_RANGES * plausible.bias, IMPLAUSIBLE_REST_SIGMAS * np.hypot(sigma_bias, plausible.rest.sigma))
    worst = int(np.argmax(np.abs(error) / allowed))
    if abs(error[worst]) > allowed[worst]:
        yield (
            f"The bias b_{'xyz'[worst]} is {np.rad2deg(error[worst]):.3g} deg/s off the bias in the rests. "
            "Check the time tags, and whether the reference attitudes are good while the body moves."
        )


def find_combinations_lost_to_misfit(
    covariance: Array, ranges: Array, names: tuple[str, ...], chi2: float, dof: int
) -> tuple[str, ...]:
    """Find combinations whose sigma exceeds the plausible range once it is widened by the size of the residuals.

    Residuals that exceed the stated noise widen all sigmas by sqrt(χ²/dof) at least (the Birge ratio).

    Returns one sentence, or nothing.

    covariance: (p, p) of the solved-for parameters by the stated noise, without a prior
    ranges: (p,) plausible range of each
    chi2, dof: of the residuals after the calibration
    """
    if dof <= 0 or chi2 <= dof:
        return ()
    widening = float(np.sqrt(chi2 / dof))
    scaled = covariance / np.outer(ranges, ranges)
    values, directions = np.linalg.eigh(scaled)
    whitened = directions.T / (np.sqrt(np.maximum(values, np.finfo(float).tiny))[:, None] * widening)
    lost = evaluate_observability(whitened / ranges, ranges, names).unobservable
    if not lost:
        return ()
    return (
        f"With sigmas wider by √(χ²/dof) = {widening:.3g}, {len(lost)} of {len(names)} parameter combinations are not "
        f"determined to within their plausible ranges: {list_combinations(lost)}. Do not use their values.",
    )
