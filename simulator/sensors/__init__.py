"""Gyro, reference attitudes, sun sensors and Earth sensor: from the true motion to what is measured."""
