"""Attitude estimation with a gyro: batch least squares, Kalman filters, smoother, and the on-board form of the calibration."""
