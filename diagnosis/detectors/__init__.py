"""Tests of the gyro samples and of the reference noise, one per file."""
