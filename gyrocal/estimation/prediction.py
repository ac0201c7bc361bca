"""Predicted attitudes with their covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.parameters import GyroParameters

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction:
    """Attitudes by gyro, conditioned on references.

    Attributes
    ----------
    t_s : (k,) s since the epoch
    A : (k, 3, 3) inertial to body
    covariance : (k, 3, 3) of their errors about the body's axes, rad²
    parameters : G and b, estimated from the references
    parameter_covariance : (12, 12) G dimensionless, b rad/s
    used : references that were used
    chi2, dof : χ² of the innovations of these references (each against its prediction from the earlier ones), and their number
    readings : (k, 3, 3) covariance of a reference at each time less the prediction, with the reference's remainder and without
        its stated noise, rad²
    """

    t_s: Array
    A: Array
    covariance: Array
    parameters: GyroParameters
    parameter_covariance: Array
    used: int
    chi2: float
    dof: int
    readings: Array

    @property
    def sigma(self) -> Array:
        """(k, 3) 1-sigma about each body axis, rad."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))
