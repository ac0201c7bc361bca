"""Converged calibrator, least-squares oracle and streaming agree; the oracle knows nothing of Θ."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrocal import GyroParameters, InputError
from studies.calibration import estimators
from studies.calibration.estimators import CONVERGED, FULL_PSI, LINEAR_PSI, ORACLE, STREAMING, STUDY
from studies.montecarlo.study import Streams, load_config, observed, resolve_config
from tests.studies.rows import run_study

CONFIG = load_config(STUDY, changes={"cases": 6, "streaming_every": 3, "overrides.gyro.sample_s": 4.0})


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    return run_study(STUDY, CONFIG, tmp_path_factory.mktemp("estimators"))


def of(rows, name):
    return rows[rows["estimator"] == name].set_index("case")


def test_converged_calibrator_and_oracle_agree(rows):
    converged = of(rows, CONVERGED)
    assert len(converged) == 6
    assert converged["from_oracle_G"].max() < 1e-9
    assert converged["from_oracle_deg_h"].max() < 1e-7
    # And are not both where they began, nor where one iteration ends.
    assert of(rows, FULL_PSI)["from_oracle_G"].min() > 1e-7
    assert of(rows, LINEAR_PSI)["from_oracle_G"].min() > 1e-7


def test_nothing_is_below_the_oracles_minimum(rows):
    lowest = of(rows, ORACLE)["objective"]
    for name in (FULL_PSI, LINEAR_PSI, CONVERGED):
        assert (of(rows, name)["objective"] > lowest - 1e-6).all()
    assert lowest.max() < 22.5  # χ² with 6 degrees of freedom: 1e-3 each


def test_streaming_is_one_iteration(rows):
    streamed = of(rows, STREAMING)
    assert list(streamed.index) == [0, 3]
    assert streamed["from_full_psi_G"].max() < 1e-12


def test_errors_are_of_the_size_of_the_sigmas(rows):
    mean_square = np.mean(of(rows, CONVERGED)["error_in_sigmas"] ** 2)
    assert 0.3 < mean_square < 2.5  # 6 cases of 12 correlated parameters, at least 12 independent squares


def test_oracles_residuals_are_those_of_rotations_multiplied_one_by_one():
    config = resolve_config(CONFIG)
    seen = observed(config, 1, Streams(config.entropy, 1))
    x = GyroParameters(seen.gyro.apriori_G, seen.gyro.apriori_bias).vector
    problem = estimators.fix_weights(seen, x)
    own = estimators.whiten_nonlinear_residuals(problem, x).reshape(-1, 3)
    for k, interval in enumerate(seen.intervals):
        inside = (seen.gyro.t_s >= interval.start_s) & (seen.gyro.t_s < interval.stop_s)
        t = np.append(seen.gyro.t_s[inside], interval.stop_s)
        R = Rotation.identity()
        for raw, dt in zip(seen.gyro.rates[inside], np.diff(t), strict=True):
            R = Rotation.from_rotvec(-(x[:9].reshape(3, 3) @ raw + x[9:]) * dt) * R
        first, last = (Rotation.from_quat(seen.attitudes.quaternions[2 * k + j]).inv() for j in range(2))
        theta = (last * (R * first).inv()).as_rotvec()
        np.testing.assert_allclose(own[k], np.linalg.solve(np.linalg.cholesky(problem.given[k]), theta), atol=1e-6)


def test_all_but_the_costs_is_the_same_again(rows, tmp_path):
    again = run_study(STUDY, CONFIG.model_copy(update={"cases": 2}), tmp_path / "again")
    kept = [name for name in rows if not name.startswith("cost_")]
    assert set(rows) - set(kept) == {"cost_cpu_ms"}
    assert again[kept].equals(rows.loc[rows["case"] < 2, kept])


def test_a_disagreement_is_reported_as_one(rows):
    name = "converged from the oracle in G, largest"
    wrong = rows.copy()
    wrong.loc[wrong["estimator"] == CONVERGED, "from_oracle_G"] = 2e-9
    verdicts = [estimators.report(CONFIG, table).check(name).verdict for table in (rows, wrong)]
    assert verdicts == ["pass", "fail"]


def test_series_of_references_are_refused():
    config = resolve_config(load_config(STUDY, changes={"scenario": "trmm_series", "overrides.gyro.sample_s": 4.0}))
    with pytest.raises(InputError, match="references at their ends only"):
        STUDY.case(config, 0, Streams(config.entropy, 0))
