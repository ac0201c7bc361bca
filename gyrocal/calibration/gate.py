"""Refusal of residuals that are too large to be linearised, with their place and size.

Rates in another unit, quaternions in another order or axes that are exchanged leave residuals of many tens of degrees, and a
linear correction of those would be a number that means nothing.
"""

from __future__ import annotations

import numpy as np

from gyrocal.arrays import Array
from gyrocal.errors import InputError
from gyrocal.recording import Recording
from gyrocal.rests import compare_rests, compute_speed, find_rests

LARGEST_RESIDUAL = float(np.deg2rad(30.0))  # far outside what one linearisation can correct; wrong units look like this

CHANGE_SHARE = 0.5  # of a residual: a change of the bias that turns as far is its cause
USUAL_REASONS = (
    "are the rates in deg/s, the quaternions scalar last and inertial to body, the a-priori G and bias right, "
    "and is the step or a held gap not too long?"
)


class LargeResidualError(InputError):
    """A residual is too large to be corrected by linearisation."""

    # recording, G (3, 3) and bias (3,) rad/s from which `gyrocal.importing.explain_refusal` finds a reading that fits
    start: tuple[Recording, Array, Array] | None = None

    def __init__(self, message: str, angle: float = np.inf, output: int = 0):
        super().__init__(message)
        self.angle = angle  # of the residual, rad; infinite where the rates cannot be propagated
        self.output = output  # its place among all


def check_residual_size(theta: Array) -> None:
    """Refuse residuals (m, 3), rad, if one is too large or not a number.

    A `LargeResidualError` for the largest of them.
    """
    angle = np.linalg.norm(theta, axis=1)
    angle = np.where(np.isfinite(angle), angle, np.inf)
    worst = int(np.argmax(angle))
    if angle[worst] > LARGEST_RESIDUAL:
        raise _build_error(float(angle[worst]), worst)


def build_refusal(
    error: LargeResidualError, recording: Recording, interval: str, t_s: float, G: Array, bias: Array
) -> LargeResidualError:
    """Build the error again with interval and time, and with the change of the bias between rests if that explains it.

    interval, t_s: name of the interval, and time of the reference attitude, s since the epoch
    G, bias: (3, 3), (3,) rad/s that the calibration starts from
    """
    gyro, references, where = recording.gyro, recording.attitudes, f"interval {interval}, t_s = {t_s}: "
    rates = gyro.rates @ G.T
    rests = find_rests(rates, gyro.sample_s, compute_speed(references.t_s, references.quaternions, gyro.t_s))
    text, change = compare_rests(gyro.t_s, rates, rests)
    start_s = next(candidate.start_s for candidate in recording.intervals if candidate.name == interval)
    if text and np.linalg.norm(change) * (t_s - start_s) > CHANGE_SHARE * error.angle:
        return _build_error(error.angle, error.output, where, f"the {text}; use intervals within which it is constant")
    refusal = _build_error(error.angle, error.output, where)
    refusal.start = recording, G, bias
    return refusal


def _build_error(angle: float, output: int, where: str = "", reason: str = USUAL_REASONS) -> LargeResidualError:
    text = f"{where}an attitude residual of {np.rad2deg(angle):.1f} deg is too large to linearise; {reason}"
    return LargeResidualError(text, angle, output)
