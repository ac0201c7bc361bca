"""Errors of scale factor and axes: raw_axis += size · 10⁻⁶ ω_toward · course.

scale_asymmetry
    raw_i += size · 10⁻⁶ |ω_i|: positive turns read high and negative ones low by the same share, the rest of it is scale factor
    proper. IEEE Std 528 calls it scale-factor asymmetry; it is what differs between the two halves of a rebalance loop.
scale_quadratic
    raw_i += size · 10⁻⁶ ω_i |ω_i|, one of the ω in deg/s: loss of torquer gain at high rates and the like. The even part of a
    quadratic is scale asymmetry's neighbour, the odd part reads high in both senses of rotation.
g_matrix_step
    H(t − time_s). With toward = axis the scale factor jumps; else the gyro's input axis tilts towards another one, as after a
    thermal shock or a shift of the mount. A sample that the step falls into shows its mean.
g_matrix_temperature
    T − mean T. With toward = axis it is the scale factor's thermal coefficient (IEEE Std 952), else a mount that bends. T is
    what the housekeeping shows, the gyro's temperature before others.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from simulator.effects.base import Array, Effect, Parameters, Stream
from simulator.effects.common import PPM, TIME_PARAMETER, TOWARD, compute_share_after, index, put_on_axis
from simulator.effects.housekeeping_columns import TEMPERATURE, compute_temperature_change, no_temperature


@dataclass(frozen=True)
class _ScaleShape(Effect):
    shape: Callable[[Array], Array] = field(kw_only=True)  # change per unit of the size at a rate (n,), rad/s

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        return put_on_axis(self.shape(stream.rates[:, index(axis)]), axis)


@dataclass(frozen=True)
class _MatrixElement(Effect):
    course: Callable[[Stream, Parameters], Array] = field(kw_only=True)  # (n,) per unit of the size

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        omega = stream.rates[:, index(str(parameters["toward"]))]
        return put_on_axis(PPM * omega * self.course(stream, parameters), axis)


def _take_absolute(omega: Array) -> Array:
    return np.asarray(PPM * np.abs(omega))


def _multiply_by_absolute(omega: Array) -> Array:
    return np.asarray(PPM * omega * np.abs(np.rad2deg(omega)))


EFFECTS = [
    _ScaleShape(
        name="scale_asymmetry",
        summary="scale factor differs with the sign of the rate",
        says="{gyro} reads turns one way {size} too large and the other way as much too small",
        unit="ppm",
        stage="rate",
        prior=(1.0, 5e4),
        bounds=(-1e6, 1e6),
        meaning="The scale factor differs between the two senses of rotation; positive: both rates read too high.",
        shape=_take_absolute,
    ),
    _ScaleShape(
        name="scale_quadratic",
        summary="scale factor grows with the rate, odd non-linearity",
        says="{whose} scale factor {way} by {size} of turning rate",
        ways=("grows", "shrinks"),
        unit="ppm per deg/s",
        stage="rate",
        prior=(0.1, 3e5),
        bounds=(-1e8, 1e8),
        meaning="The scale factor grows with the rate; positive: fast turns read too fast, in both senses.",
        shape=_multiply_by_absolute,
    ),
    _MatrixElement(
        name="g_matrix_step",
        summary="an element G[axis, toward] steps at one time",
        says="{whose} scale or alignment jumps by {size} at one time",
        unit="ppm",
        stage="rate",
        prior=(1.0, 5e4),
        bounds=(-1e6, 1e6),
        parameters=(TIME_PARAMETER, TOWARD),
        meaning="One element of the gyro's scale-factor and misalignment matrix jumps at one time, as after a shock.",
        switched=True,
        course=compute_share_after,
    ),
    _MatrixElement(
        name="g_matrix_temperature",
        summary="an element G[axis, toward] follows a temperature",
        says="{whose} scale or alignment changes by {size} with a temperature",
        unit="ppm per K",
        stage="rate",
        prior=(1e-2, 1e4),
        bounds=(-1e6, 1e6),
        parameters=(TOWARD, TEMPERATURE),
        meaning="One element of the gyro's scale-factor and misalignment matrix follows a temperature of the "
        "housekeeping data.",
        requirement=no_temperature,
        course=partial(compute_temperature_change, "g_matrix_temperature"),
    ),
]
