"""Effects: what a real gyro or attitude sensor does and the baseline simulator does not, one per file.

Each file defines where in the measuring chain an effect acts, what it does there, and how a diagnosis tries it; see
`simulator.effects.base`. `REGISTRY` holds all of them by name, `EFFECTS` those on gyro and references, `SENSOR_EFFECTS` in
`simulator.effects.sensor` those on sun and Earth sensors. `parse` makes a `Setting` from text and `setting` from its parts. A
positive size makes the gyro read high.
"""

from importlib import import_module

from simulator.effects.base import (
    STAGES,
    Detection,
    Effect,
    Parameter,
    ProcessTimes,
    References,
    SampleView,
    Setting,
    Stream,
    Surroundings,
    Trial,
)
from simulator.effects.flight_mode import find_flight_directions
from simulator.effects.registry import ALL_EFFECTS, EFFECTS, REGISTRY, Registry, collect_effects
from simulator.effects.settings import parse, setting, tabulate_setting

# The modules of the built-in effects, in the order in which these are listed.
FILES = """
gyro.bias
gyro.acceleration_sensitivity
gyro.bias_noise
gyro.white_noise
gyro.scale_factor
gyro.clock
gyro.rate_lag
gyro.readout
gyro.sample_faults
reference.reference_jump
reference.reference_telemetry
reference.reference_mode_offset
reference.reference_periodic
reference.reference_noise
sensor.dss_head
sensor.dss_misalignment
sensor.esa_bias
sensor.esa_s_filter
sensor.esa_sun_intrusion
sensor.esa_nadir
"""
BUILT_IN = [effect for file in FILES.split() for effect in collect_effects(import_module(f"simulator.effects.{file}"))]
REGISTRY.register_all(BUILT_IN)

__all__ = [
    "ALL_EFFECTS",
    "BUILT_IN",
    "EFFECTS",
    "REGISTRY",
    "STAGES",
    "Detection",
    "Effect",
    "Parameter",
    "ProcessTimes",
    "References",
    "Registry",
    "SampleView",
    "Setting",
    "Stream",
    "Surroundings",
    "Trial",
    "find_flight_directions",
    "parse",
    "setting",
    "tabulate_setting",
]
