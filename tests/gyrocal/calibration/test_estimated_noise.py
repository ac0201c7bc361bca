"""The p-value of a calibration beside noise levels that the import estimated."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import scipy.special
import scipy.stats
from scipy.spatial.transform import Rotation

import gyrocal
from gyrocal.calibration.estimated_noise import compute_chi2_p, compute_smaller_chi2_p
from gyrocal.importing import import_csv
from tests.builders import choose_case_numbers

SAMPLE_S, EVERY, LENGTH = 0.1, 2, 6000
ARW, SIGMA = 8e-5, 9e-4  # rad/sqrt(s), rad
WORDS = {"time": "t:s", "gyro": "x,y,z:rad/s", "quat": "qx,qy,qz,qw:scalar-last:body-to-world"}


def build_motion(length=LENGTH):
    """Rates (n, 3) and attitudes of a log with rests at both ends."""
    t_s = np.arange(length) * SAMPLE_S
    gate = ((t_s > 15) & (t_s < t_s[-1] - 15))[:, None]
    rates = 0.8 * gate * np.sin(2 * np.pi * np.outer(t_s - 15, [0.13, 0.21, 0.34]))
    attitude, found = np.eye(3), []
    for k, turn in enumerate(Rotation.from_rotvec(rates * SAMPLE_S).as_matrix()):
        if k % EVERY == 0:
            found.append(attitude)
        attitude = attitude @ turn
    return t_s, rates, Rotation.from_matrix(np.array(found))


def read_log(folder, motion, seed, error=0.0, sigma=SIGMA, arw=ARW, **known):
    """The recording that an import makes of tables with white noise, and with an error (m, 3) of the attitudes in rad."""
    t_s, rates, attitudes = motion
    rng = np.random.default_rng(seed)
    raw = rates + 0.005 + rng.normal(size=rates.shape) * arw / np.sqrt(SAMPLE_S)
    q = (attitudes * Rotation.from_rotvec(rng.normal(size=(len(attitudes), 3)) * sigma + error)).as_quat()
    pd.DataFrame(np.column_stack([t_s, raw]), columns=["t", "x", "y", "z"]).to_csv(folder / "g.csv", index=False)
    table = pd.DataFrame(np.column_stack([t_s[::EVERY], q]), columns=["t", "qx", "qy", "qz", "qw"])
    table.to_csv(folder / "a.csv", index=False)
    return import_csv(folder / "g.csv", folder / "a.csv", **WORDS, **known).recording


@pytest.mark.parametrize("logs", choose_case_numbers(4, 16))
def test_clean_logs_of_ten_minutes_have_uniform_p_values(tmp_path, logs):
    """A slow error of the references is found beside the same estimates."""
    motion = build_motion()
    results = [gyrocal.calibrate(made := read_log(tmp_path, motion, seed)) for seed in range(logs)]
    assert scipy.stats.kstest([result.p_value for result in results], "uniform").pvalue > 0.01
    stated = replace(
        made, gyro=replace(made.gyro, arw_estimated=False), attitudes=replace(made.attitudes, sigma_estimated=False)
    )
    plain = scipy.special.chdtrc(results[-1].dof, results[-1].chi2)
    assert gyrocal.calibrate(stated).p_value == plain
    rough = replace(made, attitudes=replace(made.attitudes, sigma=0.9 * made.attitudes.sigma, sigma_degrees=60.0))
    assert (
        gyrocal.calibrate(rough).p_value
        > 1e-3
        > 1e-9
        > gyrocal.calibrate(replace(rough, gyro=stated.gyro, attitudes=replace(rough.attitudes, sigma_estimated=False))).p_value
    )
    # Sinusoidal, with an RMS of three sigma.
    wrong = 3 * np.sqrt(2) * SIGMA * np.sin(2 * np.pi * motion[0][::EVERY, None] / 20) * [1.0, 0.0, 0.0]
    assert gyrocal.calibrate(read_log(tmp_path, motion, 0, wrong)).p_value < 1e-4


def test_one_tracker_has_a_sigma_about_each_axis(tmp_path):
    """About x and y a tracker is as good as the gyro between two attitudes, about z six times worse; some are not used."""
    sigma = ARW * np.sqrt(EVERY * SAMPLE_S) * np.array([1.0, 1.0, 6.0])
    made = read_log(tmp_path, build_motion(3000), 3, sigma=sigma, spacing_s=2.0)
    assert made.attitudes.t_s.size < 200
    np.testing.assert_allclose(made.attitudes.sigma[0], sigma, rtol=0.15)
    assert made.attitudes.sigma_degrees > 1000
    assert 0.01 < gyrocal.calibrate(made).p_value < 0.99


def test_the_ratio_to_an_estimated_level_has_its_level():
    """Draws of χ² over an estimate of 50 degrees of freedom are uniform in p."""
    rng = np.random.default_rng(3)
    ratios = rng.chisquare(3000, 4000) / (rng.chisquare(50, 4000) / 50)
    p = np.array([compute_chi2_p(ratio, 3000, 50) for ratio in ratios])
    assert abs(np.mean(p < 0.05) - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 4000)
    assert np.allclose(p + [compute_smaller_chi2_p(one, 3000, 50) for one in ratios], 1)
    assert np.mean([scipy.special.chdtrc(3000, one) < 0.05 for one in ratios]) > 0.3
