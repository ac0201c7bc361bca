"""The truth: simulated recordings of gyro calibration maneuvers.

A scenario (orbit, maneuvers, true gyro parameters, noise) becomes a recording in three steps: an analytic body rate per
interval (`simulator.truth.maneuvers`), its integration to a true attitude (`simulator.truth.integration`), and what gyro and
attitude sensors show of it (`simulator.sensors.gyro`). The package integrates the truth by its
own, finer means and takes nothing of the calibrator but the recording format.

Conventions are those of `gyrocal`: attitude matrices are passive and map inertial to body components, A' = −[ω×]A,
quaternions are scalar last. Radians and SI inside; scenario files are in degrees, with the unit in each name.

    >>> import simulator
    >>> recording = simulator.simulate(simulator.load("trmm"), seed=1)
    >>> recording.gyro.rates.shape
    (47790, 3)
"""

from simulator.scenario import Scenario, load, names, override
from simulator.simulate import motion, observe, simulate
from simulator.streams import generator
from simulator.truth.motion import Motion

__all__ = ["Motion", "Scenario", "generator", "load", "motion", "names", "observe", "override", "simulate"]
