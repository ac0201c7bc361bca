"""The noise study's formal sigmas, shares and scaling laws against calibration and finite differences."""

import numpy as np

from gyrocal import GyroParameters, calibrate
from simulator.scenario import override
from simulator.simulate import motion, observe
from studies.calibration import noise
from studies.calibration.noise import SIGMAS, STUDY, compute_formal_sigmas
from studies.montecarlo.study import load_base_scenario, load_config
from studies.report.units import PPM_DEG_H
from tests.studies.rows import run_study

CHANGES = {
    "arw_deg_per_sqrt_s": [5e-5, 2e-4, 1e-3],
    "sigma_deg": [0.002, 0.01],
    "seeds": 60,
    "overrides.gyro.sample_s": 4.0,
}
CONFIG = load_config(STUDY, changes=CHANGES)


def test_sigmas_are_those_of_a_calibration_and_of_the_spread(tmp_path):
    rows = run_study(STUDY, CONFIG, tmp_path)
    point = rows.iloc[3]
    levels = {"gyro.arw_deg_per_sqrt_s": point["arw_deg_per_sqrt_s"]}
    levels |= {f"reference.sigma_deg.{k}": point["sigma_deg"] for k in range(3)}
    scenario = override(load_base_scenario(CONFIG), levels)
    recording = observe(scenario, motion(scenario), gyro_rng=None, reference_rng=None)
    truth = GyroParameters(np.array(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s))
    sigma = calibrate(recording, initial=truth, iterations=1).sigma * PPM_DEG_H
    np.testing.assert_allclose(point[SIGMAS].to_numpy(float), sigma, rtol=1e-6)
    table = noise.build_spread_table(CONFIG, rows)
    assert len(table) == 5 * 12
    assert table["inside"].all()
    halved = rows.copy()
    halved[SIGMAS] = 0.5 * halved[SIGMAS]
    assert not noise.build_spread_table(CONFIG, halved)["inside"].any()
    name = "formal sigmas within the spread's interval, of 60"
    verdicts = [noise.report(CONFIG, table).check(name).verdict for table in (rows, halved)]
    assert verdicts == ["pass", "fail"]


def test_shares_are_the_slopes_of_the_sigmas():
    shared = noise._prepare_covariances(CONFIG, 0)
    arw, sigma, h = np.deg2rad(2e-4), np.deg2rad(0.005), 1e-4
    _, share = compute_formal_sigmas(shared, arw, sigma)
    slopes = [
        (
            np.log(compute_formal_sigmas(shared, arw * np.exp(a * h), sigma * np.exp(b * h))[0])
            - np.log(compute_formal_sigmas(shared, arw, sigma)[0])
        )
        / h
        for a, b in ((1, 0), (0, 1))
    ]
    np.testing.assert_allclose(slopes[0], share, atol=2e-4)
    np.testing.assert_allclose(slopes[1], 1 - share, atol=2e-4)
    assert 0.05 < share.min() < share.max() < 0.95
