import numpy as np
import pandas as pd
import pytest

from studies.calibration import summaries
from studies.calibration.shared_truth import build_once
from studies.montecarlo.study import StudyConfig


def test_orders_crossings_and_percentiles_of_known_values():
    x = np.array([0.5, 1.0, 2.0, 4.0])
    assert summaries.fit_log_slope(x, 3 * x**1.7) == pytest.approx(1.7)
    assert summaries.find_level_crossing(x, 3 * x**2, 3 * 1.3**2) == pytest.approx(1.3)
    assert summaries.find_level_crossing(x, x, 4.0) == 4.0
    assert np.isnan(summaries.find_level_crossing(x, x, 5.0))
    assert np.isnan(summaries.find_level_crossing(x, x, 0.1))
    assert np.isnan(summaries.fit_log_slope([1.0], [2.0]))
    values = pd.Series(np.arange(101.0))
    assert summaries.summarise_with_flight(values, 25.0)["flight_percentile"] == pytest.approx(100 * 25 / 101)
    found = summaries.summarise_with_flight(values, np.nan)
    assert [found[name] for name in ("p05", "median", "p95")] == [5.0, 50.0, 95.0]
    assert np.isnan(found["flight_percentile"])


CONFIG = StudyConfig(overrides={"gyro.sample_s": 60.0})


def test_built_once_without_dispersions_and_for_each_case_with_them():
    built = []

    @build_once
    def truth(config, flown):
        built.append(flown)
        return flown.truth

    assert truth(CONFIG, 0) is truth(CONFIG, 1)
    assert len(built) == 1
    spread = {"gyro.true_G.0.1": {"kind": "uniform", "low": 1e-3, "high": 2e-3, "mode": "offset"}}
    dispersed = StudyConfig.model_validate(CONFIG.model_dump() | {"dispersions": spread}, strict=False)
    first, second = (truth(dispersed, case) for case in (0, 1))
    assert len(built) == 3
    assert first[1] != second[1]
    np.testing.assert_array_equal(np.delete(first, 1), np.delete(second, 1))
