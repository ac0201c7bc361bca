"""Recordings by an independent program, with its own integrator and noise; they lie beside the checkout, not in it."""

import json

import numpy as np
import pytest
import scipy.stats

from gyrocal import calibrate, load
from tests import SHARED

FOLDER = SHARED / "practice"
KEYS = json.loads((FOLDER / "keys.json").read_text()) if FOLDER.is_dir() else {}

pytestmark = pytest.mark.skipif(not KEYS, reason="the practice recordings are not beside this checkout")


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
