"""Settings of effects from text, ``NAME[:AXIS]=SIZE[,PARAMETER=VALUE…]``, or from their parts.

>>> from simulator.effects import parse
>>> parse("g_matrix_step:z=1300,toward=y,time_s=15000").parameters["toward"]
'y'
"""

import math
from collections.abc import Mapping

from gyrocal.errors import InputError, suggest_names
from simulator.effects.base import Effect, Parameter, Setting, Value
from simulator.effects.registry import REGISTRY


def setting(name: str, axis: str | None, size: float, parameters: Mapping[str, Value] | None = None) -> Setting:
    """Build a validated setting, defaults filled in.

    An `InputError` of one line if effect, axis or parameter are unknown, or a value is not finite or out of bounds.
    """
    effect = _find_effect(name)
    given = dict(parameters or {})
    unknown = [key for key in given if key not in {parameter.name for parameter in effect.parameters}]
    if unknown:
        known = ", ".join(parameter.name for parameter in effect.parameters) or "none"
        raise InputError(f"{name}: no parameter {unknown[0]}; it has {known}")
    low, high = effect.bounds
    values = {parameter.name: _check_value(name, parameter, given.get(parameter.name)) for parameter in effect.parameters}
    return Setting(name, _check_axis(effect, axis), read_number(name, "size", size, low, high, effect.unit), values)


def parse(text: str) -> Setting:
    """Parse a setting from text such as "bias_orbital:y=0.2,phase_deg=30" or "dss_head:2=0.28".

    Of an effect of several angles the text has the norm as its size and their direction; the setting has the angles themselves.
    An `InputError` of one line says what is wrong.
    """
    name, axis, size, parameters = split_text(text)
    if not name:
        raise InputError(f"effect '{text}': give it as NAME:AXIS=SIZE, e.g. bias_drift:z=0.01")
    effect = _find_effect(name)
    if not size:
        raise InputError(f"{text}: give its size in {effect.unit}, as {_format_usage(effect)}")
    return effect.completed(setting(name, axis, _parse_number(name, "size", size), parameters))


def split_text(text: str) -> tuple[str, str | None, str, dict[str, Value]]:
    """Split the text of an effect into its name, axis, size and parameters; empty if not given, an axis None."""
    head, *rest = (part.strip() for part in text.split(","))
    label, _, size = (part.strip() for part in head.partition("="))
    name, colon, axis = (part.strip() for part in label.partition(":"))
    parameters: dict[str, Value] = {}
    for part in rest:
        key, _, value = (piece.strip() for piece in part.partition("="))
        if not key or not value:
            raise InputError(f"{name}: '{part}' is no parameter; give it as PARAMETER=VALUE")
        if key in parameters:
            raise InputError(f"{name}: parameter {key} is given twice")
        parameters[key] = value
    return name, axis if colon else None, size, parameters


def tabulate_setting(chosen: Setting) -> dict[str, object]:
    """Tabulate a setting for a JSON file, with its unit."""
    return {
        "effect": chosen.effect,
        "axis": chosen.axis,
        "size": chosen.size,
        "unit": REGISTRY[chosen.effect].unit,
        "parameters": dict(chosen.parameters),
    }


def _find_effect(name: str) -> Effect:
    if name in REGISTRY:
        return REGISTRY[name]
    raise InputError(f"{name}: no such effect; {suggest_names(name, REGISTRY)}")


def _format_usage(effect: Effect) -> str:
    axis = ":AXIS" if effect.axes and not effect.axis_optional else ""
    required = "".join(f",{parameter.name}=…" for parameter in effect.parameters if parameter.default is None)
    return f"{effect.name}{axis}=SIZE{required}"


def _check_axis(effect: Effect, axis: str | None) -> str | None:
    if not effect.axes:
        if axis is not None:
            raise InputError(f"{effect.name}: has no axis; write {_format_usage(effect)}")
        return None
    if axis is None:
        if effect.axis_optional:
            return None
        words = f"{', '.join(effect.axes[:-1])} or {effect.axes[-1]}"
        raise InputError(f"{effect.name}: which axis? write {_format_usage(effect)} with {words}")
    if axis not in effect.axes:
        raise InputError(f"{effect.name}: axis '{axis}' must be one of {', '.join(effect.axes)}")
    return axis


def _check_value(name: str, parameter: Parameter, given: Value | None) -> Value:
    value = parameter.default if given is None else given
    if value is None:
        raise InputError(f"{name}: {parameter.name} is missing ({parameter.summary})")
    if parameter.choices == ("*",):
        return str(value)
    if parameter.choices:
        if value not in parameter.choices:
            raise InputError(f"{name}: {parameter.name} {value} must be one of {', '.join(parameter.choices)}")
        return value
    return read_number(name, parameter.name, value, parameter.lower, parameter.upper, parameter.unit)


def _parse_number(name: str, what: str, value: Value) -> float:
    try:
        return float(value)
    except ValueError:
        raise InputError(f"{name}: {what} {value} is not a number") from None


def read_number(name: str, what: str, value: Value, low: float = -math.inf, high: float = math.inf, unit: str = "") -> float:
    """Read a finite number within bounds; an `InputError` says what of which effect it is."""
    number = _parse_number(name, what, value)
    if not math.isfinite(number):
        raise InputError(f"{name}: {what} {value} is not a finite number")
    if not low <= number <= high:
        raise InputError(f"{name}: {what} {number:g} is not within {low:g} and {high:g} {unit}".rstrip())
    return number
