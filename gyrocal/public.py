"""The names of the package `gyrocal`, which loads this module when one of them is asked for.

``A as A`` is the form that type checkers take as an export.
"""

from gyrocal.calibration.davenport import RecursiveCalibrator as RecursiveCalibrator
from gyrocal.calibration.davenport import calibrate as calibrate
from gyrocal.calibration.davenport import residual_table as residual_table
from gyrocal.calibration.observability import Observability as Observability
from gyrocal.calibration.parameters import NAMES as NAMES
from gyrocal.calibration.parameters import GyroParameters as GyroParameters
from gyrocal.calibration.parameters import select as select
from gyrocal.calibration.propagation import Arcs as Arcs
from gyrocal.calibration.propagation import StreamingPropagation as StreamingPropagation
from gyrocal.calibration.propagation import propagate as propagate
from gyrocal.calibration.propagation import psi_matrix as psi_matrix
from gyrocal.calibration.result import CalibrationResult as CalibrationResult
from gyrocal.errors import GyrocalError as GyrocalError
from gyrocal.errors import InputError as InputError
from gyrocal.errors import UnobservableError as UnobservableError
from gyrocal.estimation import filter_run as _filter_run
from gyrocal.estimation import full_filter as _full_filter
from gyrocal.estimation import onboard as _onboard
from gyrocal.estimation.alignment import AlignmentResult as AlignmentResult
from gyrocal.estimation.alignment import align_in_two_steps as align_in_two_steps
from gyrocal.estimation.alignment import align_together as align_together
from gyrocal.estimation.batch import BatchResult as BatchResult
from gyrocal.estimation.batch import batch as batch
from gyrocal.estimation.filter_run import FilterRun as FilterRun
from gyrocal.estimation.full_filter import FullFilterResult as FullFilterResult
from gyrocal.estimation.full_filter import Leg as Leg
from gyrocal.estimation.mekf import KalmanFilter as KalmanFilter
from gyrocal.estimation.onboard import Maneuver as Maneuver
from gyrocal.estimation.onboard import OnBoardCalibrator as OnBoardCalibrator
from gyrocal.estimation.reference_covariance import interval_covariance as interval_covariance
from gyrocal.estimation.reference_covariance import reference_attitudes as reference_attitudes
from gyrocal.estimation.reference_covariance import residual_covariance as residual_covariance
from gyrocal.estimation.smoother import Smoothed as Smoothed
from gyrocal.estimation.smoother import smooth as smooth
from gyrocal.recording import Attitudes as Attitudes
from gyrocal.recording import GyroStream as GyroStream
from gyrocal.recording import Interval as Interval
from gyrocal.recording import Orbit as Orbit
from gyrocal.recording import Recording as Recording
from gyrocal.recording import load as load
from gyrocal.recording import save as save
from gyrocal.sensors.earth import EarthModel as EarthModel
from gyrocal.sensors.earth import EarthSensor as EarthSensor
from gyrocal.sensors.series import SensorModel as SensorModel
from gyrocal.sensors.series import SensorSeries as SensorSeries
from gyrocal.sensors.sun import SunModel as SunModel
from gyrocal.sensors.sun import SunSensor as SunSensor
from gyrocal.sensors.sun import trmm_sun_sensors as trmm_sun_sensors

run_filter, run_full_filter, run_on_board = _filter_run.run, _full_filter.run_legs, _onboard.replay
