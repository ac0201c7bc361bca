"""Errors of the readout of each rate, on an axis or on all three.

rate_quantization
    Samples become the nearest multiple of size, noise included: the least significant bit of the converter or of telemetry.
rate_deadzone
    The noise-free reading is 0 where its absolute value is below size: stiction of a pivot, or lock-in of a laser gyro without
    dither. Acts before the white noise, which comes from the electronics behind it and goes on.
rate_saturation
    Samples beyond ±size read ±size: the range of the rebalance loop, the converter or the telemetry word.
rate_truncation
    Samples become the multiple of size next to them on the side of zero, noise included: an integer conversion that drops the
    fraction. The counts −1 < x/size < 1 all read zero, so that the bin of zero is twice as wide as the others, and every other
    reading is half a step too near to zero on average.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from simulator.effects.base import Array, Effect, Setting, Stream
from simulator.effects.common import DEG, select_axes


@dataclass(frozen=True)
class _Readout(Effect):
    show: Callable[[Array, float], Array] = field(kw_only=True)  # of samples and the size, rad/s

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        out, axes = samples.copy(), select_axes(setting.axis)
        out[:, axes] = self.show(samples[:, axes], setting.size * DEG)
        return out


def _round(x: Array, step: float) -> Array:
    return np.asarray(np.round(x / step) * step)


def _truncate(x: Array, step: float) -> Array:
    return np.asarray(np.trunc(x / step) * step)


def _ignore_small(x: Array, zone: float) -> Array:
    return np.asarray(np.where(np.abs(x) < zone, 0.0, x))


def _clip(x: Array, limit: float) -> Array:
    return np.asarray(np.clip(x, -limit, limit))


EFFECTS = [
    _Readout(
        name="rate_quantization",
        summary="output rounded to a step",
        says="the gyro's readings are rounded to steps of {size}",
        unit="deg/s",
        stage="resolution",
        prior=(1e-6, 1.0),
        bounds=(1e-12, 1e5),
        axis_optional=True,
        meaning="The gyro's output is rounded to multiples of a step.",
        symptom="lattice",
        show=_round,
    ),
    _Readout(
        name="rate_deadzone",
        summary="small rates read zero",
        says="{gyro} does not feel rates below {size}",
        unit="deg/s",
        stage="threshold",
        prior=(1e-5, 1.0),
        bounds=(0.0, 1e5),
        meaning="Rates smaller than this read zero.",
        show=_ignore_small,
    ),
    _Readout(
        name="rate_saturation",
        summary="output clipped",
        says="{gyro} cuts off rates above {size}",
        unit="deg/s",
        stage="range",
        prior=(1e-2, 3e3),
        bounds=(1e-9, 1e5),
        meaning="Rates larger than this are cut off.",
        symptom="plateau",
        show=_clip,
    ),
    _Readout(
        name="rate_truncation",
        summary="output cut toward zero to a step",
        says="the gyro's readings are cut down to steps of {size}",
        unit="deg/s",
        stage="resolution",
        prior=(1e-6, 1.0),
        bounds=(1e-12, 1e5),
        axis_optional=True,
        meaning="The gyro's output is cut off to a multiple of a step instead of rounded.",
        symptom="lattice",
        show=_truncate,
    ),
]
