"""Values of a calibration that no gyro of its grade has, in sentences.

A calibration whose tables are read wrongly may still converge. Its values then are what no gyro has, and the reader must learn
of it before anything else.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.mounting import Mounting
from gyrocal.calibration.observability import evaluate_observability, list_combinations
from gyrocal.calibration.plausible_ranges import PlausibleRanges

Array = NDArray[np.float64]

SIGNIFICANT_SCALE = 3.0  # sigma, beyond which a scale error is the data's and not of what they leave open
LARGEST_SCALE_ERROR = 0.1  # MEMS data sheets state sensitivities to 3 to 6 %
LARGEST_ROTATION = np.deg2rad(10.0)  # from the stated mounting; beyond it, axes are not mounted as assumed
LARGEST_BIAS = 3.0  # plausible ranges of the grade
REST_RANGES = 0.1  # plausible ranges, by which b may be off the rests
IMPLAUSIBLE_REST_SIGMAS = 5.0


def find_implausible_values(
    mounting: Mounting, G: Array, bias: Array, sigma_bias: Array, plausible: PlausibleRanges
) -> tuple[str, ...]:
    """Find values that no gyro of this grade has.

    Returns a sentence each: the value, and what to check.

    Parameters
    ----------
    mounting : of G
    G : (3, 3) calibrated
    bias, sigma_bias : (3,) calibrated b and its 1-sigma, rad/s
    plausible : grade, ranges, and mean rates over the rests
    """
    return (
        *_find_scale_errors(mounting),
        *_find_rotation(mounting),
        *_find_large_bias(bias, plausible),
        *_find_bias_off_rests(G, bias, sigma_bias, plausible),
    )


def find_combinations_lost_to_misfit(
    covariance: Array, ranges: Array, names: tuple[str, ...], chi2: float, dof: int
) -> tuple[str, ...]:
    """Find combinations whose sigma exceeds the plausible range once it is widened by the size of the residuals.

    Residuals that exceed the stated noise widen all sigmas by sqrt(χ²/dof) at least (the Birge ratio).

    Returns one sentence, or nothing.

    Parameters
    ----------
    covariance : (p, p) of the solved-for parameters by the stated noise, without a prior
    ranges : (p,) plausible range of each
    names : of them
    chi2, dof : of the residuals after the calibration
    """
    if dof <= 0 or chi2 <= dof:
        return ()
    wider = float(np.sqrt(chi2 / dof))
    scaled = covariance / np.outer(ranges, ranges)
    values, directions = np.linalg.eigh(scaled)
    whitened = directions.T / (np.sqrt(np.maximum(values, np.finfo(float).tiny))[:, None] * wider)
    lost = evaluate_observability(whitened / ranges, ranges, names).unobservable
    if not lost:
        return ()
    return (
        f"With sigmas wider by √(χ²/dof) = {wider:.3g}, {len(lost)} of {len(names)} parameter combinations are not determined "
        "to within their plausible ranges: "
        f"{list_combinations(lost)}. Do not use their values.",
    )


def _find_scale_errors(mounting: Mounting) -> list[str]:
    scale, sigma = np.diag(mounting.S), np.diag(mounting.sigma_S)
    off = [k for k in range(3) if abs(scale[k] - 1) > max(LARGEST_SCALE_ERROR, SIGNIFICANT_SCALE * sigma[k])]
    if not off:
        return []
    named = ", ".join(f"{'xyz'[k]} {scale[k]:.4g} ± {mounting.sigma_S[k, k]:.1g}" for k in off)
    return [
        f"The scale factor of {named} is off by more than {100 * LARGEST_SCALE_ERROR:.0f} %. "
        "Check the unit of the rates and the size of a count (--lsb)."
    ]


def _find_rotation(mounting: Mounting) -> list[str]:
    if mounting.change <= LARGEST_ROTATION:
        return []
    return [
        f"The gyro is mounted {np.rad2deg(mounting.change):.3g} deg away from the stated axes. "
        "Check the order and signs of the axes and the direction of the attitudes, or import with --mounting estimate."
    ]


def _find_large_bias(bias: Array, plausible: PlausibleRanges) -> list[str]:
    worst = int(np.argmax(np.abs(bias)))
    times = abs(bias[worst]) / plausible.bias
    if times <= LARGEST_BIAS:
        return []
    return [
        f"The bias b_{'xyz'[worst]} of {np.rad2deg(bias[worst]):.4g} deg/s is {times:.3g} times the plausible range of the "
        f"{plausible.grade} grade ({plausible.bias_deg_h:.3g} deg/h). Check whether the readings have an offset of their own."
    ]


def _find_bias_off_rests(G: Array, bias: Array, sigma_bias: Array, plausible: PlausibleRanges) -> list[str]:
    if plausible.rest is None:
        return []
    off = bias - plausible.rest.bias(G)
    allowed = np.maximum(REST_RANGES * plausible.bias, IMPLAUSIBLE_REST_SIGMAS * np.hypot(sigma_bias, plausible.rest.sigma))
    worst = int(np.argmax(np.abs(off) / allowed))
    if abs(off[worst]) <= allowed[worst]:
        return []
    return [
        f"The bias b_{'xyz'[worst]} is {np.rad2deg(off[worst]):.3g} deg/s off the bias in the rests. "
        "Check the time tags, and whether the reference attitudes are good while the body moves."
    ]
