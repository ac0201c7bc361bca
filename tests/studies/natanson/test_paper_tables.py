"""The Monte Carlo of the paper's tables: unbiased, consistent, the same however it is run, and its tables are right."""

import numpy as np
import pandas as pd
import pytest
import scipy.stats

from gyrocal import NAMES, GyroParameters
from simulator import scenario as scenarios
from studies.calibration import summaries
from studies.montecarlo import statistics
from studies.natanson import flight, paper_tables

CASES = 120


@pytest.fixture(scope="module")
def config():
    return paper_tables.PaperTablesConfig(
        cases=CASES, steps_s=(0.5,), overrides={"gyro.arw_deg_per_sqrt_s": 2.5e-4}, scenario=scenarios.load("trmm")
    )


@pytest.fixture(scope="module")
def truth(config):
    gyro = config.scenario.gyro
    return GyroParameters(np.array(gyro.true_G), np.deg2rad(gyro.true_bias_deg_s))


@pytest.fixture(scope="module")
def rows(config):
    return pd.concat([paper_tables.tabulate_case(config, number) for number in range(CASES)], ignore_index=True)


def test_estimates_are_unbiased_and_the_full_covariance_alone_is_consistent(rows, truth):
    errors, _ = paper_tables.compute_errors_and_sigmas(paper_tables.select_variant(rows, 0.5), truth)
    assert errors.shape == (CASES, 12)
    z = errors.mean(axis=0) / (errors.std(axis=0, ddof=1) / np.sqrt(CASES))
    assert np.abs(z).max() < 4
    full = statistics.check_mean_nees(paper_tables.select_variant(rows, 0.5)["nees"].to_numpy(), len(NAMES))
    assert full.is_inside
    paper = statistics.check_mean_nees(
        paper_tables.select_variant(rows, 0.5, covariance="references only")["nees"].to_numpy(), len(NAMES)
    )
    assert paper.value > 2 * paper.upper


@pytest.mark.parametrize(("covariance", "consistent"), [("full", True), ("references only", False)])
def test_coverage_is_what_the_sigmas_claim(rows, truth, covariance, consistent):
    errors, sigmas = paper_tables.compute_errors_and_sigmas(
        paper_tables.select_variant(rows, 0.5, covariance=covariance), truth
    )
    for level in ("68", "95"):
        share = summaries.SIGMA_LEVELS[level]
        k = scipy.stats.norm.ppf(0.5 + share / 2)
        # The twelve of a case correlate: the case is the unit, its own share the sample; 4 standard errors of their mean.
        per_case = (np.abs(errors) <= k * sigmas).mean(axis=1)
        deviation = abs(per_case.mean() - share) / (per_case.std(ddof=1) / np.sqrt(CASES))
        assert (deviation < 4) == consistent
    # Spread over formal sigma, a ratio with a relative sampling error of 1/sqrt(2 CASES); 4 sigma.
    ratio = errors.std(axis=0, ddof=1) / np.sqrt((sigmas**2).mean(axis=0))
    assert (np.abs(ratio - 1).max() < 4 / np.sqrt(2 * CASES)) == consistent


def test_tables_hold_what_their_rows_say(rows):
    wanted = "psi == 'full' and phase == 'prelaunch' and interval == 3 and axis == 'pitch'"
    table2 = paper_tables.build_flight_table(rows, "table2").query(wanted).iloc[0]
    samples = paper_tables.select_variant(rows, 0.5)["before_3_pitch"]
    assert table2["mean"] == samples.mean()
    assert table2["flight"] == -0.433
    assert table2["flight_percentile"] == 100 * (samples < -0.433).mean()
    table4 = paper_tables.build_flight_table(rows, "table4").query("psi == 'full' and phase == 'calibrated' and axis == 'yaw'")
    table4 = table4.set_index("statistic")
    assert table4.loc["rms", "mean"] == pytest.approx(np.sqrt(6) * table4.loc["paper_rms", "mean"])
    assert table4.loc["paper_rms", "flight"] == 0.0043
    table5 = paper_tables.build_flight_table(rows, "table5").query(
        "psi == 'full' and iteration == 1 and quantity == 'G_inverse'"
    )
    before, after = flight.read_published_parameters("prelaunch").G, flight.read_published_calibration().G
    expected = np.linalg.inv(after) - np.linalg.inv(before)
    # The mean correction of G⁻¹ is the injected one; 5 standard errors.
    error = (table5["mean"].to_numpy() - expected.ravel()) / (table5["std"].to_numpy() / np.sqrt(CASES))
    assert np.abs(error).max() < 5
    assert table5["flight"].tolist() == flight.read_published_corrections(1)[0].ravel().tolist()


def test_any_number_of_references():
    changes = {"reference.at": "series", "reference.every_s": 2000.0}
    scenario = scenarios.override(scenarios.load("trmm"), changes)
    labels = ["1.1", "1.2", "1.3", "2", "3.1", "3.2", "3.3", "4.1", "4.2", "5.1", "5.2", "5.3", "6"]
    config = paper_tables.PaperTablesConfig(cases=2, steps_s=(2.0, 4.0), scenario=scenario, overrides={"gyro.sample_s": 2.0})
    rows = pd.concat([paper_tables.tabulate_case(config, number) for number in range(2)], ignore_index=True)
    assert paper_tables.find_residual_labels(rows) == labels
    report = paper_tables.report(config, rows)
    table2 = report.tables["residuals"].data
    assert [str(k) for k in table2["interval"].drop_duplicates()] == labels
    assert table2["flight"].isna().all()
