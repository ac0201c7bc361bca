"""The built-in effects: one line each adds it to the registry, in the order in which they are listed."""

from importlib import import_module

from simulator.effects.registry import REGISTRY

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
