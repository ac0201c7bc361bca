"""The consistency study finds consistent estimators consistent and every wrong one to be what it is."""

import numpy as np
import pandas as pd
import pytest

from studies.calibration import consistency
from studies.calibration.consistency import EXPECTED_VERDICTS, STUDY, build_estimate_row, check, summarise_verdicts
from studies.montecarlo.statistics import compute_binomial_band
from studies.montecarlo.study import load_config
from tests.studies.rows import run_study

CONFIG = load_config(STUDY, changes={"cases": 120, "overrides.gyro.sample_s": 4.0})


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    return run_study(STUDY, CONFIG, tmp_path_factory.mktemp("consistency"))


def made(n, scale=1.0, shift=0.0, seed=0):
    """Rows of an estimator whose errors are known to be `scale` of what it claims, and `shift` of a sigma off."""
    rng = np.random.default_rng(seed)
    root = np.diag([1e-4] * 9 + [1e-8] * 3) @ (np.eye(12) + 0.3 * rng.normal(size=(12, 12)))
    P = root @ root.T
    errors = scale * rng.normal(size=(n, 12)) @ root.T + shift * np.sqrt(np.diag(P))
    return pd.DataFrame([build_estimate_row("made", error, P) for error in errors])


@pytest.mark.parametrize(
    ("scale", "shift", "expected"),
    [
        (1.0, 0.0, "consistent"),
        (1 / 0.7, 0.0, "over-confident"),
        (1 / 1.4, 0.0, "under-confident"),
        (1.0, -0.5, "biased"),
    ],
)
def test_check_knows_what_it_is_given(scale, shift, expected):
    assert summarise_verdicts(check(made(200, scale, shift))) == expected


def test_a_consistent_estimator_seldom_fails_any_check():
    failed = sum(summarise_verdicts(check(made(100, seed=seed))) != "consistent" for seed in range(100, 115))
    assert failed <= 2  # binomial: 15 trials of at most 1 % each exceed 2 once in 2000


def test_study_passes_its_consistent_estimators_and_catches_every_control(rows):
    found = {name: summarise_verdicts(table) for name, table in consistency.judge(CONFIG, rows).groupby("estimator")}
    assert found == EXPECTED_VERDICTS
    made_report = consistency.report(CONFIG, rows)
    assert [check.name for check in made_report.checks[: len(EXPECTED_VERDICTS)]] == list(EXPECTED_VERDICTS)
    assert {check.verdict for check in made_report.checks} == {"pass"}
    swapped = rows.assign(estimator=rows["estimator"].replace({"with prior": "sigma × 0.7", "sigma × 0.7": "with prior"}))
    failed = [check.name for check in consistency.report(CONFIG, swapped).checks if check.verdict == "fail"]
    assert {"with prior", "sigma × 0.7", "mean NEES, with prior"} <= set(failed)
    assert "without prior" not in failed


def test_truths_are_drawn_from_the_prior_which_helps_where_the_data_are_weak(rows):
    truths = rows[rows["estimator"] == "with prior"][[f"disp:{path}" for path in consistency.PATHS]].to_numpy()
    mean, sigma = consistency.compute_prior_moments(CONFIG)
    z = (truths * consistency.TO_SI - mean) / sigma
    n = len(z)
    assert np.abs(z.mean(axis=0)).max() < 4 / np.sqrt(n)
    assert np.abs(z.var(axis=0) - 1).max() < 4 * np.sqrt(2 / n)
    rms = rows.groupby("estimator")[["error_G_zy_ppm", "sigma_G_zy_ppm"]].agg(lambda x: np.sqrt(np.mean(x**2)))
    assert (rms.loc["with prior"] < 0.8 * rms.loc["without prior"]).all()


def test_ranks_and_band():
    y = np.array([[-3.0], [0.0], [3.0]])  # the truth far above the estimate, at it, far below
    np.testing.assert_allclose(consistency.compute_ranks(y), [0.99865, 0.5, 0.00135], atol=1e-5)
    low, high = compute_binomial_band(400, 1 / 20, 0.99, 20)
    assert low < 20 < high
    counts = np.random.default_rng(5).multinomial(400, [1 / 20] * 20, size=2000)
    outside = ((counts < low) | (counts > high)).any(axis=1).mean()
    assert outside < 0.01 + 4 * np.sqrt(0.01 / 2000)
