"""The names of the package `gyrocal`, which loads this module at the first use of one of them."""

from gyrocal.calibration.davenport import RecursiveCalibrator, calibrate, residual_table
from gyrocal.calibration.observability import Observability
from gyrocal.calibration.parameters import NAMES, GyroParameters, select
from gyrocal.calibration.propagation import Arcs, StreamingPropagation, propagate, psi_matrix
from gyrocal.calibration.result import CalibrationResult
from gyrocal.errors import GyrocalError, InputError, UnobservableError
from gyrocal.estimation.alignment import AlignmentResult
from gyrocal.estimation.alignment import align_in_two_steps as align_in_two_steps
from gyrocal.estimation.alignment import align_together as align_together
from gyrocal.estimation.batch import BatchResult, batch
from gyrocal.estimation.filter_run import FilterRun, Smoothed, smooth
from gyrocal.estimation.filter_run import run as run_filter
from gyrocal.estimation.full_filter import FullFilterResult, Leg
from gyrocal.estimation.full_filter import run_legs as run_full_filter
from gyrocal.estimation.mekf import KalmanFilter
from gyrocal.estimation.onboard import Maneuver, OnBoardCalibrator
from gyrocal.estimation.onboard import replay as run_on_board
from gyrocal.estimation.reference_covariance import interval_covariance, reference_attitudes, residual_covariance
from gyrocal.recording import (
    Attitudes,
    GyroStream,
    Interval,
    Orbit,
    Recording,
    load,
    save,
)
from gyrocal.sensors.earth import EarthModel, EarthSensor
from gyrocal.sensors.series import SensorModel, SensorSeries
from gyrocal.sensors.sun import SunModel, SunSensor, trmm_sun_sensors

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
