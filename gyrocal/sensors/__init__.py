"""Attitude sensors as an estimator sees them: expected measurements, sensitivities, alignment."""
