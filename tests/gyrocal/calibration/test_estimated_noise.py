"""The p-value of a calibration beside noise levels that the import estimated."""

from dataclasses import replace

import numpy as np
import pandas as pd
import scipy.special
from scipy.spatial.transform import Rotation

import gyrocal
from diagnosis.inference.criticism import Innovations, Layout, check_innovations
from gyrocal.calibration.estimated_noise import compute_chi2_p, compute_smaller_chi2_p, count_noise_degrees
from gyrocal.importing import import_csv

SAMPLE_S, EVERY, LENGTH = 0.02, 5, 30_000


def build_motion():
    """Rates (n, 3) and attitudes of ten minutes with rests at both ends."""
    t_s = np.arange(LENGTH) * SAMPLE_S
    gate = ((t_s > 15) & (t_s < 585))[:, None]
    rates = 0.8 * gate * np.sin(2 * np.pi * np.outer(t_s - 15, [0.13, 0.21, 0.34]))
    attitude, found = np.eye(3), []
    for k, turn in enumerate(Rotation.from_rotvec(rates * SAMPLE_S).as_matrix()):
        if k % EVERY == 0:
            found.append(attitude)
        attitude = attitude @ turn
    return t_s, rates, Rotation.from_matrix(np.array(found))


def test_clean_logs_of_ten_minutes_have_no_misfit(tmp_path):
    """Of twenty at least nineteen fit at 1 % on either side; under χ² itself many would not."""
    t_s, rates, attitudes = build_motion()
    p_values, plain = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        raw = rates + 0.005 + rng.normal(size=rates.shape) * 6e-4
        q = (attitudes * Rotation.from_rotvec(rng.normal(size=(LENGTH // EVERY, 3)) * 9e-4)).as_quat()
        pd.DataFrame(np.column_stack([t_s, raw]), columns=["t", "x", "y", "z"]).to_csv(tmp_path / "g.csv", index=False)
        table = pd.DataFrame(np.column_stack([t_s[::EVERY], q]), columns=["t", "qx", "qy", "qz", "qw"])
        table.to_csv(tmp_path / "a.csv", index=False)
        words = {"time": "t:s", "gyro": "x,y,z:rad/s", "quat": "qx,qy,qz,qw:scalar-last:body-to-world"}
        made = import_csv(tmp_path / "g.csv", tmp_path / "a.csv", **words).recording
        result = gyrocal.calibrate(made)
        p_values.append(result.p_value)
        plain.append(scipy.special.chdtrc(result.dof, result.chi2))
    assert np.sum((np.array(p_values) < 0.01) | (np.array(p_values) > 0.99)) <= 1
    assert np.sum((np.array(plain) < 0.01) | (np.array(plain) > 0.99)) >= 3
    stated = replace(
        made, gyro=replace(made.gyro, arw_estimated=False), attitudes=replace(made.attitudes, sigma_estimated=False)
    )
    assert count_noise_degrees(stated) == np.inf
    assert gyrocal.calibrate(stated).p_value == plain[-1]
    only_gyro = replace(made, attitudes=replace(made.attitudes, sigma_estimated=False))
    assert count_noise_degrees(made) < count_noise_degrees(only_gyro) < np.inf


def test_the_ratio_to_an_estimated_level_has_its_level():
    """Draws of χ² over an estimate of 50 degrees of freedom are uniform in p."""
    rng = np.random.default_rng(3)
    ratios = rng.chisquare(3000, 4000) / (rng.chisquare(50, 4000) / 50)
    p = np.array([compute_chi2_p(one, 3000, 50) for one in ratios])
    assert abs(np.mean(p < 0.05) - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 4000)
    assert np.allclose(p + [compute_smaller_chi2_p(one, 3000, 50) for one in ratios], 1)
    assert np.mean([scipy.special.chdtrc(3000, one) < 0.05 for one in ratios]) > 0.3


def test_a_diagnosis_tests_the_size_of_innovations_beside_the_same_estimate():
    e = np.random.default_rng(4).normal(size=(3000, 3)) * 1.04
    layout = Layout(np.tile(np.eye(3), (3000, 1, 1)), np.zeros(3000, dtype=int), np.zeros((3000, 1)), np.zeros(3000))
    found = Innovations(e, np.zeros((3000, 3, 0)))
    assert next(iter(check_innovations(found, layout))).p_value < 1e-5
    assert next(iter(check_innovations(found, layout, 600.0))).p_value > 0.05
