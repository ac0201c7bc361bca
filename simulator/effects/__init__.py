"""Effects: what a real gyro or attitude sensor does and the baseline simulator does not, one per file.

Each owns itself (`simulator.effects.base`): where in the measuring chain it acts and what it does there, and how a diagnosis
tries it. `REGISTRY` holds all of them by name, `EFFECTS` those on gyro and references, `SENSOR_EFFECTS` in
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
from simulator.effects.recording_view import extract_references, extract_stream, extract_surroundings
from simulator.effects.registry import ALL_EFFECTS, EFFECTS, REGISTRY, Registry
from simulator.effects.settings import parse, setting, tabulate_setting

# The built-in effects: one line each adds it to the registry, in the order in which they are listed.
FILES = """
gyro.bias_drift
gyro.bias_step
gyro.bias_orbital
gyro.bias_periodic
gyro.bias_temperature
gyro.acceleration_sensitivity
gyro.bias_random_walk
gyro.bias_markov
gyro.noise_flicker
gyro.noise_excess
gyro.noise_angle_white
gyro.scale_asymmetry
gyro.scale_quadratic
gyro.g_matrix_step
gyro.g_matrix_temperature
gyro.time_offset
gyro.clock_drift
gyro.clock_slip
gyro.clock_wander
gyro.rate_lag
gyro.rate_quantization
gyro.rate_deadzone
gyro.rate_saturation
gyro.rate_truncation
gyro.vibration
gyro.spikes
gyro.stale_samples
gyro.gyro_stop
reference.reference_jump
reference.reference_freeze
reference.reference_glitch
reference.reference_mode_offset
reference.reference_orbital
reference.reference_horizon
reference.reference_periodic
reference.reference_correlated
reference.reference_noise_excess
sensor.dss_head
sensor.dss_misalignment
sensor.esa_bias
sensor.esa_s_filter
sensor.esa_sun_intrusion
sensor.esa_nadir
"""
BUILT_IN = tuple(import_module(f"simulator.effects.{file}") for file in FILES.split())
REGISTRY.register_all(module.EFFECT for module in BUILT_IN)

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
    "extract_references",
    "extract_stream",
    "extract_surroundings",
    "find_flight_directions",
    "parse",
    "setting",
    "tabulate_setting",
]
