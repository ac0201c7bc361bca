"""Validation of the framework itself: blind check, baseline of recovered parameters, a real gyro."""
