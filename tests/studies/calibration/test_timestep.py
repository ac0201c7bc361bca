"""Skipping against averaging: what each costs in noise and in bias, and that the claimed covariance knows."""

import numpy as np
import pytest

from gyrocal import NAMES
from studies.calibration import timestep
from studies.montecarlo import statistics
from studies.montecarlo.study import load_config
from tests.studies.rows import run_study

CASES = 60
STEPS = [0.5, 1.0, 2.0, 8.0]


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    config = load_config(timestep.STUDY, changes={"cases": CASES, "steps_s": STEPS})
    return run_study(timestep.STUDY, config, tmp_path_factory.mktemp("timestep"))


@pytest.mark.parametrize(
    ("resampling", "claimed", "true"),
    [("skip", 0.5, True), ("skip", 0.0, False), ("skip", 1.0, False), ("average", 0.0, True), ("average", 0.5, False)],
)
def test_order_of_the_gyro_noise_in_the_step(rows, resampling, claimed, true):
    power, uncertain = timestep.estimate_gyro_order(rows, resampling)
    assert uncertain < 0.06  # what 60 cases of correlated parameters should give: sqrt(2 / 60 / 2 free ones) / ln 16
    # Four standard errors; averaging has nearly none, but its residual's weights change by what the bias does to them.
    assert (abs(power - claimed) < 4 * uncertain + 1e-3) == true


def test_formal_sigmas_know_of_skipping_and_averaging_has_a_bias_of_second_order(rows):
    table = timestep.summarise_steps(rows)
    # Spread over formal sigma has a relative sampling error of 1/sqrt(2 CASES) a parameter; 4 of it.
    assert np.abs(table["spread_over_formal"] - 1).max() < 4 / np.sqrt(2 * CASES)
    assert table["nees"].between(table["nees_lower"], table["nees_upper"]).all()
    # Negative control: the full stream's sigma does not cover the errors of skipping to 8 s.
    long, full = (timestep.select_step(rows, step, "skip") for step in (8.0, 0.5))
    errors, sigmas = (
        part[[f"{what}_{name}" for name in NAMES]].to_numpy() for what, part in (("error", long), ("sigma", full))
    )
    covariances = sigmas[:, :, None] ** 2 * np.eye(12)
    overconfident = statistics.check_mean_nees(statistics.compute_nees(errors, covariances), 12)
    assert overconfident.value > 2 * overconfident.upper
    average = timestep.summarise_steps(rows).query("resampling == 'average'").set_index("step_s")
    # Each step doubled makes four times the bias; what comes next in Δt is below 1 %.
    assert average["held_sigma"][2.0] / average["held_sigma"][1.0] == pytest.approx(4, rel=0.01)
    assert average["held_sigma"][8.0] / average["held_sigma"][1.0] == pytest.approx(64, rel=0.02)
    assert average["held_sigma"][0.5] < 0.01 < timestep.LIMIT < average["held_sigma"][8.0]
    # On the same noise the mean error moves by the bias alone: paired, it shows without the noise.
    table = timestep.tabulate_parameter_biases(rows).query("step_s == 8 and resampling == 'average'").set_index("parameter")
    full = timestep.tabulate_parameter_biases(rows).query("step_s == 0.5").set_index("parameter")
    moved, expected = ((table[name] - full[name]) / full["formal_sigma"] for name in ("bias", "held"))
    standard_error = (
        timestep.select_step(rows, 8.0, "average")[[f"error_{name}" for name in NAMES]].to_numpy()
        - timestep.select_step(rows, 0.5, "skip")[[f"error_{name}" for name in NAMES]].to_numpy()
    ).std(axis=0, ddof=1) / np.sqrt(CASES)
    assert (np.abs(moved - expected) < 5 * standard_error / full["formal_sigma"]).all()
    assert np.abs(moved).max() > 0.2
    assert timestep.summarise_steps(rows)["bias_z"].max() < 4  # largest of 12
