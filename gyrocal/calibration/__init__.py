"""The Davenport gyro calibration: propagation, covariance of the residuals, normal equations, solution, observability."""
