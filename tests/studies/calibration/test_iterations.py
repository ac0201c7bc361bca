"""Iterations: quadratic without noise, and where one is not enough."""

import numpy as np
import pytest

from studies.calibration import iterations
from studies.montecarlo.study import load_config
from studies.natanson import paper_tables
from tests.studies.rows import run_study

CASES = 8
FACTORS = [0.3, 1.0, 3.0, 10.0]


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    config = load_config(iterations.STUDY, changes={"cases": CASES, "factors": FACTORS})
    return run_study(iterations.STUDY, config, tmp_path_factory.mktemp("iterations"))


@pytest.mark.parametrize(("claimed", "true"), [(2, True), (1, False), (3, False)])
def test_without_noise_each_iteration_squares_the_error(rows, claimed, true):
    table = iterations.estimate_convergence_orders(rows).query("not noise")
    # The next order is smaller by the residual, up to 4 deg at a factor of 10: 0.07, and so at most 0.1 in the slope.
    assert (np.abs(table[["slope_1", "slope_2"]] - claimed).to_numpy().max() < 0.1) == true


def test_one_iteration_is_enough_for_trmm_and_the_papers(rows):
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
    paper = paper_tables.tabulate_case(paper_tables.PaperTablesConfig(steps_s=(0.5,)), 3)
    full = paper_tables.select_variant(paper, 0.5).iloc[0]
    change = np.array([full[f"second_{name}"] - full[f"first_{name}"] for name in paper_tables.NAMES])
    row = rows.query("case == 3 and direction == 'flown' and noise and factor == 1").iloc[0]
    # The start here is truth + (prelaunch − truth), which is rounded.
    assert row["correction_2_G"] == pytest.approx(np.abs(change[:9]).max(), rel=1e-6)
    assert row["correction_2_bias_deg_s"] == pytest.approx(np.abs(change[9:]).max(), rel=1e-6)
