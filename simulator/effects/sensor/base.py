"""Definition of an effect on the attitude sensors: the change of the sensors as built, and of their measurements.

M0 at the level of the sensors has the nominal sun and Earth sensors with white noise. An effect changes the sensors of a
simulation (`SensorEffect.fitted`), and says what that adds to the angles which the nominal ones would show
(`SensorEffect.error`), exactly and per amplitude, so that a diagnosis gets its columns as derivatives of it. Both are written
independently where the sensors' own code can compute the first.

Sizes are in the unit of the effect, errors in radians; an error is what the sensor shows beyond M0.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gyrocal.arrays import Array, Mask
from simulator.effects.base import Effect, Parameter, Parameters, Surroundings, Trial
from simulator.effects.common import DEG as DEG
from simulator.effects.common import DirectedEffect

EARTH_SENSOR = "Earth sensor"
S_FILTER_TIME = Parameter("time_constant_s", "s", 60.0, "of the filter", lower=1.0, upper=1e4)


@dataclass(frozen=True)
class Sightings:
    """Geometry of the sensors' measurements, as well as it is known."""

    sun_sensor: NDArray[np.int64]  # (n,) number of the sun sensor of each of its measurements, 1, 2, …
    sun_angles: Array  # (n, 2) α and β of M0, rad
    t_s: Array  # (m,) times of the Earth sensor's measurements
    arc: NDArray[np.intp]  # (m,) number of the arc, the time of constant rate, that each belongs to; in time order
    A: Array  # (m, 3, 3) attitudes then
    position: Array  # (m, 3) from the Earth's centre, inertial, m
    sun: Array  # (m, 3) unit vectors, inertial
    used: Mask  # (m, 4) quadrants used

    @property
    def nothing(self) -> tuple[Array, Array]:
        """Errors (n, 2) and (m, 4) that are zero."""
        return np.zeros(self.sun_angles.shape), np.zeros(self.used.shape)


@dataclass(frozen=True)
class SensorEffect(Effect):
    """An effect on the sensors."""

    options: tuple[Parameters, ...] = ({},)  # values of its other parameters that a diagnosis tries
    count: int = 1  # number of its linear amplitudes
    refined: tuple[str, ...] = ()  # those of the other parameters that are positive numbers, to be found between the options
    acts_on: str = ""  # name of the sensor; "{axis}" in it stands for the effect's axis
    # whether its amplitudes may also differ from day to day or drift, which is then a discrepancy on no list
    wanders: bool = False
    # what an alignment calibration, which knows orthogonal matrices and biases only, makes of it: it is "solved" for, or
    # "mistaken" for those that are; "" if it does neither
    alignment: Literal["", "solved", "mistaken"] = ""
    # signal and words for residuals that follow its columns, where a diagnosis tests for them
    finding: tuple[str, str] | None = None

    def sensor(self, axis: str | None) -> str:
        """Name of the sensor that it acts on."""
        return self.acts_on.format(axis=axis)

    def trials(self, around: Surroundings) -> Sequence[Trial]:
        """Try its options."""
        return tuple(Trial(option, 1 / len(self.options)) for option in self.options)

    def error(self, sightings: Sightings, axis: str | None, amplitudes: Array, parameters: Parameters) -> tuple[Array, Array]:
        """Compute errors of the sun sensors' angles (n, 2) and the penetration angles (m, 4), rad; amplitudes (count,)."""
        raise NotImplementedError


@dataclass(frozen=True)
class VectorEffect(SensorEffect, DirectedEffect):
    """An effect of several angles: its size is their norm, its parameters say the direction and may have any length."""
