"""Sim-to-real diagnosis: does a recording depart from the baseline simulator, where, by which cause, and how far it shrinks.

The baseline M0 has a constant G and b, white gyro noise of the stated ARW, and white reference errors of the stated sigmas.
Everything rests on one linear model (`diagnosis.model.recording`): what an unmodelled effect adds to the reading of the gyro
or to a reference attitude becomes one more column beside the twelve of the calibration.
"""
