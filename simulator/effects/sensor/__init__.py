"""Effects on the attitude sensors, one per file: what sun and Earth sensors do and their nominal models do not.

A registry of its own beside `simulator.effects`, since they need raw sensor tables (a scenario with [sensors]). `parse` and
`described` know the effects of both.
"""

from dataclasses import replace

from gyrocal.errors import InputError
from simulator.effects import EFFECTS, Effect, Setting
from simulator.effects import described as described_among
from simulator.effects import parse as parse_among
from simulator.effects.sensor import dss_head, dss_misalignment, esa_bias, esa_nadir, esa_s_filter, esa_sun_intrusion
from simulator.effects.sensor.base import SensorEffect, Sightings, VectorEffect

_MODULES = (dss_head, dss_misalignment, esa_bias, esa_s_filter, esa_sun_intrusion, esa_nadir)
SENSOR_EFFECTS: dict[str, SensorEffect] = {module.EFFECT.name: module.EFFECT for module in _MODULES}
ALL_EFFECTS: dict[str, Effect] = {**EFFECTS, **SENSOR_EFFECTS}


def parse(text: str) -> Setting:
    """A setting of any effect from text, e.g. "dss_head:2=0.28"; see `simulator.effects.parse`.

    Of an effect of several angles the text has the norm as its size and their direction; the setting has the angles themselves.
    """
    setting = parse_among(text, ALL_EFFECTS)
    effect = ALL_EFFECTS[setting.effect]
    if not isinstance(effect, VectorEffect):
        return setting
    size, angles = effect.from_amplitudes(effect.amplitudes(setting))
    if size == 0:
        raise InputError(f"{text}: {', '.join(angles)} are all zero, and the effect would do nothing; one must not be")
    return replace(setting, size=size, parameters=angles)


def described(chosen: Setting) -> dict[str, object]:
    """A setting of any effect for a JSON file, with its unit."""
    return described_among(chosen, ALL_EFFECTS)


__all__ = ["ALL_EFFECTS", "SENSOR_EFFECTS", "SensorEffect", "Setting", "Sightings", "described", "parse"]
