"""The alignment study: its rows against the algorithms called by hand, its verdicts on made-up rows, its report."""

import numpy as np
import pytest

from gyrocal import align_together
from simulator.streams import generator
from studies.estimation import alignment
from studies.estimation.alignment import COMMON_ROTATIONS, ERRORS, HEAD_ANGLES_METHOD, ONCE, REPEATED, SIGMAS, STUDY, TOGETHER
from studies.estimation.attitude_cases import M_TRUE, TRUE_MISALIGNMENT_ANGLES, build_alignment_orbit, compute_alignment_error
from studies.montecarlo.statistics import CONSISTENT
from studies.montecarlo.study import load_base_scenario, load_config
from tests.builders import mean_bounds
from tests.studies.rows import run_study

CONFIG = load_config(STUDY, changes={"cases": 3, "esa_factors": [1.0, 50.0]})


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    return run_study(STUDY, CONFIG, tmp_path_factory.mktemp("alignment"))


def test_rows_are_those_of_the_algorithm(rows):
    orbit = build_alignment_orbit(float(np.deg2rad(load_base_scenario(CONFIG).gyro.arw_deg_per_sqrt_s)))
    series = orbit.series(generator(CONFIG.entropy, 2, "sensor_noise"))
    gyro = orbit.motion.gyro(generator(CONFIG.entropy, 2, "gyro_noise"))
    found = align_together(series, gyro, orbit.A[0], "DSS-1")
    error = compute_alignment_error(found.misalignment["DSS-2"], found.penetration_biases["ESA"])
    row = rows[(rows["case"] == 2) & (rows["algorithm"] == TOGETHER)].iloc[0]
    np.testing.assert_allclose(row[ERRORS].to_numpy(float), 1e3 * np.rad2deg(error), rtol=1e-12)
    np.testing.assert_allclose(row[SIGMAS].to_numpy(float), 1e3 * np.rad2deg(found.sigma), rtol=1e-12)
    assert row["nees"] == pytest.approx(error @ np.linalg.solve(found.covariance, error), rel=1e-9)


def test_both_algorithms_agree_and_one_round_does_not(rows):
    of = rows.set_index(["algorithm", "esa_factor", "case"]).sort_index()
    assert of.loc[REPEATED, "apart_sigma"].max() < 5e-3
    once = of.loc[(ONCE, 1.0)]
    assert once["retained_1"].mean() == pytest.approx(0.14, abs=0.005)
    assert of.loc[(ONCE, 50.0), "retained_1"].mean() == pytest.approx(0.994, abs=0.002)
    # What is lost of R's 0.157° about x is what its error shows.
    assert once["error_1_mdeg"].mean() == pytest.approx(0.86 * 1e3 * np.rad2deg(TRUE_MISALIGNMENT_ANGLES[0]), rel=0.02)


def test_nees_that_one_round_has_is_predicted(rows):
    """The noncentral χ² of its bias: the mean over the seeds is the prediction to what the seeds leave open."""
    once = rows[(rows["algorithm"] == ONCE) & (rows["esa_factor"] == 1.0)]
    predicted = once["nees_predicted"].mean()
    spread = np.sqrt((2 * 7 + 4 * (predicted - 7)) / len(once))
    assert abs(once["nees"].mean() - predicted) < 4 * spread
    low, high = mean_bounds(7, 3)
    for name in ("nees_own_mean", "nees"):
        inside = low < once[name].mean() < high
        assert inside == (name == "nees_own_mean")


def test_the_common_rotation_is_reported(rows):
    usual = rows[rows["esa_factor"] == 1.0]
    assert (usual["unobservable"] == "; ".join(COMMON_ROTATIONS)).all()
    better = rows[rows["esa_factor"] == 50.0]
    assert (better["unobservable"].str.count("a rotation of all sensors") == 2).all()  # yaw shows in the oblate Earth


def test_verdicts_follow_the_rows(rows):
    table = alignment.build_verdict_table(rows).set_index(["algorithm", "esa_factor"])
    assert table.loc[(ONCE, 1.0), "expected"] == f"not {CONSISTENT}"
    assert table.loc[(ONCE, 50.0), "expected"] == CONSISTENT
    assert table.loc[(HEAD_ANGLES_METHOD, 1.0), "loss_verdict"] != CONSISTENT
    halved = rows.copy()
    halved["nees"] *= 4
    assert alignment.build_verdict_table(halved).set_index("algorithm").loc[TOGETHER, "verdict"] == "over-confident"
    assert alignment.report(CONFIG, halved).check(f"{TOGETHER}, esa factor 1").verdict == "fail"


def test_injected_misalignment_is_the_rotation_of_the_papers_matrix():
    np.testing.assert_allclose(M_TRUE @ M_TRUE.T, np.eye(3), atol=1e-14)
    published = 1e-3 * np.array([[999.996, -1.98736, -1.99437], [1.99280, 999.994, 2.72920], [1.98893, -2.73316, 999.994]])
    np.testing.assert_allclose(M_TRUE, published, atol=6e-6)
