"""Iterations: quadratic without noise, and where one is not enough."""

import numpy as np
import pytest

from studies.calibration import iterations
from studies.montecarlo import engine
from studies.montecarlo.study import Streams, load_config
from studies.natanson import flight, paper_tables
from tests.studies.rows import run_study

CASES = 12
FACTORS = [0.3, 1.0, 3.0, 10.0]


@pytest.fixture(scope="module")
def config():
    return load_config(iterations.STUDY, changes={"cases": CASES, "factors": FACTORS})


@pytest.fixture(scope="module")
def rows(config, tmp_path_factory):
    return run_study(iterations.STUDY, config, tmp_path_factory.mktemp("iterations"))


@pytest.mark.parametrize(("claimed", "true"), [(2, True), (1, False), (3, False)])
def test_without_noise_each_iteration_squares_the_error(rows, claimed, true):
    table = iterations.estimate_convergence_orders(rows).query("not noise")
    # The next order is smaller by the residual, up to 4 deg at a factor of 10: 0.07, and so at most 0.1 in the slope.
    assert (np.abs(table[["slope_1", "slope_2"]] - claimed).to_numpy().max() < 0.1) == true


def test_noise_leaves_a_linear_part(rows):
    table = iterations.estimate_convergence_orders(rows).set_index(["direction", "noise"])["second_over_first"]
    for direction in iterations.ERROR_DIRECTIONS:
        assert table[(direction, True)] > 10 * table[(direction, False)]
    slopes = iterations.estimate_convergence_orders(rows).query("noise")["slope_2"]
    assert (slopes < 1.7).all()


def test_one_iteration_is_enough_for_trmm_and_not_for_ten_times_its_error(rows):
    medians = rows[rows["noise"]].groupby(["direction", "factor"])[["left_1_G_sigma", "left_2_G_sigma"]].median()
    for direction in iterations.ERROR_DIRECTIONS:
        left = medians["left_1_G_sigma"]
        assert left[(direction, 1.0)] < 0.1 < 1 < left[(direction, 10.0)]
        assert medians.loc[(direction, 10.0), "left_2_G_sigma"] < 0.1
    limits = iterations.find_limiting_factors(rows).query("iterations == 1")
    assert ((limits["factor_0.1_sigma_median"] > 1) & (limits["factor_0.1_sigma_median"] < 3)).all()
    assert ((limits["factor_1_sigma_median"] > 3) & (limits["factor_1_sigma_median"] < 10)).all()
    # Of a quadratic error the two limits are sqrt(10) apart, to 10 % by the slope's 0.1.
    ratio = limits["factor_1_sigma_median"] / limits["factor_0.1_sigma_median"]
    assert ratio.to_numpy() == pytest.approx(np.sqrt(10), rel=0.1)


def test_noise_sets_the_error_that_converging_leaves(rows):
    table = rows[(rows["direction"] == "flown") & (rows["factor"] == 1)]
    # The mean of the largest of nine normal errors is 1.7 if they are independent and 0.8 if they are all the same, with a
    # standard deviation of up to 0.6; 4 standard errors about both.
    noisy = table[table["noise"]]["error_converged_G_sigma"].mean()
    assert 0.8 - 4 * 0.6 / np.sqrt(CASES) < noisy < 1.7 + 4 * 0.6 / np.sqrt(CASES)
    assert table[~table["noise"]]["error_converged_G_sigma"].max() < 0.01


def test_random_directions_have_the_norm_of_the_flown_one(config):
    truth_to_prelaunch = flight.read_published_parameters("prelaunch").vector - flight.read_published_calibration().vector
    drawn = [iterations.draw_error_direction(Streams(1, i).generator("initial_error"), truth_to_prelaunch) for i in range(200)]
    for part in (slice(0, 9), slice(9, 12)):
        size = np.linalg.norm(truth_to_prelaunch[part])
        assert np.linalg.norm(np.array(drawn)[:, part], axis=1) == pytest.approx(size)
        # No direction is preferred: the mean of 200 has a variance of size²/dimensions/200 each; 5 standard errors.
        dimensions = part.stop - part.start
        assert np.abs(np.mean(drawn, axis=0)[part]).max() < 5 * size / np.sqrt(200 * dimensions)


def test_first_two_iterations_are_those_of_the_paper_tables(rows):
    paper = paper_tables.tabulate_case(paper_tables.PaperTablesConfig(steps_s=(0.5,)), 3)
    full = paper_tables.select_variant(paper, 0.5).iloc[0]
    change = np.array([full[f"second_{name}"] - full[f"first_{name}"] for name in paper_tables.NAMES])
    row = rows.query("case == 3 and direction == 'flown' and noise and factor == 1").iloc[0]
    # The start here is truth + (prelaunch − truth), which is rounded.
    assert row["correction_2_G"] == pytest.approx(np.abs(change[:9]).max(), rel=1e-6)
    assert row["correction_2_bias_deg_s"] == pytest.approx(np.abs(change[9:]).max(), rel=1e-6)


def test_runs_that_do_not_converge_are_said_and_left_out(config, tmp_path):
    far = load_config(iterations.STUDY, changes={"cases": 1, "factors": [1.0, 600.0], "iterations": 4})
    rows = engine.run(iterations.STUDY, far, tmp_path, backend="serial").load()
    rows = rows[rows["error"] == ""]
    assert not rows[rows["factor"] == 600]["converged"].any()
    made = iterations.report(far, rows)
    failed = made.check("runs that did not converge, of 8")
    assert (failed.value, failed.verdict) == (4, "fail")
    assert made.check("smallest factor of a run that did not converge").value == 600
    assert iterations.find_limiting_factors(rows)["factor_1_sigma_median"].isna().all()
