"""References whose errors correlate between axes: simulated, calibrated and diagnosed with their covariance."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from diagnosis.model.linearise import linearise_recording
from diagnosis.model.prepare import prepare
from gyrocal import calibrate
from simulator import load, motion, override, simulate
from simulator.simulate import add_effects_and_noise, make_noise_streams

SCENARIO = override(load("trmm_series"), {"gyro.sample_s": 2.0, "reference.every_s": 50.0})
M = Rotation.from_rotvec([0.4, 0.9, -0.5]).as_matrix()
COVARIANCE = M @ np.diag(np.deg2rad([1e-3, 1e-3, 2e-2]) ** 2) @ M.T  # one star tracker, turned against the body


@pytest.fixture(scope="module")
def recordings():
    plain, path = simulate(SCENARIO, noise=False), motion(SCENARIO)
    P = np.tile(COVARIANCE, (plain.attitudes.t_s.size, 1, 1))
    plain = replace(plain, attitudes=plain.attitudes.replace_covariance(P))
    return [add_effects_and_noise(plain, path, (), *make_noise_streams(seed, 0, True), seed, 0) for seed in range(4)]


def test_residuals_and_the_test_of_noise_know_the_covariance_that_is_stated(recordings):
    z = []
    for recording in recordings:
        result = calibrate(recording)
        model = linearise_recording(recording, result.G, result.bias)
        z.append((result.chi2 - result.dof) / np.sqrt(2 * result.dof))
        assert model.y @ model.y == pytest.approx(result.chi2, rel=0.02)
        assert model.degrees_of_freedom == result.dof
    assert abs(np.mean(z)) < 3.5 / np.sqrt(len(z))
    prepared = prepare(recordings[0])
    noise = prepared.reference_noise
    assert noise is not None
    assert not noise.departs
    assert noise.factor == pytest.approx(np.ones(3), abs=0.25)
