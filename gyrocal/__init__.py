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

from importlib import import_module
from typing import TYPE_CHECKING

from gyrocal.davenport import CalibrationResult, RecursiveCalibrator, calibrate, residual_table
from gyrocal.errors import GyrocalError, InputError, UnobservableError
from gyrocal.observability import Observability
from gyrocal.parameters import NAMES, GyroParameters, select
from gyrocal.propagation import Arcs, StreamingPropagation, propagate, psi_matrix
from gyrocal.recording import Attitudes, GyroStream, Interval, Orbit, Recording, load, save

if TYPE_CHECKING:
    from gyrocal.alignment import AlignmentResult
    from gyrocal.alignment import in_two_steps as align_in_two_steps
    from gyrocal.alignment import together as align_together
    from gyrocal.earth_sensor import EarthModel, EarthSensor
    from gyrocal.filter_run import FilterRun
    from gyrocal.filter_run import run as run_filter
    from gyrocal.full_filter import FullFilterResult, Leg
    from gyrocal.full_filter import run_legs as run_full_filter
    from gyrocal.mekf import KalmanFilter
    from gyrocal.onboard import Maneuver, OnBoardCalibrator
    from gyrocal.onboard import replay as run_on_board
    from gyrocal.reference import BatchResult, batch
    from gyrocal.reference_covariance import interval_covariance, reference_attitudes, residual_covariance
    from gyrocal.sensors import SensorModel, SensorSeries
    from gyrocal.smoother import Smoothed, smooth
    from gyrocal.sun_sensor import SunModel, SunSensor, trmm_sun_sensors

# Name here, module and name there: loaded when asked for, since a worker that only calibrates needs none of them.
_ELSEWHERE = {
    "AlignmentResult": ("alignment", "AlignmentResult"),
    "align_in_two_steps": ("alignment", "in_two_steps"),
    "align_together": ("alignment", "together"),
    "EarthModel": ("earth_sensor", "EarthModel"),
    "EarthSensor": ("earth_sensor", "EarthSensor"),
    "FilterRun": ("filter_run", "FilterRun"),
    "run_filter": ("filter_run", "run"),
    "FullFilterResult": ("full_filter", "FullFilterResult"),
    "Leg": ("full_filter", "Leg"),
    "run_full_filter": ("full_filter", "run_legs"),
    "KalmanFilter": ("mekf", "KalmanFilter"),
    "Maneuver": ("onboard", "Maneuver"),
    "OnBoardCalibrator": ("onboard", "OnBoardCalibrator"),
    "run_on_board": ("onboard", "replay"),
    "BatchResult": ("reference", "BatchResult"),
    "batch": ("reference", "batch"),
    "interval_covariance": ("reference_covariance", "interval_covariance"),
    "reference_attitudes": ("reference_covariance", "reference_attitudes"),
    "residual_covariance": ("reference_covariance", "residual_covariance"),
    "SensorModel": ("sensors", "SensorModel"),
    "SensorSeries": ("sensors", "SensorSeries"),
    "Smoothed": ("smoother", "Smoothed"),
    "smooth": ("smoother", "smooth"),
    "SunModel": ("sun_sensor", "SunModel"),
    "SunSensor": ("sun_sensor", "SunSensor"),
    "trmm_sun_sensors": ("sun_sensor", "trmm_sun_sensors"),
}

__all__ = [
    "NAMES",
    "AlignmentResult",
    "Arcs",
    "Attitudes",
    "BatchResult",
    "CalibrationResult",
    "EarthModel",
    "EarthSensor",
    "FilterRun",
    "FullFilterResult",
    "GyroParameters",
    "GyroStream",
    "GyrocalError",
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
    "align_in_two_steps",
    "align_together",
    "batch",
    "calibrate",
    "interval_covariance",
    "load",
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
    "trmm_sun_sensors",
]


def __getattr__(name: str) -> object:
    if name not in _ELSEWHERE:
        raise AttributeError(f"module 'gyrocal' has no attribute '{name}'")
    module, there = _ELSEWHERE[name]
    found = getattr(import_module(f"gyrocal.{module}"), there)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
