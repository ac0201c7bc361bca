"""Predicted attitudes with their covariance, about the body's axes and about those of a sensor.

A sensor whose true mounting is exp([m×]) M sees A_s = exp([m×]) M A. With the errors of A about the body's axes, and of m about
the sensor's, its prediction exp([m̂×]) M Â is off by M c + (m − m̂): the covariance is M cov(c) Mᵀ + M cov(c, m) + … + cov(m).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal import attitude
from gyrocal.calibration.parameters import GyroParameters
from gyrocal.calibration.trackers import MountingEstimate
from gyrocal.errors import InputError
from gyrocal.recording.parts import AttitudeSensor

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SensorPrediction:
    """What a sensor would show.

    Attributes
    ----------
    A : (k, 3, 3) inertial to sensor
    covariance : (k, 3, 3) of the errors about the sensor's axes, its mounting's included, rad²
    noise : (3,) 1-sigma of a reading of its own about its axes, rad
    """

    A: Array
    covariance: Array
    noise: Array

    @property
    def sigma(self) -> Array:
        """(k, 3) 1-sigma of the attitude about the sensor's axes, rad."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))

    @property
    def reading_sigma(self) -> Array:
        """(k, 3) 1-sigma of a reading less what is predicted of it, rad."""
        return np.asarray(np.hypot(self.sigma, self.noise))


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
    sensors, noise : of the references, where there are several, and (sensors, 3) 1-sigma of each about its own axes, rad
    mountings : misalignments of those whose mounting is estimated
    cross : (k, 3, q) covariance of the attitudes' errors with those of the misalignments, rad²
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
    sensors: tuple[AttitudeSensor, ...]
    noise: Array
    mountings: MountingEstimate
    cross: Array
    readings: Array

    @property
    def sigma(self) -> Array:
        """(k, 3) 1-sigma about each body axis, rad."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))

    def of_sensor(self, name: str) -> SensorPrediction:
        """Predict the readings of one sensor.

        Raises
        ------
        InputError
            There is none of that name.
        """
        names = [one.name for one in self.sensors]
        if name not in names:
            raise InputError(f"no attitude sensor {name}; there are {', '.join(names) or 'none that are named'}")
        M = self.sensors[names.index(name)].M
        A, covariance = M @ self.A, M @ self.covariance @ M.T
        if name in self.mountings.sensors:
            place = 3 * self.mountings.sensors.index(name)
            own = slice(place, place + 3)
            A = attitude.rotation_matrix(self.mountings.misalignment[own]) @ A
            both = M @ self.cross[:, :, own]
            covariance = covariance + both + both.transpose(0, 2, 1) + self.mountings.covariance[own, own]
        return SensorPrediction(A, np.asarray(covariance), self.noise[names.index(name)])
