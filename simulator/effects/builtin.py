"""The built-in effects: one line each adds it to the registry."""

from simulator.effects.gyro import (
    bias_drift,
    bias_orbital,
    bias_random_walk,
    bias_step,
    bias_temperature,
    g_matrix_step,
    noise_excess,
    noise_flicker,
    rate_deadzone,
    rate_lag,
    rate_quantization,
    rate_saturation,
    rate_truncation,
    scale_asymmetry,
    scale_quadratic,
    spikes,
    stale_samples,
    time_offset,
    vibration,
)
from simulator.effects.reference import (
    reference_correlated,
    reference_horizon,
    reference_mode_offset,
    reference_noise_excess,
    reference_orbital,
)
from simulator.effects.registry import REGISTRY
from simulator.effects.sensor import dss_head, dss_misalignment, esa_bias, esa_nadir, esa_s_filter, esa_sun_intrusion

# In the order in which they are listed.
BUILT_IN = (
    bias_drift,
    bias_step,
    bias_orbital,
    bias_temperature,
    bias_random_walk,
    noise_flicker,
    noise_excess,
    scale_asymmetry,
    scale_quadratic,
    g_matrix_step,
    time_offset,
    rate_lag,
    rate_quantization,
    rate_deadzone,
    rate_saturation,
    rate_truncation,
    vibration,
    spikes,
    stale_samples,
    reference_mode_offset,
    reference_orbital,
    reference_horizon,
    reference_correlated,
    reference_noise_excess,
    dss_head,
    dss_misalignment,
    esa_bias,
    esa_s_filter,
    esa_sun_intrusion,
    esa_nadir,
)
REGISTRY.register_all(module.EFFECT for module in BUILT_IN)
