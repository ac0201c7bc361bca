"""In-flight gyro calibration: the Davenport scheme in transition-matrix form.

Papers
------
N : G. A. Natanson, "A Transition Matrix Approach to the Davenport Gyro Calibration Scheme", 1998.
R : B. Robertson et al., "On-Orbit Performance of the TRMM Mission Mode", 1999.

Conventions, everywhere in this project
---------------------------------------
Frames
    An attitude matrix A maps inertial components to body components; the LVLH frame has z to nadir, y against the orbit
    normal, x completing it (along the velocity of a circular orbit). x, y, z are also called roll, pitch, yaw.
Quaternions
    Inertial to body, scalar last, A(q) as in Wertz. scipy's `Rotation` is active: A(q) = Rotation.from_quat(q).inv().
Rates
    ω is the body's rate against inertial space in body axes, dA/dt = −[ω×] A, so A(t+Δt) = exp(−[ω×]Δt) A(t).
    Gyro equation, R (7): ω = G ω_raw + b; rows of G are body axes, columns gyros. +x forward flies at ω_y = −1 RPO.
Residual
    exp([θ×]) = A_obs A_propᵀ, N (16), and θ ≈ Θ Δx with Δx = x_adj − x_true: the correction is −Δx.
    N (29) as printed has the opposite sign; the linear form here has that of N (16).
Units
    SI and radians inside; degrees, deg/s and the like only at the edges (files, tables, figures), with the unit in the name.
    ARW is a root PSD: a sample's rate noise is arw / sqrt(sample_s).
Symbols
    G, b (bias), ω (omega), ψ (psi), R, Θ (Theta, the upper three rows of Φ̃), F, W, u, P, C as in N. V is the joint covariance
    of residuals that correlate.
"""

import logging as _logging
from importlib.metadata import version as _version

from gyrocal.calibration.davenport import RecursiveCalibrator, calibrate, residual_table
from gyrocal.calibration.gyros import GyroArray, GyrosResult, calibrate_gyros
from gyrocal.calibration.observability import Observability
from gyrocal.calibration.parameters import NAMES, GyroParameters, select
from gyrocal.calibration.propagation import Arcs, StreamingPropagation, propagate, psi_matrix
from gyrocal.calibration.result import CalibrationResult
from gyrocal.errors import GyrocalError, InputError, UnobservableError
from gyrocal.estimation.batch import BatchResult, batch
from gyrocal.estimation.filter_run import FilterRun
from gyrocal.estimation.filter_run import run as run_filter
from gyrocal.estimation.full_filter import FullFilterResult, Leg
from gyrocal.estimation.full_filter import run_legs as run_full_filter
from gyrocal.estimation.mekf import KalmanFilter
from gyrocal.estimation.onboard import Maneuver, OnBoardCalibrator
from gyrocal.estimation.onboard import replay as run_on_board
from gyrocal.estimation.reference_covariance import interval_covariance, reference_attitudes, residual_covariance
from gyrocal.estimation.smoother import Smoothed, smooth
from gyrocal.recording import (
    Attitudes,
    AttitudeSensor,
    GyroStream,
    Interval,
    Orbit,
    Recording,
    load,
    of_sensor,
    save,
    triad,
)
from gyrocal.sensors.alignment import AlignmentResult
from gyrocal.sensors.alignment import in_two_steps as align_in_two_steps
from gyrocal.sensors.alignment import together as align_together
from gyrocal.sensors.earth import EarthModel, EarthSensor
from gyrocal.sensors.series import SensorModel, SensorSeries
from gyrocal.sensors.sun import SunModel, SunSensor, trmm_sun_sensors

__version__ = _version("gyrocal")
_logging.getLogger("gyrocal").addHandler(_logging.NullHandler())  # a library is silent until its user listens

__all__ = [
    "NAMES",
    "AlignmentResult",
    "Arcs",
    "AttitudeSensor",
    "Attitudes",
    "BatchResult",
    "CalibrationResult",
    "EarthModel",
    "EarthSensor",
    "FilterRun",
    "FullFilterResult",
    "GyroArray",
    "GyroParameters",
    "GyroStream",
    "GyrocalError",
    "GyrosResult",
    "InputError",
    "Interval",
    "KalmanFilter",
    "Leg",
    "Maneuver",
    "Observability",
    "OnBoardCalibrator",
    "Orbit",
    "Recording",
    "RecursiveCalibrator",
    "SensorModel",
    "SensorSeries",
    "Smoothed",
    "StreamingPropagation",
    "SunModel",
    "SunSensor",
    "UnobservableError",
    "__version__",
    "align_in_two_steps",
    "align_together",
    "batch",
    "calibrate",
    "calibrate_gyros",
    "interval_covariance",
    "load",
    "of_sensor",
    "propagate",
    "psi_matrix",
    "reference_attitudes",
    "residual_covariance",
    "residual_table",
    "run_filter",
    "run_full_filter",
    "run_on_board",
    "save",
    "select",
    "smooth",
    "triad",
    "trmm_sun_sensors",
]
