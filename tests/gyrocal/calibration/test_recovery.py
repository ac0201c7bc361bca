"""Injected parameters come back from the simulator's noise-free truth, which shares no propagation with the calibrator."""

import numpy as np
import pytest

from gyrocal import calibrate
from simulator import scenario as scenarios
from simulator import simulate

CONTROL = {"control_motion": {"amplitude_deg": [0.02, 0.02, 0.02], "period_s": [180.0, 240.0, 300.0]}}


@pytest.mark.parametrize("psi", ["full", "linear"])
@pytest.mark.parametrize(
    ("name", "changes"), [("trmm", {}), ("trmm_series", {}), ("trmm", CONTROL), ("trmm", {"orbit.j2": True})]
)
def test_smooth_noise_free_truth_is_recovered(name, changes, psi):
    scenario = scenarios.override(scenarios.load(name), changes)
    result = calibrate(simulate(scenario, noise=False), psi=psi)
    assert result.converged
    np.testing.assert_allclose(result.G, scenario.gyro.true_G, rtol=0, atol=1e-6)
    np.testing.assert_allclose(np.rad2deg(result.bias), scenario.gyro.true_bias_deg_s, rtol=0, atol=1e-9)


def test_error_is_the_second_order_of_a_mean_rate():
    """The mean rate leaves out Δt²/12 ω̇ × ω, what a turn of axis within a sample adds: an error in Δt², not in the noise."""
    error = {}
    for sample_s in (1.0, 4.0):
        scenario = scenarios.override(scenarios.load("trmm"), {"gyro.sample_s": sample_s})
        error[sample_s] = np.abs(calibrate(simulate(scenario, noise=False)).G - scenario.gyro.true_G).max()
    assert error[4.0] > 1e-6
    assert error[4.0] / error[1.0] == pytest.approx(16, rel=0.02)
