"""Effects on the attitude sensors, one per file: what sun and Earth sensors do and their nominal models do not.

They need raw sensor tables (a scenario with [sensors]). `SENSOR_EFFECTS` are those of the registry.
"""

from simulator.effects.base import Setting
from simulator.effects.registry import ALL_EFFECTS, REGISTRY, View
from simulator.effects.sensor.base import SensorEffect, Sightings, VectorEffect
from simulator.effects.settings import parse, tabulate_setting

SENSOR_EFFECTS: View[SensorEffect] = View(REGISTRY, SensorEffect, on_sensors=True)

__all__ = [
    "ALL_EFFECTS",
    "SENSOR_EFFECTS",
    "SensorEffect",
    "Setting",
    "Sightings",
    "VectorEffect",
    "parse",
    "tabulate_setting",
]
