"""Injected parameters come back from noise-free truth of the simulator and from recordings by an independent program."""

import json

import numpy as np
import pytest
import scipy.stats

from gyrocal import calibrate, load
from simulator import scenario as scenarios
from simulator import simulate
from tests import SHARED

FOLDER = SHARED / "practice"
KEYS = json.loads((FOLDER / "keys.json").read_text()) if FOLDER.is_dir() else {}
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


@pytest.mark.skipif(not KEYS, reason="the practice recordings are not beside this checkout")
@pytest.mark.parametrize("name", sorted(name for name, key in KEYS.items() if not key["effects"]))
def test_without_effect_the_key_is_recovered_within_sigma(name):
    key = KEYS[name]
    result = calibrate(load(FOLDER / name))
    truth = np.concatenate([np.ravel(key["true_G"]), np.deg2rad(key["true_bias_deg_s"])])
    error = result.parameters.vector - truth
    assert np.abs(error / result.sigma).max() < 3.5  # of 12: 0.6 % by chance
    nees = error @ np.linalg.solve(result.covariance, error)
    assert 0.005 < scipy.stats.chi2.sf(nees, 12) < 0.995
    assert 0.005 < result.p_value < 0.995
