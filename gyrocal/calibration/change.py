"""Change of a calibration against a saved one: of each parameter in its sigma, and of all together as a χ².

With the errors of two recordings independent, the change d = x₂ − x₁ has the covariance V = P₁ + P₂, and dᵀ V⁻¹ d is χ²
distributed with as many degrees of freedom as parameters. Two calibrations of one recording have its noise in common. Their
change has no statistical error, and V = P₁ makes it a multiple of the uncertainty that the saved calibration states.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.special

from gyrocal.arrays import Array
from gyrocal.calibration.parameters import NAMES, GyroParameters
from gyrocal.errors import InputError

SMALLEST_EIGENVALUE = 1e-12  # of a correlation matrix; smaller ones are rounding of a combination that is held


@dataclass(frozen=True)
class CalibrationChange:
    """Change of G and b between two calibrations."""

    # difference, sigma: (12,) in the order of `gyrocal.NAMES`, b in rad/s; sigma is zero for held parameters
    difference: Array
    sigma: Array
    # chi2, dof: of the difference of all solved-for parameters
    chi2: float
    dof: int
    is_same_recording: bool  # whether both calibrate one recording

    @property
    def in_sigma(self) -> Array:
        """(12,) size of each difference in its sigma; infinite for a held parameter with another value."""
        size = np.abs(self.difference)
        return np.divide(size, self.sigma, out=np.where(size > 0, np.inf, 0.0), where=self.sigma > 0)

    @property
    def p_value(self) -> float:
        """Probability of a larger chi2 of two independent calibrations of one gyro."""
        return float(scipy.special.chdtrc(self.dof, self.chi2))


def compute_change(
    saved: GyroParameters, saved_covariance: Array, new: GyroParameters, new_covariance: Array, is_same_recording: bool
) -> CalibrationChange:
    """Compute the change from a saved calibration to a new one.

    saved, new: G and b
    saved_covariance, new_covariance: (12, 12) of G and b in the order of `gyrocal.NAMES`, b in rad/s; zero for held ones
    is_same_recording: whether both calibrate one recording

    An `InputError` if a parameter is solved for in one of them and held in the other.
    """
    solved = np.diag(saved_covariance) > 0
    is_changed = solved != (np.diag(new_covariance) > 0)
    if is_changed.any():
        names = ", ".join(name for name, differs in zip(NAMES, is_changed, strict=True) if differs)
        raise InputError(f"solved for in only one of the saved and this calibration: {names}; use the same --solve-for")
    difference = new.vector - saved.vector
    covariance = saved_covariance if is_same_recording else saved_covariance + new_covariance
    sigma = np.sqrt(np.diag(covariance))
    values, directions = np.linalg.eigh(covariance[np.ix_(solved, solved)] / np.outer(sigma[solved], sigma[solved]))
    regular = values > SMALLEST_EIGENVALUE
    whitened = (directions[:, regular].T @ (difference[solved] / sigma[solved])) / np.sqrt(values[regular])
    return CalibrationChange(difference, sigma, float(whitened @ whitened), int(regular.sum()), is_same_recording)
