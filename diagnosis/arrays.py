"""Constants that all modules of a diagnosis share."""

AXES = "xyz"
LEAST_POSITIVE = 1e-300  # beside zero, for p-values and denominators
