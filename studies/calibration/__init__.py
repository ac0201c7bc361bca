"""Studies of the calibration: step size, noise, iterations, observability, consistency."""
