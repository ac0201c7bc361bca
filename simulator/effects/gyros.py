"""Effects on one of several gyros with axes of any direction.

An effect knows the gyros x, y and z. One of another name, such as "4", is shown to it as the gyro x of a stream of its own,
whose rate is the one about that gyro's axis: what the effect does to x there, it does to gyro 4. So every effect on a gyro
acts on any gyro, and its file says once what it does.
"""

from dataclasses import replace

import numpy as np

from gyrocal.errors import InputError
from simulator.effects.base import AXIS_NAMES, Array, Effect, Parameters, Setting, Stream

STAND_IN = "x"


def select_gyro(stream: Stream, column: int) -> Stream:
    """The stream of one gyro as that of a gyro x, with nothing about y and z."""
    rates, raw = np.zeros((len(stream.t_s), 3)), np.zeros((len(stream.t_s), 3))
    assert stream.axes is not None
    rates[:, 0], raw[:, 0] = stream.rates @ stream.axes[column], stream.raw[:, column]
    return replace(stream, rates=rates, raw=raw, gyros=AXIS_NAMES, axes=None)


def replace_axis(setting: Setting) -> Setting:
    """The setting as it is put to the gyro x that stands for its own."""
    return replace(setting, axis=None if setting.axis is None else STAND_IN)


def compute_columns(effect: Effect, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
    """Compute what an effect adds to the readings per unit of each amplitude, (n, gyros, k) rad/s, of any gyros."""
    if stream.axes is None:
        return effect.columns(stream, axis, parameters)
    column = stream.gyros.index(str(axis))
    own = effect.columns(select_gyro(stream, column), STAND_IN, parameters)[:, 0]
    out = np.zeros((len(own), len(stream.gyros), own.shape[1]))
    out[:, column] = own
    return out


def is_axis_independent(effect: Effect) -> bool:
    """Whether an effect can act on a gyro of any axis: one that names body axes beside its own cannot."""
    return not effect.on_references and effect.stage != "sensor" and all(one.choices != AXIS_NAMES for one in effect.parameters)


def check_gyro(setting: Setting, effect: Effect, gyros: tuple[str, ...]) -> None:
    """Raise an `InputError` where a setting names a gyro that is not there, or cannot act on such gyros."""
    if setting.axis is not None and setting.axis not in gyros:
        raise InputError(f"{setting.label()}: no gyro {setting.axis}; there are {', '.join(gyros)}")
    if gyros != AXIS_NAMES and not is_axis_independent(effect):
        raise InputError(f"{setting.label()}: acts on the gyros x, y and z only; there are {', '.join(gyros)}")
