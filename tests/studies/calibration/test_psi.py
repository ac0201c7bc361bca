"""Linear against full ψ: the orders of their errors, and where each stops being good enough."""

import numpy as np
import pytest

from simulator import scenario as scenarios
from studies.calibration import psi
from studies.montecarlo.study import load_config
from tests.studies.rows import run_study

TRMM = scenarios.load("trmm")
SMALL = {"slew_rates_deg_s": [0.25, 2.0], "steps_s": [0.5, 1.0, 4.0], "slew_angles_deg": [90.0, 180.0]}


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    config = load_config(psi.STUDY, changes=SMALL)
    return run_study(psi.STUDY, config, tmp_path_factory.mktemp("psi"))


@pytest.mark.parametrize(
    ("column", "claimed", "true"),
    [("G_difference", 1, True), ("G_difference", 2, False), ("full_error_G", 2, True), ("full_error_G", 1, False)],
)
def test_orders_in_the_step(rows, column, claimed, true):
    # Next to the leading order comes a term smaller by |ω|Δt/2: 0.009 at 0.25 deg/s and 4 s, less than 0.05 in the order.
    slow = psi.estimate_step_orders(rows).query("slew_rate_deg_s == 0.25")[column]
    assert (np.abs(slow - claimed).max() < 0.05) == true


def test_linear_psi_fails_first_at_high_rates_and_long_steps(rows):
    table = rows[rows["slew_angle_deg"] == 180].set_index(["slew_rate_deg_s", "step_s"])
    difference = table["G_difference"]
    assert difference[(0.25, 0.5)] < psi.GOOD_ENOUGH  # TRMM
    assert difference[(2.0, 4.0)] > psi.GOOD_ENOUGH
    # First order in |ω|Δt: eight times the step times eight; the rate adds what the orbital rate does alone.
    assert 7.5 < difference[(0.25, 4.0)] / difference[(0.25, 0.5)] < 8.5
    assert 5 < difference[(2.0, 0.5)] / difference[(0.25, 0.5)] < 20
    # Both converge to the same parameters; linear ψ takes longer.
    assert abs(table["linear_error_G"] - table["full_error_G"]).max() < 1e-7
    assert (table["linear_iterations"] >= table["full_iterations"]).all()
    limit = psi.find_psi_limits(rows).set_index(["slew_angle_deg", "step_s"]).loc[(180.0, 0.5)]
    assert 0.25 < limit["linear_rate_deg_s"] < 2.0
    assert limit["linear_angle_per_step_deg"] == pytest.approx(0.5 * limit["linear_rate_deg_s"])
    # Flown at that rate it is the limit, as far as log-log interpolation over a factor of 8 in the rate goes.
    there = psi.compare_psi(TRMM, float(limit["linear_rate_deg_s"]), 0.5)["G_difference"]
    assert there == pytest.approx(psi.GOOD_ENOUGH, rel=0.3)
    assert psi.compare_psi(TRMM, float(2 * limit["linear_rate_deg_s"]), 0.5)["G_difference"] > 1.5 * psi.GOOD_ENOUGH
