"""Causes at the level of the attitude sensors, where a recording has their raw tables."""

from diagnosis.sensors.diagnose import diagnose
from diagnosis.sensors.result import SensorDiagnosis

__all__ = ["SensorDiagnosis", "diagnose"]
